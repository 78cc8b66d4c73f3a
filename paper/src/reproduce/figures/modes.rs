//! Section 4.3: the estimate from a sequence of images behind the masked, inpainted, pseudo-open
//! loop, mode by mode.

use super::setup;
use crate::reproduce::on_sky::{Reader, Sequence};
use crate::reproduce::statistics::{mean, rms, standard_deviation};
use crate::reproduce::{Cell, Conditions, Progress, Report, Table, Way};
use cophase::modal::ModalEstimate;
use cophase::modes::Group;
use cophase::pupil::Pupil;
use cophase::{Error, Result};
use cophase_view::plot::{EstimatePicture, MapRms, MapTriple, ModalBars, ModeGroup};
use ndarray::{Array2, ArrayView2};
use std::path::Path;

/// The paper's best loop, and what it leaves there, phasing and NCPA, nm.
const ROW: &str = "pol-mask-inpaint";
const PUBLISHED_NM: [f64; 2] = [21.3, 31.6];

/// The estimate of one draw, held against the truth.
#[derive(Debug, Clone)]
pub struct ModalDraw {
    /// The draw.
    pub seed: usize,
    /// Names of the modes.
    pub names: Vec<String>,
    /// Their groups.
    pub groups: Vec<Group>,
    /// Mean over the images, nm.
    pub estimate_nm: Vec<f64>,
    /// Its standard error, nm.
    pub sigma_nm: Vec<f64>,
    /// Each mode's part in the truth, nm: its product with the true map over the pupil, over that
    /// with itself.
    pub truth_nm: Vec<f64>,
    /// Residual of the maps, phasing and NCPA, nm.
    pub residual_nm: [f64; 2],
}

/// All draws.
#[derive(Debug, Clone)]
pub struct Modes {
    /// In the order of their seeds.
    pub draws: Vec<ModalDraw>,
    picture: EstimatePicture,
}

/// Estimates draws 1 to `seeds` the paper's way.
///
/// # Errors
/// Those of the simulator and of the estimator; [`Error::Interrupted`].
pub fn modes(conditions: &Conditions, seeds: usize, progress: &Progress) -> Result<Modes> {
    progress.check()?;
    let row = setup::row(ROW)?;
    let reader = Reader::new(Way::Paper, &row.reading_scene(conditions)?)?;
    progress.expect(seeds * reader.estimator.scene().image.count);
    let (mut draws, mut first) = (Vec::new(), None);
    for seed in 1..=seeds {
        let sequence = Sequence::make(row, conditions, seed, progress)?;
        let none = || Error::Image(format!("none of the {} images of draw {seed} could be fitted", sequence.images()));
        let estimate = reader.fit(&sequence, progress)?.ok_or_else(none)?;
        let draw = ModalDraw::of(&reader, &sequence, &estimate, seed)?;
        if first.is_none() {
            first = Some(picture(&reader, &sequence, &estimate, &draw)?);
        }
        draws.push(draw);
    }
    let picture = first.ok_or_else(|| Error::Value("0 seeds leave nothing to draw".into()))?;
    Ok(Modes { draws, picture })
}

impl ModalDraw {
    fn of(reader: &Reader, sequence: &Sequence, estimate: &ModalEstimate, seed: usize) -> Result<Self> {
        let model = reader.estimator.model();
        let pupil = &model.telescope.pupil;
        let groups = model.basis.groups().to_vec();
        let part = |(map, group): (ArrayView2<f64>, &Group)| {
            let truth = if *group == Group::Segment { &sequence.phasing_nm } else { &sequence.ncpa_nm };
            product(pupil, map, truth.view()) / product(pupil, map, map)
        };
        let truth_nm = model.basis.maps().outer_iter().zip(&groups).map(part).collect();
        Ok(Self {
            seed,
            names: model.basis.names().to_vec(),
            groups,
            estimate_nm: estimate.combined.modes.coefficients_nm.clone(),
            sigma_nm: estimate.combined.modes.sigma_nm(),
            truth_nm,
            residual_nm: reader.residuals_nm(
                sequence,
                estimate.combined.maps.phasing_nm.view(),
                estimate.combined.maps.ncpa_nm.view(),
            )?,
        })
    }

    /// (estimate, truth) of the modes of `group`, nm.
    fn pairs(&self, group: Group) -> impl Iterator<Item = (f64, f64)> {
        let pairs = self.estimate_nm.iter().zip(&self.truth_nm).zip(&self.groups);
        pairs.filter(move |(_, g)| **g == group).map(|((estimate, truth), _)| (*estimate, *truth))
    }

    /// RMS over the modes of `group` of estimate minus truth, nm.
    pub fn error_nm(&self, group: Group) -> f64 {
        rms(&self.pairs(group).map(|(estimate, truth)| estimate - truth).collect::<Vec<f64>>())
    }

    /// Correlation of estimate and truth over the modes of `group`.
    pub fn correlation(&self, group: Group) -> f64 {
        let [ab, aa, bb] =
            self.pairs(group).fold([0.0; 3], |[ab, aa, bb], (a, b)| [ab + a * b, aa + a * a, bb + b * b]);
        ab / (aa * bb).sqrt()
    }
}

