//! A run as a file of AOT, the telemetry standard of adaptive optics: see [`crate::io::aot`].
//!
//! What the standard leaves open is chosen so that an estimate from this file has the bits of one
//! from [`super::write`]: images, slopes and truth are stored with the same type and unit, and the
//! scene is in the card `CONFIG`. Commands are in m, as the standard has them: those of
//! [`super::write`], in nm as 32-bit reals, return from them after rounding to 32 bits.

use super::recorder::{Shot, Summary};
use super::sensor::SlopeFormat;
use super::simulator::{Simulator, sections};
use crate::io::aot::{AotTables, Cell, TIME_REFERENCE, image_reference as image, row_reference as row};
use crate::io::{CHANNEL, ELECTRON, FitsWriter, Pixel};
use crate::scene::{ControlScene, Loop, SensorScene, System};
use crate::source::file;
use crate::{Error, Result};
use ndarray::{Array1, Array2, Array3, Axis, array, stack};
use std::path::Path;

/// Start of the card `CONFIG` of a file of AOT whose rest is the text of a scene of cophase.
pub const AOT_SCENE: &str = "# scene of cophase\n";

/// UIDs of the components.
const TELESCOPE: &str = "TELESCOPE";
const GUIDE_STAR: &str = "GUIDE STAR";
const SENSOR: &str = "WFS";
const MIRROR: &str = "DM";
const LOOP: &str = "LOOP";
const LOOP_TIME: &str = "LOOP TIME";

/// Images of a channel: its number, the UID of its camera, its shots.
struct ChannelShots<'a> {
    number: usize,
    uid: String,
    shots: Vec<&'a Shot>,
}

impl ChannelShots<'_> {
    /// Name of the extension with the images; the channel's is not one, because names of extensions
    /// ignore case.
    fn hdu(&self, scene: &System) -> String {
        if scene.channels().is_empty() { "IMAGES".into() } else { format!("IMAGES_{}", self.number + 1) }
    }

    /// UID of the times.
    fn time(&self) -> String {
        format!("{} TIME", self.uid)
    }
}

