//! Raw frames of a detector, made of simulated images.

use crate::Desk;
use cophase::io::{Card, FitsReader, FitsWriter, Pixel};
use ndarray::{Array2, Array3, Axis, s};

/// Side of the raw frames, electrons per count, coadds.
pub const SIDE: usize = 200;
pub const GAIN: f64 = 4.0;
pub const COADDS: f64 = 2.0;
/// Noise of the simulated images, electrons: that of two coadds of 14.142.
pub const NOISE_E: f64 = 20.0;
pub const SKY_E: f64 = 60.0;
/// Rows and columns of the star in five dithers, whose images of 64 pixels overlap at corners only.
pub const DITHERS: [(usize, usize); 5] = [(50, 50), (50, 150), (150, 50), (150, 150), (100, 100)];
/// The scene of the raw frames.
pub const RAW: [&str; 4] = ["--set", "image.read_noise_e=14.142", "--set", "image.saturation_adu=9000"];

/// Normal numbers: sums of twelve uniform ones of a linear congruential generator, whose quality
/// suffices for noise.
pub struct Noise(pub u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Response of the detector: 2 % from pixel to pixel, on a slope of 20 %, with a dead pixel.
pub fn response() -> Array2<f64> {
    let mut noise = Noise(7);
    let mut response = Array2::from_shape_fn((SIDE, SIDE), |(_, x)| {
        (1.0 + 0.02 * noise.normal()) * (0.9 + 0.2 * x as f64 / SIDE as f64)
    });
    response[[60, 55]] = 0.0;
    response
}

/// Dark of one coadd, counts: bias of four quadrants, a pattern, and hot pixels, three of them
/// under the stars.
pub fn dark() -> Array2<f64> {
    let mut noise = Noise(8);
    let mut dark = Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
        500.0 + 10.0 * (2 * (2 * y / SIDE) + 2 * x / SIDE) as f64 + 3.0 * noise.normal()
    });
    for (y, x, counts) in
        [(55, 45, 4000.0), (145, 60, 800.0), (102, 110, 20_000.0), (10, 190, 30_000.0), (10, 191, 30_000.0)]
    {
        dark[[y, x]] += counts;
    }
    dark
}

/// Writes a raw frame of `electrons`, with its dark, in whole counts.
pub fn write(desk: &Desk, name: &str, electrons: &Array2<f64>, cards: &[(&str, Card)]) {
    write_cube(desk, name, &electrons.view().insert_axis(Axis(0)).to_owned(), cards);
}

/// Writes a cube of raw frames.
pub fn write_cube(desk: &Desk, name: &str, electrons: &Array3<f64>, cards: &[(&str, Card)]) {
    let counts = (electrons / GAIN + &(COADDS * dark())).mapv(f64::round);
    let counts =
        if counts.len_of(Axis(0)) == 1 { counts.index_axis_move(Axis(0), 0).into_dyn() } else { counts.into_dyn() };
    let mut file = FitsWriter::create(desk.path(name)).unwrap();
    file.image("RAW", &counts, Pixel::I32, "").unwrap();
    for (key, value) in [("ITIME", Card::Real(0.5)), ("COADDS", Card::Integer(2)), ("GAIN", Card::Real(GAIN))] {
        file.card("RAW", key, value, "").unwrap();
    }
    for (key, value) in cards {
        file.card("RAW", key, value.clone(), "").unwrap();
    }
    file.finish().unwrap();
}

/// Sky with its photon noise and the read noise.
pub fn sky(noise: &mut Noise) -> Array2<f64> {
    let response = response();
    Array2::from_shape_fn((SIDE, SIDE), |at| {
        response[at] * (SKY_E + SKY_E.sqrt() * noise.normal()) + NOISE_E * noise.normal()
    })
}

/// A frame of the star, whose image `[64, 64]` has its read noise, at a dither.
pub fn star(image: &Array2<f64>, (y, x): (usize, usize), noise: &mut Noise) -> Array2<f64> {
    let mut frame = sky(noise);
    let at = s![y - 32..y + 32, x - 32..x + 32];
    let of_sky = Array2::from_shape_fn((64, 64), |_| SKY_E + SKY_E.sqrt() * noise.normal());
    frame.slice_mut(at).assign(&((image + &of_sky) * response().slice(at)));
    frame
}

/// A folder `raw` with five dithers, darks, flats and frames of the lamp off.
pub fn desk() -> Desk {
    desk_with(&[], &|_| Vec::new())
}

/// [`desk`], of images with more settings and frames of the star with more cards, by their number.
pub fn desk_with(settings: &[&str], cards: &dyn Fn(usize) -> Vec<(&'static str, Card)>) -> Desk {
    let desk = Desk::with_images(&[&["image.count=5"], settings].concat());
    std::fs::create_dir(desk.path("raw")).unwrap();
    let images = FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap();
    let mut noise = Noise(1);
    for (number, (image, at)) in images.outer_iter().zip(DITHERS).enumerate() {
        let frame = star(&image.to_owned(), at, &mut noise);
        let cards = [vec![("OBJECT", "HD 1".into())], cards(number)].concat();
        write(&desk, &format!("raw/n{number:04}.fits"), &frame, &cards);
    }
    for number in 0..9 {
        let frame = Array2::from_shape_fn((SIDE, SIDE), |_| NOISE_E * noise.normal());
        write(&desk, &format!("raw/d{number}.fits"), &frame, &[("SHRNAME", "CLOSED".into())]);
    }
    let response = response();
    for number in 0..8 {
        for (class, level_e) in [("flatlamp", 80_000.0f64), ("flatlampoff", 0.0)] {
            let frame = Array2::from_shape_fn((SIDE, SIDE), |at| {
                response[at] * (level_e + level_e.sqrt() * noise.normal()) + NOISE_E * noise.normal()
            });
            write(&desk, &format!("raw/{class}{number}.fits"), &frame, &[("KOAIMTYP", class.into())]);
        }
    }
    desk
}
