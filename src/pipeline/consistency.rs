//! Consistency of an image file with the scene: its cards and its own scene are compared with the
//! keys, and the pixels are converted to electrons.
//!
//! A contradiction is an error, unless [`Images::trust`] says which of the two holds.

use super::images::{Images, Trust, counted, in_ranges};
use super::instrument;
use crate::agreement::{Compared, Disagreement, GAIN, padded_counts, wrapped};
use crate::io::{HeaderFact, PixelUnit, Quantity, READ_NOISE_OF_A_COADD};
use crate::modal::{Cube, DeadPixels};
use crate::scene::{Scene, Setting};
use crate::{Error, Result};
use ndarray::{Array1, Array2, Array3, Axis};
use std::borrow::Cow;
use std::collections::BTreeSet;

/// Images in electrons, as the methods of an estimate take them.
pub(super) struct Electrons<'a> {
    /// `[image, y, x]`.
    pub(super) images_e: Cow<'a, Array3<f64>>,
    /// `[image, y, x]`.
    pub(super) bad: Cow<'a, Array3<bool>>,
    /// Read noise of a pixel; `None` for the scene's.
    pub(super) read_noise_e: Option<f64>,
    /// Telemetry of a MAP estimate.
    pub(super) slopes_mas: Option<&'a Array2<f64>>,
    /// [`Images::moved_reference_mas`].
    pub(super) moved_reference_mas: Option<&'a Array1<f64>>,
}

impl Electrons<'_> {
    pub(super) fn len(&self) -> usize {
        self.images_e.dim().0
    }

    /// As a fit takes them.
    pub(super) fn cube(&self) -> Cube<'_> {
        Cube { images_e: self.images_e.view(), bad: self.bad.view(), read_noise_e: self.read_noise_e }
    }

    /// The sum of the images `which`, as one image: bad where one of them is, with the read noise
    /// of all, where it is known for one (else `scene_read_noise_e`).
    pub(super) fn sum(&self, which: &[usize], scene_read_noise_e: Option<f64>) -> Electrons<'static> {
        let images_e = self.images_e.select(Axis(0), which).sum_axis(Axis(0)).insert_axis(Axis(0));
        let bad = self.bad.select(Axis(0), which).map_axis(Axis(0), |pixel| pixel.iter().any(|bad| *bad));
        let read_noise_e = self.read_noise_e.or(scene_read_noise_e);
        Electrons {
            images_e: Cow::Owned(images_e),
            bad: Cow::Owned(bad.insert_axis(Axis(0))),
            read_noise_e: read_noise_e.map(|noise_e| noise_e * (which.len() as f64).sqrt()),
            slopes_mas: None,
            moved_reference_mas: None,
        }
    }
}

/// Images that agree with a scene.
pub(super) struct Consistent<'a> {
    /// The images.
    pub(super) images: Electrons<'a>,
    /// The scene, with those values of the file that are trusted.
    pub(super) scene: Scene,
    /// Whether the scene has values of the file.
    pub(super) is_changed: bool,
    /// Sentences on what was converted and which of two values holds.
    pub(super) remarks: Vec<String>,
    /// Keys of which the file has another value.
    pub(super) contradictions: Vec<Contradiction>,
}

/// A key of which the file has another value than the scene.
#[derive(Debug, Clone)]
pub(super) struct Contradiction {
    /// The key, with the file's value.
    pub(super) of_file: Setting,
    pub(super) sentence: String,
}

/// Compares `images` with `scene`, and converts them to electrons.
///
/// # Errors
/// [`Error::Image`] for a file that contradicts the scene, for pixels that are not in electrons
/// and have no gain, and for counts that wrapped; [`Error::Scene`] for a value of the file that the
/// scene does not accept.
pub(super) fn reconcile<'a>(images: &'a Images, scene: &Scene) -> Result<Consistent<'a>> {
    let (scene_now, remarks) = (scene.clone(), images.remarks.clone());
    let mut comparison =
        Comparison { images, scene: scene_now, is_changed: false, contradictions: Vec::new(), remarks };
    if let Some(of_file) = &images.scene {
        for [own, of_file] in instrument::differences(&comparison.scene, of_file) {
            let shown = of_file.clone().in_form_of(scene);
            comparison.decide(format!("table SCENE has {shown}"), own, of_file)?;
        }
    }
    comparison.compare_facts(scene)?;
    let gain = comparison.gain()?;
    if !comparison.contradictions.is_empty() && images.trust == Trust::Neither {
        return Err(Error::Image(format!(
            "the file contradicts the scene: {}; remove the contradiction, or say which of the two holds (estimate --trust \
             scene or --trust file)",
            comparison.contradictions.iter().map(|one| one.sentence.as_str()).collect::<Vec<_>>().join("; ")
        )));
    }
    let read_noise_e = images.read_noise_e.or_else(|| comparison.read_noise_e());
    let images_e = match gain {
        Some(gain) => Cow::Owned(&images.images_e * gain),
        None => Cow::Borrowed(&images.images_e),
    };
    if let Some(reason) = wrapped::wrapped(images.images_e.view()) {
        return Err(Error::Image(reason));
    }
    let (bad, remark) = without_dead_pixels(images);
    comparison.remarks.extend(remark);
    let electrons = Electrons {
        images_e,
        bad,
        read_noise_e,
        slopes_mas: images.slopes_mas.as_ref(),
        moved_reference_mas: images.moved_reference_mas.as_ref(),
    };
    let Comparison { scene, is_changed, remarks, contradictions, .. } = comparison;
    Ok(Consistent { images: electrons, scene, is_changed, remarks, contradictions })
}