/// Writes the images and the telemetry of a run of `simulator` as a file of AOT 2.0.0. The write is
/// atomic.
///
/// - `AOT_SCORING_CAMERAS`, `AOT_DETECTORS`: a camera for each channel of which there are images.
///   `IMAGES`: electrons, with the cards of [`super::write`].
/// - `AOT_WAVEFRONT_SENSORS`: mean slopes of each exposure, `[exposure, x and y, subaperture]`,
///   mas, or as `slope_unit_mas` of the scene has them; `SUBAPERTURE_MASK`, row 0 at the smallest
///   y.
/// - `AOT_LOOPS`: commands at the middle of each exposure, `[exposure, actuator]`, m of wavefront;
///   control matrix, nm/mas, interaction matrix, mas/nm; the filter of an integrator in rising
///   powers of 1/z, its gain first; frame rate and delay.
/// - `AOT_TIME`: middle of each exposure, s since the loop was closed.
/// - `AOT_ABERRATIONS`: segment errors (of the telescope) and NCPA (of the cameras), each one mode,
///   nm, with the coefficient 1.
/// - `AOT_ATMOSPHERIC_PARAMETERS`, `AOT_TELESCOPES`, `AOT_SOURCES`, `AOT_WAVEFRONT_CORRECTORS`:
///   those of the scene.
///
/// # Errors
/// [`Error::Image`] for a run without any image; [`Error::Value`] for a scene with
/// `wavefront_sensor.slope_order`, because the standard fixes the order of slopes; [`Error::File`]
/// where the file cannot be written.
pub fn write_aot(
    path: &Path,
    scene_text: &str,
    simulator: &Simulator,
    shots: &[Shot],
    summary: &Summary,
) -> Result<()> {
    let scene = simulator.scene();
    let (sensing, control) = sections(scene)?;
    check_aot(scene)?;
    let channels = channels(scene, shots, summary.flux_e.len());
    if channels.is_empty() {
        return Err(Error::Image("0 images to write: the run ended before its first image".into()));
    }
    let exposures = exposures(&channels);
    let mut tables = AotTables::new();
    times(&mut tables, &channels, &exposures)?;
    tables.row("AOT_ATMOSPHERIC_PARAMETERS", atmosphere(scene))?;
    aberrations(&mut tables)?;
    tables.row("AOT_TELESCOPES", telescope(simulator))?;
    tables.row("AOT_SOURCES", vec![("UID", GUIDE_STAR.into()), ("TYPE", "Natural Guide Star".into())])?;
    channels.iter().try_for_each(|channel| camera(&mut tables, scene, channel))?;
    sensor(&mut tables, simulator, sensing)?;
    mirror(&mut tables, simulator)?;
    control_loop(&mut tables, control)?;

    let mut file = FitsWriter::create(path)?;
    let configuration = format!("{AOT_SCENE}{scene_text}");
    tables.write(&mut file, "SCAO", "cophase simulation", &configuration)?;
    file.card("PRIMARY", "STREHL-R", summary.strehl, "of the residual wavefront, long exposure")?;
    file.card("PRIMARY", "STREHL-L", scene.image.wavelength_nm * 1e-9, "wavelength of that, m")?;
    for channel in &channels {
        images(&mut file, scene, channel, summary.flux_e[channel.number])?;
    }
    layers(&mut file, scene)?;
    truth(&mut file, simulator)?;
    let pupil = simulator.pupil().amplitude.mapv(|amplitude| if amplitude >= 0.5 { 1.0 } else { 0.0 });
    file.image("PUPIL_MASK", &pupil, Pixel::I32, "")?;
    telemetry(&mut file, simulator, sensing, &exposures)?;
    matrices(&mut file, simulator, control)?;
    file.finish()
}

/// Refuses, before the work of a run, a scene whose telemetry AOT cannot express.
///
/// # Errors
/// As [`write_aot`].
pub fn check_aot(scene: &System) -> Result<()> {
    let (sensing, _) = sections(scene)?;
    if sensing.is_pyramid() {
        let sentence =
            "wavefront_sensor.kind = \"pyramid\" is not written to AOT: a scene with \"shack-hartmann\" is accepted";
        return Err(Error::Value(sentence.into()));
    }
    if sensing.reference_file.is_some() {
        let sentence = "wavefront_sensor.reference_file is not written to AOT: a scene without it is accepted";
        return Err(Error::Value(sentence.into()));
    }
    let orders: Vec<&str> = sensing.slope_order.iter().map(|order| order.word()).collect();
    if orders.is_empty() {
        return Ok(());
    }
    Err(Error::Value(format!(
        "wavefront_sensor.slope_order = {orders:?} is not written to AOT, whose slopes are all x, then all y: a scene without it is accepted"
    )))
}

/// The channels that have images.
fn channels<'a>(scene: &System, shots: &'a [Shot], count: usize) -> Vec<ChannelShots<'a>> {
    let of_number = |number: usize| {
        let uid = scene.channels().get(number).map_or("CAMERA".into(), |channel| channel.name.clone());
        ChannelShots { number, uid, shots: shots.iter().filter(|shot| shot.channel == number).collect() }
    };
    (0..count).map(of_number).filter(|channel| !channel.shots.is_empty()).collect()
}

/// A shot of each exposure: simultaneous channels share the telemetry of one.
fn exposures<'a>(channels: &[ChannelShots<'a>]) -> Vec<&'a Shot> {
    let mut exposures: Vec<&Shot> = Vec::new();
    for shot in channels.iter().flat_map(|channel| &channel.shots) {
        if !exposures.iter().any(|known| known.time_s == shot.time_s) {
            exposures.push(shot);
        }
    }
    exposures
}

