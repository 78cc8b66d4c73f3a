//! Causes of a misfit: the optical parameters, all fitted together, the area of the pixels, and
//! shapes of the residual.

use super::finding::{CheckedQuantity, Finding, Verdict};
use super::{Work, chi2_of, first_used, optics, pixels_of, shapes};
use crate::control::Stage;
use crate::modal::{self, Cube, ModelCache, OpticsMinimum, OpticsStart, Status};
use crate::pipeline::modal_task::Fitted;
use crate::pipeline::residual_shape::{Shape, ShapeKind};
use crate::scene::{Optic, Scene, Setting};
use crate::{Error, Result};

/// Part of the excess of χ² that a shape of the residual must explain where there is a misfit: see
/// `misfit`.
const EXPLAINED_BY_SHAPE: f64 = 0.5;
/// Excess of χ² from which there is a misfit, in standard deviations of χ².
const MISFIT_SIGMA: f64 = 5.0;
/// Rotations that are tried beside the scene's where nothing else explains the images: a fit of the
/// rotation alone finds one that is 3 to 5° away (7 and 18 segments), and a pupil of hexagons
/// without vanes equals itself every 60°.
const ROTATIONS_DEG: [f64; 9] = [6.0, -6.0, 12.0, -12.0, 18.0, -18.0, 24.0, -24.0, 30.0];
/// Key of the side of a pixel's sensitive square.
const PIXEL_FILL: &str = "image.pixel_fill";

/// Residual of the fit with the optics of the scene.
struct SceneFitResidual {
    /// Pixels of an image that are fitted.
    pixels: f64,
    /// Images that are used.
    images: f64,
    /// Whether χ² of the first of them is more than noise explains.
    is_misfit: bool,
    /// Whether a shape of the residual explains most of that.
    is_by_shape: bool,
}

/// Optical parameters that were fitted together, and those of the scene that were not.
struct FittedTogether {
    minimum: Option<OpticsMinimum>,
    parameters: Vec<Optic>,
    others: Vec<Optic>,
}

