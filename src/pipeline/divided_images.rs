//! Images of one camera that differ in their optics: those with one turn of the pupil on the
//! detector, or with one map of the diversity, are those of a channel.

use super::estimate::{Estimate, MethodResult, ModalSummary};
use super::images::{Images, Trust, counted};
use crate::scene::{ImageList, ImageScene, Scene};
use crate::{Error, Result};
use ndarray::Axis;

/// Key of the turns.
const KEY: &str = "image.pupil_turns_deg";
/// Turns that differ by no more are fitted as one: at half of that, 0.025°, the edge of a pupil of
/// 11 m is 2 mm off, where a degree costs 11 nm.
const RESOLUTION_DEG: f64 = 0.05;

/// Images with optics of their own, as channels.
pub(super) struct DividedImages {
    /// The scene, with a channel for each turn or map.
    pub(super) scene: Scene,
    /// The scene as it was given, with the turns that a file has.
    given: Scene,
    pub(super) images: Vec<Images>,
    /// Number of each image of these, channel after channel, among all that were given.
    order: Vec<usize>,
    /// Number of each image among those of its channel as it was given, for each of these channels.
    pub(super) exposures: Vec<Vec<usize>>,
    /// What a user should know of it.
    remarks: Vec<String>,
}

impl DividedImages {
    /// The `images` of the channels of `given` as channels of one turn of the pupil, or one map of
    /// the diversity, each; `None` where the scene has one of both.
    ///
    /// # Errors
    /// [`Error::Scene`] for another number of turns or maps than of images, and for more maps than
    /// channels; [`Error::Image`] for turns in the file that contradict the scene's.
    pub(super) fn of(given: &Scene, images: &[&Images]) -> Result<Option<Self>> {
        match Self::by_plane(given, images)? {
            None => Self::by_turn(given, images),
            divided => Ok(divided),
        }
    }

    /// Those whose channels have a map of the diversity each.
    fn by_plane(given: &Scene, images: &[&Images]) -> Result<Option<Self>> {
        let own = given.each_channel();
        if own.iter().all(|(_, scene)| scene.image.diversity_plane().is_some()) {
            return Ok(None);
        }
        let (mut channels, mut parts, mut order, mut begin) = (Vec::new(), Vec::new(), Vec::new(), 0);
        let mut exposures = Vec::new();
        for ((name, scene), images) in own.iter().zip(images) {
            let planes = match scene.image.diversity_planes.as_deref().unwrap_or(&[0]) {
                [one] => vec![*one; images.len()],
                each if each.len() == images.len() => each.to_vec(),
                each => {
                    return Err(Error::Scene(format!(
                        "{}: image.diversity_planes has {} numbers for {}; one, or one for each image, is needed",
                        scene.name(),
                        each.len(),
                        counted(images.len(), "image")
                    )));
                }
            };
            let name = name.map(|name| format!("{name:.24}, ")).unwrap_or_default();
            let mut maps: Vec<(i64, Vec<usize>)> = Vec::new();
            for (image, plane) in planes.into_iter().enumerate() {
                match maps.iter_mut().find(|(known, _)| *known == plane) {
                    Some((_, which)) => which.push(image),
                    None => maps.push((plane, vec![image])),
                }
            }
            let mut each = Vec::new();
            for (plane, which) in maps {
                let name = if plane < 0 { format!("{name}no map") } else { format!("{name}map {plane}") };
                parts.push(part(images, &name, &which, |image| image.diversity_planes = Some(vec![plane]))?);
                order.extend(which.iter().map(|image| begin + image));
                exposures.push(which);
                each.push((name, plane as f64));
            }
            channels.push(each);
            begin += images.len();
        }
        if parts.len() > Scene::MAX_CHANNELS {
            return Err(Error::Scene(format!(
                "{}: image.diversity_planes names {} maps; at most {} are accepted",
                given.name(),
                parts.len(),
                Scene::MAX_CHANNELS
            )));
        }
        let scene = divided_scene(given, ImageList::DiversityPlanes, &channels, &order)?;
        Ok(Some(Self { scene, given: given.clone(), images: parts, order, exposures, remarks: Vec::new() }))
    }