fn times(tables: &mut AotTables, channels: &[ChannelShots], exposures: &[&Shot]) -> Result<()> {
    let list = |shots: &[&Shot]| -> Cell { shots.iter().map(|shot| shot.time_s).collect::<Vec<f64>>().into() };
    for channel in channels {
        tables.row("AOT_TIME", vec![("UID", channel.time().into()), ("TIMESTAMPS", list(&channel.shots))])?;
    }
    tables.row("AOT_TIME", vec![("UID", LOOP_TIME.into()), ("TIMESTAMPS", list(exposures))])
}

/// Names of the images of layers, in the order of [`layers`].
const LAYERS: [(&str, &str); 5] = [
    ("LAYERS_REL_WEIGHT", "LAYERS_WEIGHT"),
    ("LAYERS_HEIGHT", "LAYERS_HEIGHT"),
    ("LAYERS_LO", "LAYERS_L0"),
    ("LAYERS_WIND_SPEED", "LAYERS_WIND_SPEED"),
    ("LAYERS_WIND_DIRECTION", "LAYERS_WIND_DIRECTION"),
];

fn atmosphere(scene: &System) -> Vec<(&'static str, Cell)> {
    let turbulence = &scene.turbulence;
    // Fried's parameter of a scene is that at 500 nm.
    let mut cells: Vec<(&str, Cell)> =
        vec![("UID", "TURBULENCE".into()), ("WAVELENGTH", 500e-9.into()), ("R0", vec![turbulence.r0_m].into())];
    if !turbulence.fractions.is_empty() {
        cells.extend(LAYERS.map(|(column, name)| (column, image(name).into())));
    }
    cells
}

/// Writes the layers of the turbulence, `[1, layer]`.
fn layers(file: &mut FitsWriter, scene: &System) -> Result<()> {
    let turbulence = &scene.turbulence;
    if turbulence.fractions.is_empty() {
        return Ok(());
    }
    // The standard's azimuth is 0 at North and grows eastward: the pupil's +y stands for North, +x
    // for East.
    let azimuth_deg = |radians: &f64| (90.0 - radians.to_degrees()).rem_euclid(360.0);
    let columns = [
        (turbulence.fractions.clone(), ""),
        (turbulence.heights_m.clone(), "m"),
        (vec![turbulence.outer_scale_m; turbulence.fractions.len()], "m"),
        (turbulence.wind_m_s.clone(), "m s-1"),
        (turbulence.wind_dir_rad.iter().map(azimuth_deg).collect(), "deg"),
    ];
    for ((_, name), (values, unit)) in LAYERS.into_iter().zip(columns) {
        file.image(name, &Array1::from(values).insert_axis(Axis(0)), Pixel::F64, unit)?;
    }
    Ok(())
}

fn aberrations(tables: &mut AotTables) -> Result<()> {
    for (uid, modes) in [("SEGMENT ERRORS", "TRUTH_PHASING"), ("NCPA", "TRUTH_NCPA")] {
        let cells =
            vec![("UID", uid.into()), ("MODES", image(modes).into()), ("COEFFICIENTS", image("COEFFICIENT").into())];
        tables.row("AOT_ABERRATIONS", cells)?;
    }
    Ok(())
}

/// Writes the truth. The map is the mode, and not its quotient by the RMS, because its bits then
/// stay.
fn truth(file: &mut FitsWriter, simulator: &Simulator) -> Result<()> {
    let truth = simulator.truth();
    let grid_m = file::grid_m(simulator.scene())?;
    for (name, map_nm) in [("TRUTH_PHASING", &truth.phasing_nm), ("TRUTH_NCPA", &truth.ncpa_nm)] {
        file.image(name, &map_nm.view().insert_axis(Axis(0)), Pixel::F64, "nm")?;
        file.card(name, "GRID_M", grid_m, "side of the map, m")?;
    }
    file.image("COEFFICIENT", &array![[1.0_f64]], Pixel::F64, "")
}

