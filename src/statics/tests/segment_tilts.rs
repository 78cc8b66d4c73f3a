//! Tips and tilts of the segments in the static estimate.

use super::{KnownWavefronts, SimulatedWavefronts, run, run_with};
use crate::ao::Simulator;
use crate::control::Control;
use crate::linear_algebra::SpdInverse;
use crate::loop_response::{ClosedLoopResponse, SegmentLimits};
use crate::metrics::residual_nm;
use crate::modes::{SegmentModes, tilt_frames};
use crate::pupil::Pupil;
use crate::retrieval::IlluminatedSamples;
use crate::scene::AoKnowledge;
use crate::statics::common_figure::common_figures;
use crate::statics::covariance::ResidualCovariance;
use crate::statics::least_squares::StaticModel;
use crate::statics::mean_covariance::MeanCovariance;
use crate::statics::wavefront_source::RetrievedSequence;
use crate::statics::{Iteration, StaticsSettings, TiltSelection, estimate_static_errors};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, s};

fn estimated(
    (simulator, run): &(Simulator, SimulatedWavefronts),
    ao_knowledge: AoKnowledge,
    tilts: TiltSelection,
) -> Iteration {
    let wavefront_nm = run.wavefronts_nm();
    let images = wavefront_nm.nrows();
    let slopes = run.shots[0].mean_slopes_mas.len();
    let slopes_mas = Array2::from_shape_fn((images, slopes), |(i, k)| f64::from(run.shots[i].mean_slopes_mas[k]));
    let sequence = RetrievedSequence { wavefront_nm, reduced_chi2: vec![1.0; images], slopes_mas: Some(slopes_mas) };
    let settings = StaticsSettings { ao_knowledge, tilts, ..StaticsSettings::default() };
    let mut known = KnownWavefronts(run.samples.clone(), Some(sequence));
    estimate_static_errors(simulator.scene(), &mut known, &settings, &Control::default()).unwrap().pop().unwrap()
}

/// Coefficients of a map of segments with pistons, tips and tilts.
fn coefficients_of(phasing_nm: &Array2<f64>, pupil: &Pupil) -> Vec<f64> {
    let basis = SegmentModes::PistonTipTilt.maps(pupil).unwrap();
    let weighted_nm = phasing_nm.mapv(|nm| if nm.is_nan() { 0.0 } else { nm }) * &pupil.amplitude;
    let (sums_nm, areas) = (basis.along(&weighted_nm).unwrap(), basis.along(&pupil.amplitude).unwrap());
    (0..sums_nm.len()).map(|mode| sums_nm[mode] / areas[mode % pupil.segments.len()]).collect()
}

/// Wavefronts of the segment modes at all illuminated samples, `[mode, sample]`.
fn segment_columns((simulator, run): &(Simulator, SimulatedWavefronts)) -> Array2<f64> {
    let tilts = run.samples.tilts(&tilt_frames(&simulator.telescope().pupil).unwrap());
    ndarray::concatenate(Axis(0), &[run.samples.pistons.view(), tilts.view()]).unwrap()
}

/// RMS over the bright samples without mean and plane.
fn rms_without_plane(wavefront_nm: &Array1<f64>, samples: &IlluminatedSamples) -> f64 {
    let kept = samples.select_bright(0.5);
    let mut left_nm = wavefront_nm.select(Axis(0), &kept);
    let bright = samples.subset(&kept);
    // Orthogonal to each other over a symmetric pupil.
    for plane in [vec![1.0; kept.len()], bright.xs_m, bright.ys_m].map(Array1::from) {
        let share = left_nm.dot(&plane) / plane.dot(&plane);
        left_nm.scaled_add(-share, &plane);
    }
    (left_nm.dot(&left_nm) / kept.len() as f64).sqrt()
}