impl Work<'_> {
    /// Optical parameters, fitted together, and shapes of the residual.
    pub(super) fn causes(&self, scene: &Scene, cache: &ModelCache, fitted: &Fitted) -> Result<Vec<Finding>> {
        let (excess, shapes) = self.with_case(fitted, cache, |case, found| {
            Ok(case.residual(found).map_or((0.0, Vec::new()), |residual| (residual.excess(), residual.shapes())))
        })?;
        let (pixels, images) = (pixels_of(fitted), fitted.fit.1.used().max(1) as f64);
        let left = SceneFitResidual {
            pixels,
            images,
            is_misfit: excess > MISFIT_SIGMA * (2.0 * pixels).sqrt(),
            is_by_shape: shapes.iter().any(|shape| shape.share > EXPLAINED_BY_SHAPE),
        };
        let together = self.fitted_together(scene, cache, fitted, &left)?;
        let square_chi2 = self.chi2_of_square_pixels(scene, cache, &shapes, &left)?;
        let own_chi2 = chi2_of(fitted);
        // What the best shape leaves.
        let left_by_shape = shapes.iter().map(|shape| 1.0 + (excess - shape.decrease) / pixels);
        let of_optics = together.minimum.iter().map(|minimum| minimum.reduced_chi2[1]);
        let scale = left_by_shape.chain(of_optics).chain(square_chi2).fold(own_chi2, f64::min).max(1.0);
        let mut findings = self.of_optics(scene, &together, &left, scale);
        findings.extend(square_chi2.and_then(|chi2| of_square_pixels([own_chi2, chi2], &left, scale)));
        findings.extend(shapes.iter().map(|shape| of_shape(shape, &left, scale)));
        if left.is_misfit && !findings.iter().any(|finding| finding.verdict == Verdict::Fault) {
            let status = *fitted.fit.1.status();
            if status != Status::Ok || own_chi2 > 2.0 {
                findings.push(Finding::new(
                    CheckedQuantity::Unexplained,
                    Verdict::Fault,
                    format!(
                        "a reduced χ² of {own_chi2:.2} that none of these explains: 'cophase estimate' tries tilts of the segments, more \
                         NCPA and reflectivities; an exposure that averages turbulence is no image of a static wavefront"
                    ),
                ));
            }
        }
        Ok(findings)
    }

    /// One finding for each optical parameter of `scene`.
    fn of_optics(&self, scene: &Scene, together: &FittedTogether, left: &SceneFitResidual, scale: f64) -> Vec<Finding> {
        let FittedTogether { minimum, parameters, others } = together;
        let mut findings = Vec::new();
        if let Some(minimum) = minimum {
            findings = optics::findings((scene, parameters), minimum, scale, !left.is_misfit || is_explained(minimum));
        }
        findings.extend(others.iter().map(|optic| {
            let grid = if *optic == Optic::ROTATION { ", or the turned pupil is larger than pupil.grid_m" } else { "" };
            let why = "its fit together with the others does not converge: the scene is far from the images, something else is wrong";
            Finding::open(optics::quantity(*optic), format!("{why}{grid}"))
        }));
        findings
    }

    /// Fits the optical parameters of `scene` together: all, or as many as converge.
    fn fitted_together(
        &self,
        scene: &Scene,
        cache: &ModelCache,
        fitted: &Fitted,
        left: &SceneFitResidual,
    ) -> Result<FittedTogether> {
        let all = optics::parameters(scene);
        let done = |minimum: Option<OpticsMinimum>, parameters: &[Optic]| {
            let parameters = if minimum.is_some() { parameters.to_vec() } else { Vec::new() };
            let others = all.iter().copied().filter(|optic| !parameters.contains(optic)).collect();
            Ok(FittedTogether { minimum, parameters, others })
        };
        // Beyond some per cent the fit of all parameters does not reach a plate scale that one
        // alone finds.
        let other =
            if left.is_misfit { self.with_case(fitted, cache, |case, found| case.other_optic(found))? } else { None };
        let mut elsewhere: Vec<_> = other.map(|other| (other.optic, other.fitted)).into_iter().collect();
        let first = self.minimum((scene, fitted), cache, &all, &elsewhere)?;
        let is_enough = |minimum: &OpticsMinimum| !left.is_misfit || left.is_by_shape || is_explained(minimum);
        if !all.contains(&Optic::ROTATION) || first.as_ref().is_some_and(is_enough) {
            return done(first, &all);
        }
        // A turned pupil may be larger than its grid.
        let unturned: Vec<Optic> = all.iter().copied().filter(|optic| *optic != Optic::ROTATION).collect();
        let without = if first.is_none() { self.minimum((scene, fitted), cache, &unturned, &elsewhere)? } else { None };
        if without.as_ref().is_some_and(is_enough) {
            return done(without, &unturned);
        }
        // Nor does it reach a rotation of some degrees.
        let Some(alone) = self.rotation(scene, cache, fitted)? else {
            return if first.is_some() { done(first, &all) } else { done(without, &unturned) };
        };
        elsewhere.extend(alone.fitter.fitted_optics().iter().map(|one| (one.optic, one.value)));
        let again = self.minimum((scene, fitted), cache, &all, &elsewhere)?;
        let only_rotation = [Optic::ROTATION];
        let found = [(first, &all[..]), (again, &all), (without, &unturned), (Some(alone), &only_rotation)];
        let chi2 = |minimum: &Option<OpticsMinimum>| minimum.as_ref().map_or(f64::INFINITY, |one| one.reduced_chi2[1]);
        let best = found.into_iter().min_by(|one, other| chi2(&one.0).total_cmp(&chi2(&other.0)));
        best.map_or_else(|| done(None, &[]), |(minimum, parameters)| done(minimum, parameters))
    }

    /// A rotation of the pupil that explains the images alone, from that of the scene on or, where
    /// that leads to none, from the best of others; `fitted` is the fit with the scene's.
    fn rotation(&self, scene: &Scene, cache: &ModelCache, fitted: &Fitted) -> Result<Option<OpticsMinimum>> {
        let only_rotation = [Optic::ROTATION];
        let near = self.minimum((scene, fitted), cache, &only_rotation, &[])?;
        if near.as_ref().is_some_and(is_explained) {
            return Ok(near);
        }
        let mut best = (chi2_of(fitted), None);
        for offset_deg in ROTATIONS_DEG {
            let rotation_deg = scene.pupil.rotation_deg + offset_deg;
            // The turned pupil may be larger than its grid.
            let Ok(turned) = scene.changed(|sections| sections.pupil.rotation_deg = rotation_deg) else { continue };
            if let Some(chi2) = self.trial_chi2(&turned, first_used(fitted))?.filter(|chi2| *chi2 < best.0) {
                best = (chi2, Some(rotation_deg));
            }
        }
        let Some(rotation_deg) = best.1 else { return Ok(None) };
        let far = self.minimum((scene, fitted), cache, &only_rotation, &[(Optic::ROTATION, rotation_deg)])?;
        Ok(far.filter(is_explained))
    }

    /// Minimum of `parameters` and the modes, which begins at the values `elsewhere` where χ² is
    /// lower there than in `fitted`; `None` where the fit does not converge or leads to values that
    /// the scene does not accept.
    fn minimum(
        &self,
        (scene, fitted): (&Scene, &Fitted),
        cache: &ModelCache,
        parameters: &[Optic],
        elsewhere: &[(Optic, f64)],
    ) -> Result<Option<OpticsMinimum>> {
        // A scene without weights fits no optics.
        let fitting = scene.system().with(|sections| sections.estimate.fit_optics = parameters.to_vec());
        let Ok(fitting) = fitting else { return Ok(None) };
        self.control.enter(Stage::Preparing, 0);
        let images = &self.images;
        let cube = Cube { images_e: images.images_e.view(), bad: images.bad.view(), read_noise_e: images.read_noise_e };
        let start = OpticsStart { values: elsewhere, own_chi2: chi2_of(fitted) };
        match modal::fit_together(&fitting, &self.policy.recipe(scene), cache, cube, &start, self.control) {
            Ok(minimum) => Ok(Some(minimum)),
            Err(error @ Error::Interrupted(_)) => Err(error),
            Err(_) => Ok(None),
        }
    }

    /// Reduced χ² with pixels that are squares without gaps, where the pixels of `scene` are points
    /// and the residual has a blur.
    fn chi2_of_square_pixels(
        &self,
        scene: &Scene,
        cache: &ModelCache,
        shapes: &[Shape],
        left: &SceneFitResidual,
    ) -> Result<Option<f64>> {
        let is_blurred =
            |shape: &Shape| shape.kind == ShapeKind::Blur && shape.value.abs() > shapes::least(ShapeKind::Blur);
        if !left.is_misfit || scene.image.pixel_fill > 0.0 || !shapes.iter().any(is_blurred) {
            return Ok(None);
        }
        let Ok(other) = scene.changed(|sections| sections.image.pixel_fill = 1.0) else { return Ok(None) };
        match self.fit(&other, &cache.for_scene(scene, &other)) {
            Ok(again) => Ok(Some(chi2_of(&again))),
            Err(error @ Error::Interrupted(_)) => Err(error),
            Err(_) => Ok(None),
        }
    }
}