fn telescope(simulator: &Simulator) -> Vec<(&'static str, Cell)> {
    let pupil = &simulator.scene().pupil;
    let mut cells: Vec<(&str, Cell)> = vec![
        ("UID", TELESCOPE.into()),
        ("TYPE", "Main Telescope".into()),
        ("PUPIL_MASK", image("PUPIL_MASK").into()),
        ("ABERRATION_UID", row("SEGMENT ERRORS").into()),
    ];
    let Some(layout) = pupil.layout() else {
        cells.push(("SEGMENT_TYPE", "Monolithic".into()));
        return cells;
    };
    let segments = &simulator.telescope().pupil.segments;
    // A hexagon's side is the radius of the circle around it.
    let side_m = pupil.segment_side_m;
    let kind = if pupil.is_round() { "Circle" } else { "Hexagon" };
    let vertex = |k: u32| (layout.rotation_deg + 60.0 * f64::from(k)).to_radians().sin_cos();
    let corners = segments.iter().flat_map(|segment| (0..6).map(move |k| (segment, vertex(k))));
    let corners_m = corners.map(|(segment, (sin, cos))| (segment.x_m + side_m * cos).hypot(segment.y_m + side_m * sin));
    let edges_m = segments.iter().map(|segment| segment.x_m.hypot(segment.y_m) + side_m);
    let radius_m = if pupil.is_round() { edges_m.fold(0.0, f64::max) } else { corners_m.fold(0.0, f64::max) };
    cells.extend([
        ("SEGMENT_TYPE", kind.into()),
        ("SEGMENT_SIZE", (2.0 * side_m).into()),
        ("SEGMENTS_X", segments.iter().map(|segment| segment.x_m).collect::<Vec<f64>>().into()),
        ("SEGMENTS_Y", segments.iter().map(|segment| segment.y_m).collect::<Vec<f64>>().into()),
        ("ENCLOSING_D", (2.0 * radius_m).into()),
        ("OBSTRUCTION_D", pupil.central_obscuration_m.into()),
    ]);
    cells
}

fn camera(tables: &mut AotTables, scene: &System, channel: &ChannelShots) -> Result<()> {
    let own = scene.channels().get(channel.number).map_or(scene, |channel| &channel.system);
    let camera = &own.image;
    let wavelength_m = camera.wavelength_nm * 1e-9;
    let (rows, columns) = camera.frame_shape();
    let detector = format!("{} DETECTOR", channel.uid);
    let mut cells: Vec<(&str, Cell)> = vec![
        ("UID", detector.as_str().into()),
        ("PIXEL_INTENSITIES", image(&channel.hdu(scene)).into()),
        ("READOUT_NOISE", camera.simulated_read_noise_e().into()),
        ("FIELD_CENTRE_X", ((columns / 2) as f64).into()),
        ("FIELD_CENTRE_Y", ((rows / 2) as f64).into()),
        ("INTEGRATION_TIME", camera.exposure_s.into()),
        ("COADDS", Cell::Integer(1)),
        ("BINNING", Cell::Integer(1)),
        // The images are in electrons.
        ("GAIN", 1.0.into()),
    ];
    cells.extend(own.pixel_mas().map(|mas| ("PIXEL_SCALE", (mas / 3.6e6).to_radians().into())));
    if camera.bandwidth_fraction > 0.0 {
        cells.push(("BANDWIDTH", (camera.bandwidth_fraction * wavelength_m).into()));
    }
    tables.row("AOT_DETECTORS", cells)?;
    let cells = vec![
        ("UID", channel.uid.as_str().into()),
        ("WAVELENGTH", wavelength_m.into()),
        ("DETECTOR_UID", row(&detector).into()),
        ("ABERRATION_UID", row("NCPA").into()),
    ];
    tables.row("AOT_SCORING_CAMERAS", cells)
}

