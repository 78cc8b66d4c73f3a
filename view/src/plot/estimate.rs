//! The picture of an estimate: maps, coefficients and the image it explains.

use super::bars::{self, ModalBars};
use super::canvas::Rect;
use super::colour::Shade;
use super::frame::{LEFT, MARGIN, PAGE_W, heading, heading_height};
use super::page;
use super::panel::{Extent, MapPanel, draw_row, rms, rms_text, root_mean_square, row_height};
use cophase::{Error, Result};
use ndarray::{Array2, ArrayView2};
use std::path::Path;

/// The maps of one part of the wavefront (phasing, or NCPA). `[row = y, col = x]`, nm of optical
/// path difference, NaN outside the pupil; all of the shape of `estimate`.
#[derive(Debug, Clone)]
pub struct MapTriple {
    /// What was estimated, nm.
    pub estimate: Array2<f64>,
    /// What was there, nm, where that is known.
    pub truth: Option<Array2<f64>>,
    /// Estimate minus truth as the caller compares them (e.g. tip and tilt removed), nm; their
    /// plain difference where it is not given.
    pub residual: Option<Array2<f64>>,
    /// 1σ of the estimate, nm.
    pub sigma: Option<Array2<f64>>,
    /// Width of the maps, m.
    pub width_m: f64,
    /// The RMS that is written above each map, where the caller has a definition of its own.
    pub rms: MapRms,
}

/// RMS of the maps of a [`MapTriple`], nm, as the caller defines them (over the pupil's weight, tip
/// and tilt removed, as in the report); `None` is the RMS over the finite samples, about their
/// mean.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MapRms {
    /// Of the estimate.
    pub estimate_nm: Option<f64>,
    /// Of the truth.
    pub truth_nm: Option<f64>,
    /// Of the residual.
    pub residual_nm: Option<f64>,
    /// Of 1σ.
    pub sigma_nm: Option<f64>,
}

/// An image, the model's, and their difference in units of its noise; pixels that were not used are
/// NaN.
#[derive(Debug, Clone)]
pub struct ImageTriple {
    /// Name of its channel; empty for the only one.
    pub name: String,
    /// The image, electrons.
    pub data: Array2<f64>,
    /// The model, electrons.
    pub model: Array2<f64>,
    /// (data − model)/σ.
    pub residual_in_sigma: Array2<f64>,
}

/// One figure of an estimate: a row of maps for the phasing and one for the NCPA (estimate, truth,
/// residual; or estimate and 1σ side by side in one row where there is no truth), the coefficients
/// with their error bars, and the images, each beside its model and the residual.
#[derive(Debug, Clone)]
pub struct EstimatePicture {
    /// One line.
    pub title: String,
    /// Lines below the title.
    pub subtitle: Vec<String>,
    /// The segments' part.
    pub phasing: MapTriple,
    /// The part behind the adaptive optics.
    pub ncpa: MapTriple,
    /// The coefficients; may be empty.
    pub bars: ModalBars,
    /// The images that are to be shown, one below the other.
    pub images: Vec<ImageTriple>,
}

/// Space between the rows of the page.
const GAP: f64 = 20.0;

impl EstimatePicture {
    /// Draws the picture into `path`, a `.png` or an `.svg`, whole or not at all.
    ///
    /// # Errors
    /// [`Error::Shape`] for lists or maps of unequal shape, [`Error::Value`] for an impossible
    /// width, [`Error::File`] for another extension or a file that cannot be written.
    pub fn draw(&self, path: impl AsRef<Path>) -> Result<()> {
        self.phasing.check("phasing")?;
        self.ncpa.check("NCPA")?;
        self.bars.check()?;
        let (phasing_difference, ncpa_difference) = (self.phasing.difference(), self.ncpa.difference());
        let phasing = self.phasing.panels("Phasing", phasing_difference.as_ref());
        let ncpa = self.ncpa.panels("NCPA", ncpa_difference.as_ref());
        // Without truth there are at most two panels a part: one row holds both.
        let rows: Vec<Vec<MapPanel>> = if phasing.len().max(ncpa.len()) <= 2 {
            vec![phasing.into_iter().chain(ncpa).collect()]
        } else {
            vec![phasing, ncpa]
        };
        let images: Vec<_> = self.images.iter().map(ImageTriple::panels).collect();

        let inner = PAGE_W - MARGIN;
        let cell_w = |panels: &[MapPanel]| inner / panels.len().max(3) as f64;
        let strip = self.bars.truth_nm.is_some();
        let heading_h = heading_height(self.subtitle.len());
        let maps_h: f64 = rows.iter().map(|row| row_height(cell_w(row)) + GAP).sum();
        let bars_h = if self.bars.names.is_empty() { 0.0 } else { bars::row_height(strip) + GAP };
        let images_h: f64 = images.iter().map(|row| row_height(cell_w(row)) + GAP).sum();
        let height = heading_h + maps_h + bars_h + images_h + GAP;

        page::draw(path.as_ref(), (PAGE_W as u32, height.ceil() as u32), |canvas| {
            heading(canvas, MARGIN / 2.0 + LEFT, PAGE_W, &self.title, &self.subtitle);
            let mut y = heading_h;
            for row in &rows {
                draw_row(canvas, row, PAGE_W, cell_w(row), y);
                y += row_height(cell_w(row)) + GAP;
            }
            if bars_h > 0.0 {
                let cell = Rect { x: MARGIN / 2.0, y, w: inner, h: bars_h - GAP };
                bars::draw(canvas, &self.bars, cell);
                y += bars_h;
            }
            for row in &images {
                draw_row(canvas, row, PAGE_W, cell_w(row), y);
                y += row_height(cell_w(row)) + GAP;
            }
        })
    }
}