#[test]
fn tilts_are_estimated_where_they_are_significant() {
    let tilted = run_with(&[("aberrations.segment_tip_tilt_rms_nm", "20")]);
    let (pupil, truth) = (&tilted.0.telescope().pupil, tilted.0.truth());
    let left_nm = |found: &Iteration| {
        [
            residual_nm(pupil, found.maps.phasing_nm.view(), truth.phasing_nm.view()).unwrap(),
            residual_nm(pupil, found.maps.ncpa_nm.view(), truth.ncpa_nm.view()).unwrap(),
        ]
    };
    let [never, adopted, always] = [TiltSelection::Never, TiltSelection::WhereSignificant, TiltSelection::Always]
        .map(|tilts| estimated(&tilted, AoKnowledge::Telemetry, tilts));
    assert!(!never.has_tilts() && adopted.segment_tilts.unwrap().is_significant());
    assert!(always.segment_tilts.is_none());
    // The same wavefronts, and so the same estimate, to what the loop moves by when it is taken to
    // be at rest.
    let apart =
        adopted.modes().coefficients_nm.into_iter().zip(always.modes().coefficients_nm).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f64::max) < 0.1);

    // Smooth shapes of many segments are in no image behind the loop; what the loop leaves of the
    // errors is.
    let mut response = ClosedLoopResponse::new(tilted.0.scene(), &tilted.1.samples).unwrap();
    let true_nm = coefficients_of(&truth.phasing_nm, pupil);
    let columns = segment_columns(&tilted);
    let mut behind_loop_nm = |found: &Iteration| {
        let mut found_nm = found.modes().coefficients_nm[..found.errors.segment_modes()].to_vec();
        found_nm.resize(21, 0.0);
        let mut wavefront_nm = |nm: &[f64]| ArrayView1::from(nm).dot(&columns) + response.response_nm(nm).unwrap();
        rms_without_plane(&(wavefront_nm(&found_nm) - wavefront_nm(&true_nm)), &tilted.1.samples)
    };
    let behind_nm = [&never, &adopted].map(&mut behind_loop_nm);
    let (total_nm, averaged_nm) = (adopted.error_budget.total_nm, adopted.error_budget.averaged_nm());
    println!("{:.2?} {:.2?}, behind the loop {behind_nm:.2?}", left_nm(&never), left_nm(&adopted));
    println!("{total_nm:.2?} {averaged_nm:.2?} {:?} {:.2?}", adopted.segment_tilts, adopted.errors.prior_rms_nm);
    // 5.6 and 3.7 nm of the turbulence of 40 images; a pupil of seven segments has few edges, and
    // most of its shapes are compensated.
    assert!(behind_nm[1] < 0.8 * behind_nm[0] && left_nm(&adopted)[0] < left_nm(&never)[0]);
    // As in `errors_decrease_with_the_knowledge_of_the_ao`, for one draw.
    let [phasing_nm, ncpa_nm] = left_nm(&adopted);
    assert!(phasing_nm < 3.0 * total_nm[0] && ncpa_nm < 3.0 * total_nm[1] && behind_nm[1] < 3.0 * averaged_nm[0]);
    assert!(averaged_nm[0] < total_nm[0] && ncpa_nm < 10.0);
    super::assert_terms_add_up(&adopted);

    // Maps, names and covariance are those of pistons, tips, tilts and NCPA.
    let names = adopted.mode_names();
    assert_eq!((names.len(), names[7].as_str()), (adopted.modes().coefficients_nm.len(), "segment-00-tip"));
    assert_eq!(adopted.errors.covariance_nm2.dim(), (names.len(), names.len()));
    let segments_nm = &adopted.modes().coefficients_nm[..21];
    let maps = SegmentModes::PistonTipTilt.maps(pupil).unwrap().maps();
    let phasing_nm = segments_nm
        .iter()
        .zip(maps.outer_iter())
        .fold(Array2::<f64>::zeros(pupil.amplitude.dim()), |sum, (nm, map)| sum + &(&map * *nm));
    // The whole mirror has no piston, tip and tilt by convention: taking them out changes a map by
    // rounding of some 100 nm.
    let flat_nm = pupil.remove_piston_tip_tilt(phasing_nm.view()).unwrap();
    let lit = pupil
        .owner
        .iter()
        .zip(&flat_nm)
        .zip(&phasing_nm)
        .zip(&adopted.maps.phasing_nm)
        .filter(|(((o, _), _), _)| **o >= 0);
    assert!(lit.clone().all(|(((_, flat), nm), found)| (flat - nm).abs() < 1e-6 && (found - nm).abs() < 1e-9));
    // Nor has it error bars: the mean piston's are rounding of variances of some 100 nm².
    let areas = pupil.segment_areas();
    let mean: Array1<f64> =
        (0..names.len()).map(|mode| if mode < 7 { areas[mode] / areas.iter().sum::<f64>() } else { 0.0 }).collect();
    let variance_nm2 = mean.dot(&adopted.errors.covariance_nm2.dot(&mean));
    assert!(variance_nm2.abs() < 1e-6, "{variance_nm2}");

    // Corrections leave what the estimate leaves: tilts that exceed their error bars, and no plane
    // is taken off the pistons alone.
    let corrected = adopted.corrections(tilted.0.scene(), None, SegmentLimits::NONE).unwrap();
    assert_eq!((corrected.tilts_nm.len(), corrected.tilt_estimate_nm.len(), corrected.limited), (14, 14, 0));
    let estimates = corrected.estimate_nm.iter().chain(&corrected.tilt_estimate_nm).zip(segments_nm);
    assert!(estimates.into_iter().all(|([nm, sigma_nm], wanted)| (nm - wanted).abs() < 1e-12 && *sigma_nm > 0.0));
    let added = corrected.pistons_nm.iter().chain(&corrected.tilts_nm).zip(segments_nm);
    assert!(added.into_iter().all(|(add, nm)| *add == 0.0 || *add == -nm));
    assert!(corrected.tilts_nm.iter().filter(|add| **add != 0.0).count() > 7);
}

