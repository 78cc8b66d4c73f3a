//! Images of one file that are not of one wavefront.

use crate::Desk;
use cophase::io::FitsReader;
use ndarray::Axis;

#[test]
fn contradicting_images_end_with_status_3_under_strict() {
    let desk = Desk::with_images(&["image.count=2", "aberrations.segment_piston_rms_nm=50"]);
    desk.succeeds(&[
        "image",
        "scene.toml",
        "-o",
        "moved.fits",
        "--set",
        "image.count=2",
        "--set",
        "aberrations.segment_piston_rms_nm=70",
    ]);
    let moved = FitsReader::open(desk.path("moved.fits")).unwrap().cube("IMAGES").unwrap();
    desk.edit_images("images.fits", "mixed.fits", |images| {
        images.index_axis_mut(Axis(0), 1).assign(&moved.index_axis(Axis(0), 1));
    });
    let estimate = |images: &str| desk.run(&["estimate", images, "-o", "est.fits", "--json", "--strict"]);
    let [sound, mixed] = ["images.fits", "mixed.fits"].map(estimate);
    assert_eq!((sound.status, sound.err.as_str()), (0, ""));
    assert_eq!(mixed.status, 3, "{}", mixed.err);
    assert!(mixed.out.contains("\"status\": \"contradictory\""), "{}", mixed.out);
    assert!(mixed.err.contains("mixed.fits: the images contradict each other: the reduced χ²"), "{}", mixed.err);
    let report = desk.succeeds(&["estimate", "mixed.fits", "-o", "est.fits"]);
    assert!(report.out.contains("2 of 2 images"), "{}", report.out);
}
