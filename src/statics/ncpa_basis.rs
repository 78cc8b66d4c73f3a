//! NCPA basis: a family of modes, in groups with a common prior variance.

use crate::Result;
use crate::modes::{self, SmoothBasis};
use crate::scene::System;
use crate::telescope::Telescope;

/// Slopes of the lenslets' disc for each identifiable Zernike mode: two thirds of them are in the
/// pupil.
const SLOPES_PER_ZERNIKE: f64 = 2.7;
/// Slopes of the lenslets' disc for each mode of a mirror, all of which the loop must identify: a
/// quarter more slopes than modes are in the pupil.
const SLOPES_PER_MIRROR_MODE: f64 = 1.9;

/// Most modes of a mirror, the largest basis of NCPA: the cost of each is the same, and images have
/// few pixels for more.
pub(crate) const MAX_NCPA_MODES: usize = 400;

/// Family of modes that describe the NCPA.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NcpaFamily {
    /// Zernike polynomials, orthonormal over the pupil, a group for each radial order.
    Zernike {
        /// The last order; lower where the sensor cannot identify as many modes.
        highest_order: usize,
    },
    /// Karhunen-Loève modes of the mirror, as many as the sensor can identify, in groups as large
    /// as the orders of Zernike polynomials. They span all that the mirror can correct.
    Mirror,
}

/// A motion of a petal is left out where the other modes span all but this fraction of it.
const SMALLEST_PETAL_REMAINDER: f64 = 1e-3;

/// NCPA modes and their groups.
pub struct NcpaBasis {
    /// The modes.
    pub modes: SmoothBasis,
    /// Number of modes in each group, in turn; the first group is tip and tilt, and the last, where
    /// there are petals, theirs.
    pub groups: Vec<usize>,
    /// Number of groups without that of the petals.
    pub orders: usize,
}

impl NcpaBasis {
    /// The modes of `family` on the pupil of `scene`.
    ///
    /// # Errors
    /// Those of making the bases.
    pub fn new(family: NcpaFamily, scene: &System, telescope: &Telescope) -> Result<Self> {
        let basis = Self::without_petals(family, scene, telescope)?;
        let Some(petals) = telescope.petals(scene.modes.petals)? else { return Ok(basis) };
        let (petals, pupil) = (SmoothBasis::petals(petals), &telescope.pupil);
        let modes = modes::join_exact(&basis.modes, &petals, pupil, SMALLEST_PETAL_REMAINDER)?.basis;
        let added = modes.len() - basis.modes.len();
        Ok(Self { modes, groups: [basis.groups, vec![added]].concat(), orders: basis.orders })
    }

    fn without_petals(family: NcpaFamily, scene: &System, telescope: &Telescope) -> Result<Self> {
        let orders = |last: usize| (1..=last).map(|order| order + 1).collect::<Vec<_>>();
        // Orders 1 to n hold Noll's 2 to (n + 1)(n + 2)/2.
        let zernikes = |last: usize| modes::zernike_basis(2, (last + 1) * (last + 2) / 2, &telescope.pupil);
        match family {
            NcpaFamily::Zernike { highest_order: wanted } => {
                let order = highest_order(scene, wanted);
                Ok(Self { modes: zernikes(order)?, groups: orders(order), orders: order })
            }
            NcpaFamily::Mirror => {
                let (influence, turbulence) = (telescope.influence(scene)?, Telescope::turbulence(scene)?);
                let most = (identifiable_modes(scene, SLOPES_PER_MIRROR_MODE) as usize).clamp(1, MAX_NCPA_MODES);
                let basis = modes::karhunen_loeve_at_most(&influence, &telescope.pupil, &turbulence, most)?.basis;
                // Groups as large as the orders of a Zernike basis.
                let mut groups: Vec<usize> = Vec::new();
                let mut left = basis.len();
                for size in 2.. {
                    if left == 0 {
                        break;
                    }
                    groups.push(left.min(size));
                    left -= left.min(size);
                }
                Ok(Self { modes: basis, orders: groups.len(), groups })
            }
        }
    }
}

/// Number of modes that the sensor of `scene` identifies, given the slopes of the lenslets' disc
/// that each needs.
fn identifiable_modes(scene: &System, slopes_per_mode: f64) -> f64 {
    scene.wavefront_sensor.as_ref().map_or(f64::INFINITY, |sensor| {
        // Two slopes for each lenslet of a disc.
        std::f64::consts::FRAC_PI_2 * (sensor.lenslets_across as f64).powi(2) / slopes_per_mode
    })
}

/// Highest order whose modes the sensor of `scene` identifies, at most `wanted`.
fn highest_order(scene: &System, wanted: usize) -> usize {
    let modes = identifiable_modes(scene, SLOPES_PER_ZERNIKE);
    (2..=wanted).rev().find(|&order| ((order + 1) * (order + 2) / 2 - 1) as f64 <= modes).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    #[test]
    fn the_number_of_modes_follows_the_sensor() {
        let with = |lenslets: &str| {
            Scene::preset("keck-onsky").unwrap().with(&[("wavefront_sensor.lenslets_across", lenslets)]).unwrap()
        };
        let keck = with("20");
        // 628 slopes in the lenslets' disc, at 2.7 a mode: 233 modes, so the 230 to order 20.
        assert_eq!([13, 20, 24].map(|order| highest_order(&keck, order)), [13, 20, 20]);
        let mirror =
            |scene: &Scene| NcpaBasis::new(NcpaFamily::Mirror, scene, &Telescope::new(scene).unwrap()).unwrap();
        // All modes of Keck's mirror on the pupil's samples, which are fewer than 628/1.9; of ten
        // lenslets 157/1.9.
        let basis = mirror(&keck);
        let telescope = Telescope::new(&keck).unwrap();
        let (influence, turbulence) = (telescope.influence(&keck).unwrap(), Telescope::turbulence(&keck).unwrap());
        let all = modes::karhunen_loeve_at_most(&influence, &telescope.pupil, &turbulence, usize::MAX).unwrap().basis;
        assert!(all.len() < 330, "{}", all.len());
        assert_eq!((basis.modes.len(), &basis.groups[..3]), (all.len(), &[2, 3, 4][..]));
        assert_eq!(basis.groups.iter().sum::<usize>(), basis.modes.len());
        assert_eq!(mirror(&with("10")).modes.len(), 82);
    }
}