/// Whether the parameters of `minimum` leave no more of a misfit than one of them may that is its
/// cause.
fn is_explained(minimum: &OpticsMinimum) -> bool {
    let [own, least] = minimum.reduced_chi2;
    (least - 1.0).max(0.0) < optics::MOST_LEFT * (own - 1.0)
}

/// Finding of pixels that are squares without gaps where the scene has points: a fault where they
/// lower the reduced χ², of the scene and of the squares, so far as an optical parameter must.
fn of_square_pixels([own_chi2, chi2]: [f64; 2], left: &SceneFitResidual, scale: f64) -> Option<Finding> {
    let gain = left.images * (own_chi2 - chi2) * left.pixels / scale - (left.images * left.pixels).max(2.0).ln();
    let is_fault = gain > 0.0 && (chi2 - 1.0).max(0.0) < optics::MOST_LEFT * (own_chi2 - 1.0);
    is_fault.then(|| Finding {
        scene: Some(0.0),
        found: Some(1.0),
        gain,
        settings: vec![Setting::new(PIXEL_FILL, 1.0)],
        ..Finding::new(
            CheckedQuantity::Optic(Optic::PIXEL_FILL),
            Verdict::Fault,
            format!(
                "pixels that are squares without gaps explain the images: reduced χ² {chi2:.2} in place of {own_chi2:.2}; the scene's are \
                 points"
            ),
        )
    })
}

/// Finding of a shape of the residual.
fn of_shape(shape: &Shape, left: &SceneFitResidual, scale: f64) -> Finding {
    // The shape is that of one image; a cause changes all.
    let gain =
        left.images * shape.decrease / scale - shape.parameters as f64 * (left.images * left.pixels).max(2.0).ln();
    let is_large = gain > 0.0 && shape.value.abs() > shapes::least(shape.kind);
    let verdict = match (is_large, !left.is_misfit || shape.share > EXPLAINED_BY_SHAPE) {
        (false, _) => Verdict::Agrees,
        (true, true) => Verdict::Fault,
        (true, false) => Verdict::NotDetermined,
    };
    shapes::finding(shape, gain, verdict)
}