/// Blocks of dead pixels that are named.
const NAMED_BLOCKS: usize = 3;

/// The bad pixels `[image, y, x]`, with columns, rows and blocks that have one value, and a remark
/// on these, of which those of any image are named.
fn without_dead_pixels(images: &Images) -> (Cow<'_, Array3<bool>>, Option<String>) {
    let (_, rows, columns) = images.images_e.dim();
    let (mut dead, mut marked) = (DeadPixels::new((rows, columns)), Cow::Borrowed(&images.bad));
    let (mut lines, mut blocks) = ([BTreeSet::new(), BTreeSet::new()], BTreeSet::new());
    for (number, image) in images.images_e.outer_iter().enumerate() {
        if dead.find(image, images.bad.index_axis(Axis(0), number)) {
            marked.to_mut().index_axis_mut(Axis(0), number).assign(&dead.bad());
            lines.iter_mut().zip(dead.lines()).for_each(|(all, found)| all.extend(found));
            blocks.extend(dead.blocks());
        }
    }
    let mut named = Vec::new();
    for (lines, noun) in lines.iter().zip(["column", "row"]).filter(|(lines, _)| !lines.is_empty()) {
        let lines: Vec<usize> = lines.iter().copied().collect();
        named.push(format!("{noun}{} {}", if lines.len() == 1 { "" } else { "s" }, in_ranges(&lines, 0)));
    }
    let block =
        |[x, y, columns, rows]: &[usize; 4]| format!("a block of {columns} × {rows} from column {x}, row {y} on");
    named.extend(blocks.iter().take(NAMED_BLOCKS).map(block));
    let more = blocks.len().saturating_sub(NAMED_BLOCKS);
    named.extend((more > 0).then(|| counted(more, "further block")));
    let remark =
        format!("All pixels of {} have one value, as of dead or stuck ones: they were masked.", named.join(" and of "));
    (marked, (!named.is_empty()).then_some(remark))
}

struct Comparison<'a> {
    images: &'a Images,
    /// The scene, with the values of the file that were found to differ unless the scene is
    /// trusted: a card that follows from them is no further contradiction.
    scene: Scene,
    is_changed: bool,
    contradictions: Vec<Contradiction>,
    remarks: Vec<String>,
}

