//! Subnormal numbers, of which an evaluation must have none: with those of the influence functions
//! it took twice as long on a Xeon.

use super::*;
use crate::modal::{Model, Recipe};
use crate::scene::Scene;
use std::arch::asm;

/// Flags of MXCSR: a subnormal operand, and a result that underflowed.
const FLAGS: u32 = (1 << 1) | (1 << 4);

/// Flags that `work` raises on this thread.
fn raised(work: impl FnOnce()) -> u32 {
    let (mut before, mut after) = (0u32, 0u32);
    // SAFETY: reads the register into a number of its size.
    unsafe { asm!("stmxcsr [{}]", in(reg) &raw mut before) };
    let cleared = before & !FLAGS;
    // SAFETY: clears two sticky flags, and leaves rounding and masks as they are.
    unsafe { asm!("ldmxcsr [{}]", in(reg) &raw const cleared) };
    work();
    // SAFETY: as the first.
    unsafe { asm!("stmxcsr [{}]", in(reg) &raw mut after) };
    after & FLAGS
}

/// Karhunen-Loève modes of Keck's mirror, whose Gaussian influence functions fall below 1e-300
/// across the pupil.
fn evaluation_raises<T: super::super::phasor::Polynomial>() -> u32 {
    let settings = [("image.samples_per_lambda_over_d", "2"), ("image.pixels", "240"), ("pupil.samples", "90")];
    let scene = Scene::preset("keck-artificial").unwrap().with(&settings).unwrap();
    let optics = Model::new(&scene, &Recipe::with_prior(&scene), false).unwrap().optics;
    assert!(optics.parts().products.is_some());
    let chain = CpuChain::<T>::new(optics.clone());
    let mut image = chain.empty_image();
    chain.set(&mut image, &exposures(optics.sampling().pixels)[2]).unwrap();
    let (mut scratch, mut evaluation) = (chain.scratch(), chain.evaluation());
    let coefficients_nm = coefficients(1, optics.modes());
    raised(|| chain.evaluate_one(&image, coefficients_nm.row(0), &mut scratch, &mut evaluation))
}

#[test]
fn evaluation_has_no_subnormal_numbers() {
    let tiny = std::hint::black_box(1e-20f32);
    assert_eq!(raised(|| assert!(tiny * tiny < tiny)), FLAGS);
    assert_eq!((evaluation_raises::<f32>(), evaluation_raises::<f64>()), (0, 0));
}
