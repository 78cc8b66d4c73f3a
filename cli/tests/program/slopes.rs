//! Slopes of the wavefront sensor from a file of their own.

use crate::Desk;
use cophase::io::{FitsReader, FitsWriter, Pixel};
use ndarray::s;

const SKY: &str = include_str!("../../../tests/c_api/sky.toml");

#[test]
#[ignore = "merge: 7 s"]
fn slopes_in_a_file_of_their_own_are_those_beside_the_images() {
    let desk = Desk::with_scene();
    std::fs::write(desk.path("sky.toml"), SKY).unwrap();
    desk.succeeds(&["simulate", "sky.toml", "-o", "sky.fits"]);
    let mut file = FitsReader::open(desk.path("sky.fits")).unwrap();
    let (images, slopes) = (file.cube("IMAGES").unwrap(), file.map(Some("SLOPES_MEAN")).unwrap());
    let write = |name: &str, hdu: &str, values: &ndarray::Array2<f64>| {
        let mut file = FitsWriter::create(desk.path(name)).unwrap();
        file.image("POSITIONS", &(values * 7.0), Pixel::F64, "").unwrap();
        file.image(hdu, values, Pixel::F64, "mas").unwrap();
        file.finish().unwrap();
    };
    let mut bare = FitsWriter::create(desk.path("bare.fits")).unwrap();
    bare.image("IMAGES", &images, Pixel::F64, "electron").unwrap();
    bare.finish().unwrap();
    write("wfs.fits", "SLOPES_MEAN", &slopes);
    write("rtc.fits", "S", &slopes);
    write("short.fits", "SLOPES", &slopes.slice(s![1.., ..]).to_owned());
    let estimate = |images: &str, more: &[&str]| {
        let fixed =
            ["estimate", images, "--scene", "sky.toml", "-o", "est.fits", "--method", "full-phase", "--device", "cpu"];
        [&fixed[..], more].concat().into_iter().map(str::to_owned).collect::<Vec<_>>()
    };
    let json = |images: &str, more: &[&str]| {
        let arguments = estimate(images, &[more, &["--json"]].concat());
        let json = desk.json(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
        ["ao_knowledge", "phasing_rms_nm", "ncpa_rms_nm", "ncpa_sigma_nm", "telemetry_gain"]
            .map(|key| json[key].clone())
    };
    let expected = json("sky.fits", &[]);
    assert_eq!(expected[0], "telemetry");
    // The HDU of that name, and one that is chosen in brackets.
    assert_eq!(json("bare.fits", &["--slopes", "wfs.fits"]), expected);
    assert_eq!(json("bare.fits", &["--slopes", "rtc.fits[S]"]), expected);
    let refuses = |more: &[&str], words: &[&str]| {
        let arguments = estimate("bare.fits", more);
        desk.refuses(&arguments.iter().map(String::as_str).collect::<Vec<_>>(), words);
    };
    let (given, needed) =
        (format!("slopes of {} exposures", images.dim().0 - 1), format!("each of {}", images.dim().0));
    refuses(&["--slopes", "short.fits"], &["short.fits", &given, &needed]);
    refuses(&["--slopes", "K=wfs.fits"], &["--slopes", "channel K", "no images", "without a channel's name"]);
    refuses(&["--slopes", "missing.fits"], &["missing.fits"]);
}