    /// Those whose channels have a turn of the pupil each.
    fn by_turn(given: &Scene, images: &[&Images]) -> Result<Option<Self>> {
        let own = given.each_channel();
        let turns_deg = own.iter().zip(images).map(|((_, scene), images)| turns_of(scene, images));
        let turns_deg = turns_deg.collect::<Result<Vec<_>>>()?;
        let is_own = |scene: &Scene, turns_deg: &Vec<f64>| scene.image.pupil_turns_deg.as_ref() == Some(turns_deg);
        let is_at_rest = |((_, scene), turns_deg): (&(_, &Scene), &Option<Vec<f64>>)| {
            turns_deg.as_ref().is_none_or(|turns_deg| turns_deg.len() == 1 && is_own(scene, turns_deg))
        };
        if own.iter().zip(&turns_deg).all(is_at_rest) {
            return Ok(None);
        }
        let with_turns = given.with_each_channel(|channel, sections| {
            if let Some(turns_deg) = &turns_deg[channel] {
                sections.image.pupil_turns_deg = Some(turns_deg.clone());
            }
        })?;
        let most = Scene::MAX_CHANNELS / own.len();
        let (mut channels, mut parts, mut order, mut remarks) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (mut begin, count) = (0, images.iter().map(|images| images.len()).sum::<usize>());
        let mut exposures = Vec::new();
        for (((name, _), images), turns_deg) in own.iter().zip(images).zip(turns_deg) {
            let turns_deg = match turns_deg.unwrap_or_else(|| vec![0.0]) {
                one if one.len() == 1 => vec![one[0]; images.len()],
                each => each,
            };
            let (groups, width_deg) = grouped(&turns_deg, most);
            if width_deg > RESOLUTION_DEG {
                remarks.push(format!(
                    "The pupil turns by more than {most} models resolve: images within {width_deg:.2}° of each other are fitted with their mean turn."
                ));
            }
            let name = name.map(|name| format!("{name:.24}, ")).unwrap_or_default();
            let mut each = Vec::new();
            for Group { turn_deg, images: which } in groups {
                let name = format!("{name}turn {turn_deg:+.3}");
                parts.push(part(images, &name, &which, |image| image.pupil_turns_deg = Some(vec![turn_deg]))?);
                order.extend(which.iter().map(|image| begin + image));
                exposures.push(which);
                each.push((name, turn_deg));
            }
            channels.push(each);
            begin += images.len();
        }
        let turns = counted(channels.iter().map(Vec::len).sum(), "turn");
        remarks.push(format!("{} were fitted with {turns} of the pupil.", counted(count, "image")));
        let scene = divided_scene(given, ImageList::PupilTurns, &channels, &order)?;
        Ok(Some(Self { scene, given: with_turns, images: parts, order, exposures, remarks }))
    }

    /// `estimate` of these images as one of the images in the order in which they were given.
    pub(super) fn in_given_order(self, mut estimate: Estimate) -> Estimate {
        let mut places: Vec<usize> = (0..self.order.len()).collect();
        places.sort_by_key(|&place| self.order[place]);
        // Images that no channel has, such as those of one that was left out, keep their places.
        let is_whole = estimate.images.len() == places.len();
        let images = if is_whole {
            places.iter().map(|&place| estimate.images[place].clone()).collect()
        } else {
            estimate.images
        };
        if let MethodResult::Modal(ModalSummary { image_coefficients_nm: rows, .. }) = &mut estimate.method
            && rows.nrows() == places.len()
        {
            *rows = rows.select(Axis(0), &places);
        }
        let remarks = self.remarks.into_iter().chain(estimate.remarks).collect();
        Estimate { images, remarks, scene: self.given, ..estimate }
    }
}

/// `given` with `channels`, whose images have, one after the other, the numbers `order` among those
/// that were given.
fn divided_scene(given: &Scene, list_of: ImageList, channels: &[Vec<(String, f64)>], order: &[usize]) -> Result<Scene> {
    let scene = given.divided(list_of, channels)?;
    let Some(fitted) = &given.estimate.fitted_images else { return Ok(scene) };
    // A number that no image has is refused by the estimate, as it was given.
    let place = |number: &i64| order.iter().position(|&image| image as i64 == *number).map_or(*number, |at| at as i64);
    scene.changed(|sections| sections.estimate.fitted_images = Some(fitted.iter().map(place).collect()))
}

/// The images `which` of `images` as those of the channel `name`; `change` makes the file's own
/// scene, where it has one, that of the channel.
fn part(images: &Images, name: &str, which: &[usize], change: impl Fn(&mut ImageScene)) -> Result<Images> {
    let scene = images.scene.as_ref().map(|scene| scene.changed(|sections| change(&mut sections.image)));
    Ok(Images { channel: Some(name.to_owned()), scene: scene.transpose()?, ..images.selected(which) })
}