/// Σ A·a·b over the glass.
fn product(pupil: &Pupil, a: ArrayView2<f64>, b: ArrayView2<f64>) -> f64 {
    let lit = pupil.amplitude.iter().zip(a.iter().zip(b)).filter(|(weight, _)| **weight > 0.0);
    lit.map(|(weight, (a, b))| weight * a * b).sum()
}

fn picture(
    reader: &Reader,
    sequence: &Sequence,
    estimate: &ModalEstimate,
    draw: &ModalDraw,
) -> Result<EstimatePicture> {
    let pupil = &reader.estimator.model().telescope.pupil;
    let triple = |estimate: &Array2<f64>, truth: &Array2<f64>| -> Result<MapTriple> {
        Ok(MapTriple {
            estimate: pupil.remove_piston_tip_tilt(estimate.view())?,
            truth: Some(pupil.remove_piston_tip_tilt(truth.view())?),
            residual: Some(pupil.remove_piston_tip_tilt((estimate - truth).view())?),
            sigma: None,
            width_m: pupil.grid.width_m(),
            rms: MapRms::default(),
        })
    };
    let group = |group: &Group| if *group == Group::Segment { ModeGroup::Segment } else { ModeGroup::Ncpa };
    let [phasing, ncpa] = draw.residual_nm;
    Ok(EstimatePicture {
        title: format!("Mean of {} images behind the masked, inpainted, pseudo-open loop", estimate.used()),
        subtitle: vec![format!(
            "residual {phasing:.1} nm phasing, {ncpa:.1} nm NCPA (the paper: {} and {}); maps without tip and tilt",
            PUBLISHED_NM[0], PUBLISHED_NM[1]
        )],
        phasing: triple(&estimate.combined.maps.phasing_nm, &sequence.phasing_nm)?,
        ncpa: triple(&estimate.combined.maps.ncpa_nm, &sequence.ncpa_nm)?,
        bars: ModalBars {
            names: draw.names.iter().map(|name| short(name)).collect(),
            groups: draw.groups.iter().map(group).collect(),
            estimate_nm: draw.estimate_nm.clone(),
            sigma_nm: draw.sigma_nm.clone(),
            truth_nm: Some(draw.truth_nm.clone()),
        },
        images: Vec::new(),
    })
}

/// `segment-07-piston` as `piston 7`: the picture makes the words before the numbers the label of
/// the axis.
fn short(name: &str) -> String {
    let parts = name.strip_prefix("segment-").and_then(|rest| rest.split_once('-'));
    let numbered = parts.and_then(|(number, motion)| Some((number.parse::<usize>().ok()?, motion)));
    numbered.map_or_else(|| name.to_string(), |(number, motion)| format!("{motion} {number}"))
}

impl Modes {
    /// Segments and NCPA: residual of the maps, error of the coefficients, and how far they follow
    /// the truth.
    pub fn summary(&self) -> Table {
        let mut table = Table::new(&[
            "group",
            "seeds",
            "residual_nm",
            "residual_sd_nm",
            "published_nm",
            "mode_error_nm",
            "correlation",
        ]);
        for (place, (group, name)) in [(Group::Segment, "segment"), (Group::Ncpa, "ncpa")].into_iter().enumerate() {
            let of = |value: &dyn Fn(&ModalDraw) -> f64| self.draws.iter().map(value).collect::<Vec<f64>>();
            let residual = of(&|draw| draw.residual_nm[place]);
            table.push(vec![
                name.into(),
                residual.len().into(),
                Cell::Number(mean(&residual), 1),
                Cell::Number(standard_deviation(&residual), 1),
                Cell::Number(PUBLISHED_NM[place], 1),
                Cell::Number(mean(&of(&|draw| draw.error_nm(group))), 1),
                Cell::Number(mean(&of(&|draw| draw.correlation(group))), 3),
            ]);
        }
        table
    }

    /// One line for each mode and draw.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&["seed", "mode", "group", "truth_nm", "estimate_nm", "sigma_nm"]);
        for draw in &self.draws {
            for (mode, name) in draw.names.iter().enumerate() {
                table.push(vec![
                    draw.seed.into(),
                    Cell::Text(name.clone()),
                    draw.groups[mode].name().into(),
                    Cell::Number(draw.truth_nm[mode], 2),
                    Cell::Number(draw.estimate_nm[mode], 2),
                    Cell::Number(draw.sigma_nm[mode], 2),
                ]);
            }
        }
        table
    }

    /// Modes and maps of the first draw.
    pub fn picture(&self) -> &EstimatePicture {
        &self.picture
    }

    pub(in crate::reproduce) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["modes.csv", "modes-draws.csv", "modes.png"].map(|name| directory.join(name));
        self.summary().write_csv(&files[0])?;
        self.table().write_csv(&files[1])?;
        self.picture.draw(&files[2])?;
        let text =
            "ModalEstimate behind the masked, inpainted, pseudo-open loop, the paper's way: residual of the maps (tip and \
                    tilt removed),\nRMS error of the coefficients, correlation with the truth over the modes\n"
                .to_string()
                + &self.summary().text();
        Ok(Report { text, files: files.to_vec() })
    }
}