impl MapTriple {
    fn check(&self, name: &str) -> Result<()> {
        let shape = self.estimate.dim();
        let others = [("truth", &self.truth), ("residual", &self.residual), ("sigma", &self.sigma)];
        for (what, map) in others.iter().filter_map(|(what, map)| Some((what, map.as_ref()?))) {
            if map.dim() != shape {
                let message = format!("the {name} {what} map is {:?} where the estimate is {shape:?}", map.dim());
                return Err(Error::Shape(format!("{message}: the maps of one picture need one shape")));
            }
        }
        super::check_width(self.width_m, name)
    }

    /// Estimate minus truth, where the caller gave no residual.
    fn difference(&self) -> Option<Array2<f64>> {
        if self.residual.is_some() { None } else { self.truth.as_ref().map(|truth| &self.estimate - truth) }
    }

    /// Estimate, truth, residual; estimate and 1σ where there is no truth.
    fn panels<'a>(&'a self, part: &str, difference: Option<&'a Array2<f64>>) -> Vec<MapPanel<'a>> {
        let panel = |what: &str, values: ArrayView2<'a, f64>, shade: Shade, figure: String| MapPanel {
            name: format!("{part} {what}").trim_end().to_string(),
            figure,
            values,
            shade,
            extent: Extent::Metres(self.width_m),
            unit: "nm",
            labels: &[],
        };
        let rms_of = |map: &Array2<f64>, given: Option<f64>| rms_text(given.unwrap_or_else(|| rms(map.view())), "nm");
        let shared: Vec<_> =
            [Some(&self.estimate), self.truth.as_ref()].into_iter().flatten().map(|map| map.view()).collect();
        let shade = Shade::diverging(&shared, 0.0);

        // Alone, it needs no word to tell it from the truth.
        let estimate = if self.truth.is_some() { "estimate" } else { "" };
        let mut panels =
            vec![panel(estimate, self.estimate.view(), shade.clone(), rms_of(&self.estimate, self.rms.estimate_nm))];
        if let Some(truth) = &self.truth {
            panels.push(panel("truth", truth.view(), shade, rms_of(truth, self.rms.truth_nm)));
        }
        let rms_of_sigma = |sigma: &Array2<f64>| root_mean_square(sigma.iter().copied());
        let predicted = self.sigma.as_ref().map(|sigma| self.rms.sigma_nm.unwrap_or_else(|| rms_of_sigma(sigma)));
        if let Some(residual) = self.residual.as_ref().or(difference) {
            let figure = match predicted {
                Some(sigma) => {
                    format!("{} (1σ: {})", rms_of(residual, self.rms.residual_nm), super::axis::figure(sigma))
                }
                None => rms_of(residual, self.rms.residual_nm),
            };
            panels.push(panel("residual", residual.view(), Shade::diverging(&[residual.view()], 0.0), figure));
        } else if let (Some(sigma), Some(predicted)) = (&self.sigma, predicted) {
            panels.push(panel("1σ", sigma.view(), Shade::sequential(&[sigma.view()]), rms_text(predicted, "nm")));
        }
        panels
    }
}

impl ModalBars {
    fn check(&self) -> Result<()> {
        let modes = self.names.len();
        let lists = [
            ("groups", Some(self.groups.len())),
            ("estimate_nm", Some(self.estimate_nm.len())),
            ("sigma_nm", Some(self.sigma_nm.len())),
            ("truth_nm", self.truth_nm.as_ref().map(Vec::len)),
        ];
        for (list, length) in lists.into_iter().filter_map(|(list, length)| Some((list, length?))) {
            if length != modes {
                return Err(Error::Shape(format!(
                    "the modal bars have {modes} names but {length} entries in `{list}`: every list needs one entry a mode"
                )));
            }
        }
        Ok(())
    }
}

impl ImageTriple {
    /// The residual's scale reaches at least this many σ: pure noise should look like noise, and
    /// less like nothing.
    const LEAST_SIGMA: f64 = 3.0;

    fn panels(&self) -> Vec<MapPanel<'_>> {
        let panel = |what: &str, values, shade, unit, figure| MapPanel {
            // What is too long is cut at its end.
            name: if self.name.is_empty() { what.into() } else { format!("{what}, {}", self.name) },
            figure,
            values,
            shade,
            extent: Extent::Pixels,
            unit,
            labels: &[],
        };
        let shade = Shade::stretched(&[self.data.view(), self.model.view()], self.model.view());
        let residual = self.residual_in_sigma.view();
        let figure = rms_text(root_mean_square(residual.iter().copied()), "σ");
        vec![
            panel("Image", self.data.view(), shade.clone(), "e⁻", String::new()),
            panel("Model", self.model.view(), shade, "e⁻", String::new()),
            panel("Image − model", residual, Shade::diverging(&[residual], Self::LEAST_SIGMA), "σ", figure),
        ]
    }
}