/// Writes the images of a channel, with the cards of [`super::write`], and their times.
fn images(file: &mut FitsWriter, scene: &System, channel: &ChannelShots, flux_e: f64) -> Result<()> {
    let hdu = channel.hdu(scene);
    let views: Vec<_> = channel.shots.iter().map(|shot| shot.image_e.view()).collect();
    let images_e: Array3<f32> =
        stack(Axis(0), &views).map_err(|error| Error::Internal(format!("images of uneven size: {error}")))?;
    file.image(&hdu, &images_e, Pixel::F32, ELECTRON)?;
    let of_scene = scene.channels().get(channel.number);
    if let Some(own) = of_scene {
        file.card(&hdu, CHANNEL, own.name.as_str(), "name of the channel")?;
    }
    file::image_cards(file, &hdu, of_scene.map_or(scene, |own| &own.system), flux_e)?;
    file.card(&hdu, TIME_REFERENCE, row(&channel.time()), "times")
}

fn sensor(tables: &mut AotTables, simulator: &Simulator, sensing: &SensorScene) -> Result<()> {
    let cells = vec![
        ("UID", SENSOR.into()),
        ("TYPE", "Shack-Hartmann".into()),
        ("SOURCE_UID", row(GUIDE_STAR).into()),
        ("DIMENSIONS", Cell::Integer(2)),
        ("N_VALID_SUBAPERTURES", Cell::Integer(simulator.lenslets().subapertures.len() as i64)),
        ("MEASUREMENTS", image("SLOPES").into()),
        ("SUBAPERTURE_MASK", image("SUBAPERTURE_MASK").into()),
        ("WAVELENGTH", (sensing.wavelength_nm * 1e-9).into()),
    ];
    tables.row("AOT_WAVEFRONT_SENSORS", cells)?;
    let cells = vec![("UID", SENSOR.into()), ("CENTROIDING_ALGORITHM", sensing.detector.word().into())];
    tables.row("AOT_WAVEFRONT_SENSORS_SHACK_HARTMANN", cells)
}

fn mirror(tables: &mut AotTables, simulator: &Simulator) -> Result<()> {
    let places_m = simulator.influence().positions_m();
    let cells = vec![
        ("UID", MIRROR.into()),
        ("TYPE", "Deformable Mirror".into()),
        ("TELESCOPE_UID", row(TELESCOPE).into()),
        ("N_VALID_ACTUATORS", Cell::Integer(places_m.len() as i64)),
    ];
    tables.row("AOT_WAVEFRONT_CORRECTORS", cells)?;
    let (x_m, y_m): (Vec<f64>, Vec<f64>) = places_m.into_iter().unzip();
    let mut cells: Vec<(&str, Cell)> =
        vec![("UID", MIRROR.into()), ("ACTUATORS_X", x_m.into()), ("ACTUATORS_Y", y_m.into())];
    let stroke_m = simulator.scene().mirror.stroke_limit_nm.map(|nm| nm * 1e-9);
    cells.extend(stroke_m.map(|stroke_m| ("STROKE", stroke_m.into())));
    tables.row("AOT_WAVEFRONT_CORRECTORS_DM", cells)
}

/// Whether the law filters each mode as a leaky integrator, which a quotient of polynomials
/// describes.
fn is_integrator(control: &ControlScene) -> bool {
    control.r#loop == Loop::Closed
}