/// A curvature of all segments alike is, behind a loop that takes out smooth shapes, a paraboloid
/// of pistons and tilts.
#[test]
fn a_figure_of_all_segments_does_not_become_pistons_and_tilts() {
    let (simulator, run) = run();
    let kept = run.samples.select_bright(0.5);
    let samples = run.samples.subset(&kept);
    let tilts = samples.tilts(&tilt_frames(&simulator.telescope().pupil).unwrap());
    let segments = ndarray::concatenate(Axis(0), &[samples.pistons.view(), tilts.view()]).unwrap();
    let polynomials = Array2::from_shape_fn((6, samples.len()), |(mode, s)| {
        let (x, y) = (samples.xs_m[s], samples.ys_m[s]);
        [1.0, x, y, x * x, x * y, y * y][mode]
    });
    let normal = SpdInverse::new(&polynomials.dot(&polynomials.t())).unwrap().inverse;
    let columns = &segments - &segments.dot(&polynomials.t()).dot(&normal).dot(&polynomials);
    let figures = common_figures(segments.view(), columns.view(), &samples).unwrap();
    let mut residuals_nm = run.wavefronts_nm().select(Axis(1), &kept);
    residuals_nm -= &residuals_nm.mean_axis(Axis(0)).unwrap();
    let residual = ResidualCovariance::from_residuals(&samples, residuals_nm.view()).unwrap();
    let covariance = MeanCovariance::new(&residual, 100_000, 0.1, &samples);
    let smooth = polynomials.slice(s![1..3, ..]);
    let drawn_nm = Array1::from_shape_fn(21, |mode| [50.0, 20.0][usize::from(mode >= 7)] * (2.3 * mode as f64).sin());
    let mean_nm = drawn_nm.dot(&columns);
    // What 3 nm of focus of each segment change of the pistons and tilts, nm RMS.
    let change_nm = |figures: ArrayView2<f64>, figure_nm: ArrayView1<f64>| {
        let modes = (smooth, figures);
        let mut model = StaticModel::new((columns.view(), 7), modes, (&[2], false), &covariance).unwrap();
        let [without, with] = [0.0, 3.0]
            .map(|nm| model.estimate((&mean_nm + &(nm * &figure_nm)).view(), None, None).unwrap().segments_nm());
        let change_nm: Array1<f64> = with.into_iter().zip(without).map(|(with, without)| with - without).collect();
        rms_without_plane(&change_nm.dot(&segments), &samples)
    };
    let known_nm = change_nm(figures.view(), figures.row(0));
    let unknown_nm = change_nm(figures.slice(s![..0, ..]), figures.row(0));
    println!("{known_nm:.2} {unknown_nm:.2}");
    // Without a figure in the model its 3 nm are a paraboloid of some 30 nm over seven segments;
    // with it the prior of 1 nm weighs next to nothing beside 100,000 images.
    assert!(known_nm < 0.1 * unknown_nm && unknown_nm > 10.0, "{known_nm} {unknown_nm}");
}

