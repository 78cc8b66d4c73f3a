//! Strehl ratio of a residual wavefront on the optical axis.

use crate::ao::footprint::{Footprint, LANES};
use crate::ao::phase::unit_phasor;
use pulp::{Arch, NullaryFnOnce};

/// Strehl ratio of a residual wavefront at `wavelength_nm`: the intensity on the axis relative to
/// that without aberration.
pub fn strehl_on_axis(footprint: &Footprint, residual_nm: &[f32], wavelength_nm: f64) -> f64 {
    let [re, im] = Arch::new().dispatch(OnAxis { footprint, residual_nm, turns_per_nm: (1.0 / wavelength_nm) as f32 });
    (re * re + im * im) / footprint.total().powi(2)
}

/// Kernel: Σ A·exp(2πi·W/λ).
struct OnAxis<'a> {
    footprint: &'a Footprint,
    residual_nm: &'a [f32],
    turns_per_nm: f32,
}

impl NullaryFnOnce for OnAxis<'_> {
    type Output = [f64; 2];

    #[inline(always)]
    fn call(self) -> [f64; 2] {
        let Self { footprint, residual_nm, turns_per_nm } = self;
        let stride = footprint.stride();
        let mut field = [0.0; 2];
        for y in 0..footprint.samples() {
            let span = footprint.span(y);
            let place = y * stride + span.start..y * stride + span.end;
            let amplitude = footprint.amplitude()[place.clone()].as_chunks::<LANES>().0;
            let (mut re, mut im) = ([0.0f32; LANES], [0.0f32; LANES]);
            for (a, opd) in amplitude.iter().zip(residual_nm[place].as_chunks::<LANES>().0) {
                let (mut cos, mut sin) = ([0.0f32; LANES], [0.0f32; LANES]);
                for l in 0..LANES {
                    (cos[l], sin[l]) = unit_phasor(opd[l] * turns_per_nm);
                }
                for l in 0..LANES {
                    re[l] = a[l].mul_add(cos[l], re[l]);
                }
                for l in 0..LANES {
                    im[l] = a[l].mul_add(sin[l], im[l]);
                }
            }
            field[0] += f64::from(re.iter().sum::<f32>());
            field[1] += f64::from(im.iter().sum::<f32>());
        }
        field
    }
}