fn control_loop(tables: &mut AotTables, control: &ControlScene) -> Result<()> {
    let mut cells: Vec<(&str, Cell)> = vec![
        ("UID", LOOP.into()),
        ("TYPE", "Control Loop".into()),
        ("COMMANDED_UID", row(MIRROR).into()),
        ("TIME_UID", row(LOOP_TIME).into()),
        ("STATUS", "Closed".into()),
        ("COMMANDS", image("COMMANDS").into()),
        ("FRAMERATE", control.frame_rate_hz.into()),
        ("DELAY", control.lag_frames.into()),
    ];
    if is_integrator(control) {
        cells.push(("TIME_FILTER_NUM", image("TIME_FILTER_NUM").into()));
        cells.push(("TIME_FILTER_DEN", image("TIME_FILTER_DEN").into()));
    }
    tables.row("AOT_LOOPS", cells)?;
    let cells = vec![
        ("UID", LOOP.into()),
        ("INPUT_SENSOR_UID", row(SENSOR).into()),
        ("CONTROL_MATRIX", image("CONTROL_MATRIX").into()),
        ("INTERACTION_MATRIX", image("INTERACTION_MATRIX").into()),
    ];
    tables.row("AOT_LOOPS_CONTROL", cells)
}

/// Writes slopes and commands of the exposures, and the mask of the subapertures.
fn telemetry(file: &mut FitsWriter, simulator: &Simulator, sensing: &SensorScene, exposures: &[&Shot]) -> Result<()> {
    let rows = |values: &dyn Fn(&Shot) -> &[f32]| {
        let flat: Vec<f64> = exposures.iter().flat_map(|shot| values(shot).iter().copied().map(f64::from)).collect();
        Array2::from_shape_vec((exposures.len(), flat.len() / exposures.len()), flat).map_err(uneven)
    };
    let lenslets = simulator.lenslets();
    let format = SlopeFormat::new(sensing, lenslets)?;
    let slopes = format.measured(rows(&|shot| &shot.mean_slopes_mas)?.view())?;
    let slopes = slopes.into_shape_with_order((exposures.len(), 2, lenslets.subapertures.len())).map_err(uneven)?;
    file.image("SLOPES", &slopes, Pixel::F32, format.unit())?;
    file.card("SLOPES", TIME_REFERENCE, row(LOOP_TIME), "times")?;
    let mut mask = Array2::from_elem((lenslets.across, lenslets.across), -1.0);
    for (number, &place) in lenslets.subapertures.iter().enumerate() {
        mask[[place / lenslets.across, place % lenslets.across]] = number as f64;
    }
    file.image("SUBAPERTURE_MASK", &mask, Pixel::I32, "")?;
    // A quotient by 1e9, and not a product with the rounded 1e-9.
    file.image("COMMANDS", &(rows(&|shot| &shot.commands_nm)? / 1e9), Pixel::F64, "m")?;
    file.card("COMMANDS", TIME_REFERENCE, row(LOOP_TIME), "times")
}

/// Writes the matrices of the loop, and the filter of an integrator.
fn matrices(file: &mut FitsWriter, simulator: &Simulator, control: &ControlScene) -> Result<()> {
    let (slopes, actuators) = simulator.interaction().dim();
    let command = simulator.law().command_matrix();
    let command = command.as_standard_layout().into_owned();
    let command = command.into_shape_with_order((actuators, 2, slopes / 2)).map_err(uneven)?;
    file.image("CONTROL_MATRIX", &command, Pixel::F64, "nm/mas")?;
    let interaction = simulator.interaction().as_standard_layout().into_owned();
    let interaction = interaction.into_shape_with_order((2, slopes / 2, actuators)).map_err(uneven)?;
    let interaction = interaction.permuted_axes([1, 0, 2]).as_standard_layout().into_owned();
    file.image("INTERACTION_MATRIX", &interaction, Pixel::F64, "mas/nm")?;
    if is_integrator(control) {
        // The next command is (1 − leak) times the last, plus gain × control matrix × slopes.
        file.image("TIME_FILTER_NUM", &array![[control.gain]], Pixel::F64, "")?;
        file.image("TIME_FILTER_DEN", &array![[1.0, control.leak - 1.0]], Pixel::F64, "")?;
    }
    Ok(())
}

fn uneven(error: ndarray::ShapeError) -> Error {
    Error::Internal(format!("telemetry of uneven length: {error}"))
}