#[test]
#[ignore = "merge: 2 s"]
fn segments_without_tilts_have_the_estimate_of_pistons() {
    let plain = run();
    let [never, auto] = [TiltSelection::Never, TiltSelection::WhereSignificant]
        .map(|tilts| estimated(&plain, AoKnowledge::Telemetry, tilts));
    assert!(!auto.segment_tilts.unwrap().is_significant() && !auto.has_tilts(), "{:?}", auto.segment_tilts);
    assert_eq!(
        (auto.modes().coefficients_nm, auto.errors.covariance_nm2.clone()),
        (never.modes().coefficients_nm, never.errors.covariance_nm2.clone())
    );
}

#[test]
#[ignore = "merge: 2 s"]
fn tilts_that_are_not_there_cost_little() {
    let plain = run();
    let [never, always] =
        [TiltSelection::Never, TiltSelection::Always].map(|tilts| estimated(&plain, AoKnowledge::Telemetry, tilts));
    let left_nm = |found: &Iteration| {
        residual_nm(&plain.0.telescope().pupil, found.maps.phasing_nm.view(), plain.0.truth().phasing_nm.view())
            .unwrap()
    };
    println!("{:.2} {:.2} {:.2?}", left_nm(&never), left_nm(&always), always.errors.prior_rms_nm);
    assert!(left_nm(&always) < 1.5 * left_nm(&never), "{} {}", left_nm(&always), left_nm(&never));
}

/// An unknown loop's response to tilts counts as NCPA, as that to pistons.
#[test]
fn tilts_are_estimated_behind_an_unknown_loop() {
    let tilted = run_with(&[("aberrations.segment_tip_tilt_rms_nm", "20")]);
    let [never, adopted] = [TiltSelection::Never, TiltSelection::WhereSignificant]
        .map(|tilts| estimated(&tilted, AoKnowledge::Spectrum, tilts));
    let left_nm = |found: &Iteration| {
        residual_nm(&tilted.0.telescope().pupil, found.maps.phasing_nm.view(), tilted.0.truth().phasing_nm.view())
            .unwrap()
    };
    println!("{:.2} {:.2}", left_nm(&never), left_nm(&adopted));
    assert!(adopted.has_tilts() && left_nm(&adopted) < 0.7 * left_nm(&never));
}