/// Turns of the pupil in `images`, degrees: one, or one for each; `None` where neither scene nor
/// file gives any.
fn turns_of(scene: &Scene, images: &Images) -> Result<Option<Vec<f64>>> {
    let own = scene.image.pupil_turns_deg.as_ref();
    let of_file = images.scene.as_ref().and_then(|of_file| of_file.image.pupil_turns_deg.as_ref());
    let is_decided = images.overrides.iter().any(|key| key == KEY);
    let turns_deg = match (own, of_file) {
        (None, None) => return Ok(None),
        (Some(own), None) => own,
        (None, Some(of_file)) if scene.image.pupil_turn_card.is_some() => of_file,
        (Some(own), Some(of_file)) if same(own, of_file) => own,
        (_, Some(of_file)) if images.trust == Trust::File && !is_decided => of_file,
        (own, Some(_)) if images.trust == Trust::Scene || is_decided => match own {
            Some(own) => own,
            None => return Ok(None),
        },
        (own, Some(of_file)) => {
            let of_scene = own.map_or("does not name it".into(), |own| format!("has {}", short(own)));
            return Err(Error::Image(format!(
                "the file contradicts the scene: table SCENE has {KEY} = {} where the scene {of_scene}; remove the contradiction, or say which of the \
                 two holds (estimate --trust scene or --trust file)",
                short(of_file)
            )));
        }
    };
    match turns_deg.len() {
        1 => Ok(Some(turns_deg.clone())),
        count if count == images.len() => Ok(Some(turns_deg.clone())),
        count => Err(Error::Scene(format!(
            "{}: {KEY} has {count} numbers for {}; one, or one for each image, is needed",
            scene.name(),
            counted(images.len(), "image")
        ))),
    }
}

/// Whether two lists have the same turns, to a millionth of a degree.
fn same(one: &[f64], other: &[f64]) -> bool {
    one.len() == other.len() && one.iter().zip(other).all(|(a, b)| (a - b).abs() <= 1e-6)
}

/// A list, without its middle where it is long.
fn short(turns_deg: &[f64]) -> String {
    match turns_deg {
        [first, second, _, .., last] => format!("[{first}, {second}, ..., {last}]"),
        few => format!("{few:?}"),
    }
}

/// Images with one turn of the pupil.
struct Group {
    turn_deg: f64,
    images: Vec<usize>,
}

/// Images whose turns differ by no more than a width, in at most `most` groups; and that width,
/// degrees.
fn grouped(turns_deg: &[f64], most: usize) -> (Vec<Group>, f64) {
    let mut order: Vec<usize> = (0..turns_deg.len()).collect();
    order.sort_by(|&a, &b| turns_deg[a].total_cmp(&turns_deg[b]));
    let range_deg = match (order.first(), order.last()) {
        (Some(&first), Some(&last)) => turns_deg[last] - turns_deg[first],
        _ => 0.0,
    };
    let group_by = |width_deg: f64| {
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for &image in &order {
            match groups.last_mut() {
                Some(group) if turns_deg[image] - turns_deg[group[0]] <= width_deg => group.push(image),
                _ => groups.push(vec![image]),
            }
        }
        groups
    };
    let mut width_deg = RESOLUTION_DEG;
    let mut groups = group_by(width_deg);
    if groups.len() > most {
        width_deg = range_deg / most as f64;
        groups = group_by(width_deg);
    }
    let groups = groups.into_iter().map(|mut images| {
        let turn_deg = images.iter().map(|&image| turns_deg[image]).sum::<f64>() / images.len() as f64;
        images.sort_unstable();
        Group { turn_deg, images }
    });
    (groups.collect(), width_deg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_grouped_within_the_resolution() {
        let (groups, width_deg) = grouped(&[1.0, -0.5, 1.02, 0.0, -0.5], 64);
        let found: Vec<_> = groups.iter().map(|group| (group.turn_deg, group.images.as_slice())).collect();
        assert_eq!(found, [(-0.5, &[1, 4][..]), (0.0, &[3]), (1.01, &[0, 2])]);
        assert_eq!(width_deg, RESOLUTION_DEG);
        // A range that is longer than the groups: none wider than its share.
        let turns_deg: Vec<f64> = (0..500).map(|image| 0.1 * f64::from(image)).collect();
        let (groups, width_deg) = grouped(&turns_deg, 10);
        assert!(groups.len() <= 10 && (4.9..5.1).contains(&width_deg), "{} {width_deg}", groups.len());
        assert_eq!(groups.iter().map(|group| group.images.len()).sum::<usize>(), 500);
    }
}