impl Comparison<'_> {
    fn facts(&self, quantity: Quantity) -> Vec<&HeaderFact> {
        self.images.facts.iter().filter(|fact| fact.quantity == quantity).collect()
    }

    fn is_decided(&self, key: &str) -> bool {
        self.images.overrides.iter().any(|known| known == key) || instrument::is_fitted(&self.scene, key)
    }

    /// Compares the cards with the keys. `given` is the scene before any comparison.
    fn compare_facts(&mut self, given: &Scene) -> Result<()> {
        self.compare(Quantity::WavelengthNm)?;
        // A file that is trusted may name the wavelength, which is more exact than the centre of
        // its filter's band.
        if self.images.trust != Trust::File || self.facts(Quantity::WavelengthNm).is_empty() {
            self.compare(Quantity::BandNm)?;
        }
        // A pixel that agrees with the scene as given contradicts it no more where another card
        // contradicts its wavelength; the file's wavelength, where it is trusted, needs the
        // sampling that goes with it.
        let agrees = |mas: f64| self.facts(Quantity::PixelMas).iter().any(|fact| fact.agrees(mas));
        let is_settled = self.images.trust != Trust::File && given.pixel_mas().is_some_and(agrees);
        if !is_settled {
            self.compare(Quantity::PixelMas)?;
        }
        if self.images.read_noise_e.is_none() {
            self.compare(Quantity::ReadNoiseE)?;
        }
        [Quantity::ExposureS, Quantity::BackgroundE, Quantity::GainEPerAdu]
            .into_iter()
            .try_for_each(|quantity| self.compare(quantity))
    }

    /// Compares the cards of a quantity with the scene.
    fn compare(&mut self, quantity: Quantity) -> Result<()> {
        let Some(compared) = Compared::new(&self.scene, quantity) else { return Ok(()) };
        let Some(Disagreement { card, stated }) = compared.disagreement(&self.images.facts) else { return Ok(()) };
        let [own, of_file] = [compared.value, stated].map(|value| Setting::new(compared.key, compared.of_key(value)));
        self.decide(card, own, of_file)
    }

    /// Decides between the file's value of a key and the scene's.
    fn decide(&mut self, source: String, own: Setting, of_file: Setting) -> Result<()> {
        if self.is_decided(of_file.key()) {
            return Ok(());
        }
        let [shown, shown_file] = [own, of_file.clone()].map(|setting| setting.in_form_of(&self.scene));
        let sentence = format!("{source} where the scene has {shown}");
        let with_file = || self.scene.with_settings(std::slice::from_ref(&of_file));
        match self.images.trust {
            Trust::Scene => self.remarks.push(format!("The scene's {shown} holds; {source} was not used.")),
            Trust::File => {
                self.scene = with_file()?;
                self.is_changed = true;
                let scene_has = shown.text();
                self.remarks.push(format!("{shown_file} is the file's ({source}); the scene has {scene_has}."));
            }
            // Some values fit only together with others of the file: the contradiction is reported
            // in any case.
            Trust::Neither => {
                if let Ok(scene) = with_file() {
                    self.scene = scene;
                }
            }
        }
        self.contradictions.push(Contradiction { of_file, sentence });
        Ok(())
    }

    /// Read noise of the file, where the scene has none, or where that of the scene is what the
    /// noise of reduced images was derived from.
    fn read_noise_e(&self) -> Option<f64> {
        let facts = self.facts(Quantity::ReadNoiseE);
        let of_a_coadd = facts.iter().find(|fact| fact.keyword == READ_NOISE_OF_A_COADD);
        let is_open = match self.scene.image.read_noise_e {
            None => true,
            Some(read_noise_e) => of_a_coadd.is_some_and(|fact| fact.agrees(read_noise_e)),
        };
        let is_open = is_open && !self.is_decided("image.read_noise_e");
        facts.first().filter(|_| is_open).and_then(|fact| fact.values.first().copied())
    }

    /// Electrons per count where the pixels are to be converted; `None` where they are electrons.
    fn gain(&mut self) -> Result<Option<f64>> {
        let (named, trust) = (self.scene.image.gain_e_per_adu, self.images.trust);
        let stated = self.facts(Quantity::GainEPerAdu).first().and_then(|fact| {
            let gain = fact.values.first().copied().filter(|gain| *gain > 0.0)?;
            Some((gain, format!("card {} = {}", fact.keyword, fact.written)))
        });
        let key = |gain: f64| (gain, GAIN.to_string());
        let is_forced = named.is_some() && self.images.overrides.iter().any(|known| known == GAIN);
        let found = match (&self.images.unit, named) {
            (_, Some(gain)) if is_forced => Some(key(gain)),
            (PixelUnit::Electrons, _) => None,
            (PixelUnit::Counts, Some(gain)) | (PixelUnit::Unstated | PixelUnit::Other(_), Some(gain)) => Some(key(gain)),
            (PixelUnit::Counts, None) => Some(stated.ok_or_else(|| {
                Error::Image(format!(
                    "the images are in counts, and nothing gives the electrons per count: {GAIN} in the scene (estimate \
                     --gain), or a card GAIN or EGAIN is needed"
                ))
            })?),
            (PixelUnit::Unstated, None) => match (stated, trust) {
                (Some((gain, card)), Trust::Neither) if gain != 1.0 => {
                    return Err(Error::Image(format!(
                        "{card} and no card BUNIT says whether the images are in counts or in electrons: {GAIN} in the \
                         scene (estimate --gain) is needed, {gain} for counts and 1 for electrons"
                    )));
                }
                (stated, Trust::File) => stated.filter(|(gain, _)| *gain != 1.0),
                _ => None,
            },
            (PixelUnit::Other(_), None) if trust == Trust::Scene => None,
            (PixelUnit::Other(unit), None) => {
                return Err(Error::Image(format!(
                    "the images are in `{unit}` (card BUNIT): electrons, or counts (adu, DN) with a gain are accepted; {GAIN} \
                     in the scene (estimate --gain) is the number of electrons per unit"
                )));
            }
        };
        if let Some((gain, source)) = &found {
            let is_forced = self.is_decided(GAIN);
            let read_noise_e =
                self.scene.image.read_noise_e.or(self.images.read_noise_e).or_else(|| self.read_noise_e());
            let padded = padded_counts::found(self.images.images_e.view(), *gain, read_noise_e);
            if let Some(padded) = padded.as_ref().filter(|padded| padded.contradicts && !is_forced) {
                return Err(Error::Image(padded.refusal(*gain, source)));
            }
            self.remarks.extend(padded.map(|padded| padded.remark(*gain)));
            self.remarks.push(format!("The images were converted to electrons: {gain} per count ({source})."));
        }
        Ok(found.map(|(gain, _)| gain))
    }
}