/// Without noise the linear model returns what its columns were added up from.
#[test]
fn drawn_segment_modes_are_recovered_from_a_mean_wavefront() {
    let (simulator, run) = run();
    let samples = run.samples.subset(&run.samples.select_bright(0.5));
    let tilts = samples.tilts(&tilt_frames(&simulator.telescope().pupil).unwrap());
    let columns = ndarray::concatenate(Axis(0), &[samples.pistons.view(), tilts.view()]).unwrap();
    let kept = run.samples.select_bright(0.5);
    let mut residuals_nm = run.wavefronts_nm().select(Axis(1), &kept);
    residuals_nm -= &residuals_nm.mean_axis(Axis(0)).unwrap();
    let residual = ResidualCovariance::from_residuals(&samples, residuals_nm.view()).unwrap();
    let covariance = MeanCovariance::new(&residual, 100_000, 0.1, &samples);
    let smooth = Array2::from_shape_fn((2, samples.len()), |(mode, s)| [samples.xs_m[s], samples.ys_m[s]][mode]);
    let mut model = StaticModel::new(
        (columns.view(), 7),
        (smooth.view(), Array2::zeros((0, samples.len())).view()),
        (&[2], false),
        &covariance,
    )
    .unwrap();
    let mut drawn_nm: Vec<f64> =
        (0..21).map(|mode| [50.0, 20.0][usize::from(mode >= 7)] * (2.3 * mode as f64).sin()).collect();
    // Images are blind to the mean of the pistons.
    let mean_nm = drawn_nm[..7].iter().sum::<f64>() / 7.0;
    drawn_nm[..7].iter_mut().for_each(|nm| *nm -= mean_nm);
    let found = model.estimate(ArrayView1::from(&drawn_nm).dot(&columns).view(), None, None).unwrap();
    assert_eq!((found.pistons_nm.len(), found.tilts_nm.len(), found.ncpa_nm.len()), (7, 14, 2));
    // A plane is degenerate with the two smooth modes: it is compared without it.
    let off = ArrayView1::from(&found.segments_nm()).dot(&columns) - ArrayView1::from(&drawn_nm).dot(&columns);
    let rms_nm = rms_without_plane(&off, &samples);
    // Turbulence of some 100 nm averaged over 100,000 images, and 0.1 nm a sample.
    assert!(rms_nm < 0.3, "{rms_nm}");
    // Hyperparameters: pistons, tilts, the flat one of the two modes, the offset.
    assert_eq!(found.prior_rms_nm.len(), 4);
    let rms = |values: &[f64]| (values.iter().map(|nm| nm * nm).sum::<f64>() / values.len() as f64).sqrt();
    assert!((found.prior_rms_nm[1] / rms(&drawn_nm[7..]) - 1.0).abs() < 0.3, "{:?}", found.prior_rms_nm);
}

#[test]
fn linear_tilt_response_is_the_derivative_of_the_response() {
    let (simulator, run) = run();
    let mut response = ClosedLoopResponse::new(simulator.scene(), &run.samples).unwrap();
    let linear = response.linear_response(&[0.0; 21], 7..21).unwrap();
    let norm = |values: &Array1<f64>| values.dot(values).sqrt();
    // The tip of an outer segment and the tilt of another.
    for mode in [8, 19] {
        let mut at = |nm: f64| {
            let mut segments_nm = vec![0.0; 21];
            segments_nm[mode] = nm;
            response.response_nm(&segments_nm).unwrap()
        };
        let difference = (at(5.0) - at(-5.0)) / 10.0;
        let off = norm(&(&difference - &linear.row(mode - 7))) / norm(&difference);
        println!("{mode}: {off:.3}");
        // A quad cell is linear to some percent over a tilt of 20 nm, with which the linear part is
        // measured.
        assert!(off < 0.05, "{off}");
    }
    // The loop flattens a plane through the segments, that of single segments by a part.
    let pupil = &simulator.telescope().pupil;
    let frames = tilt_frames(pupil).unwrap();
    let along_x = Array2::from_shape_fn(pupil.amplitude.dim(), |(_, x)| 20.0 * pupil.grid.coordinate_m(x));
    let mut plane_nm = coefficients_of(&along_x, pupil);
    // Rounding of the cross products of tip and tilt.
    plane_nm[14..].fill(0.0);
    let tilts = run.samples.tilts(&frames);
    let columns = ndarray::concatenate(Axis(0), &[run.samples.pistons.view(), tilts.view()]).unwrap();
    let kept = run.samples.select_bright(0.5);
    let at_kept = |map: &Array1<f64>| {
        let map = map.select(Axis(0), &kept);
        let mean = map.mean().unwrap();
        map - mean
    };
    let plane = at_kept(&ArrayView1::from(&plane_nm).dot(&columns));
    let left = &plane + &at_kept(&response.response_nm(&plane_nm).unwrap());
    println!("{:.3}", norm(&left) / norm(&plane));
    assert!(norm(&left) < 0.1 * norm(&plane), "{}", norm(&left) / norm(&plane));
}
