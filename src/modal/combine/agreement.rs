//! Test that images that are taken to be of one wavefront are of one wavefront.
//!
//! The minima x_i of such images differ by their noise alone, of covariance a_i C, but for the
//! pointing of each image, the motions of the whole mirror, and whole wavelengths of pistons. In
//! coordinates y in which C without those is the identity of r dimensions
//!
//! ```text
//! χ² = Σ |y_i − ȳ|²/a_i     ȳ = Σ (y_i/a_i) / Σ 1/a_i     r (n − 1) degrees of freedom
//! ```
//!
//! Where noise does not explain χ², images are sought that agree with each other.

use crate::Result;
use crate::modal::assess::fisher::{null_floor, root_of_pseudo_inverse};
use crate::modal::assess::tilts::spanned_tip_and_tilt;
use crate::modal::combine::pistons;
use crate::modal::combine::sequence::SEQUENCE;
use crate::modal::fitter::ModalFitter;
use ndarray::{Array1, Array2, ArrayView1, Axis};

/// Standard deviations of χ² beyond which images differ by more than noise: two of 10,000 normal
/// draws are beyond.
const SIGNIFICANT: f64 = 3.5;
/// The same for each image of many: three of a million draws are beyond.
const SIGNIFICANT_OF_ONE: f64 = 4.5;
/// Relative error of the variances that is allowed for: that of a Fisher matrix which images share,
/// and of a fit that stops within a fraction of its error bar.
const ALLOWANCE: f64 = 0.05;
/// Largest number of images around each of which a group is sought.
const LEADERS: usize = 64;
/// How often a group is sought again about its own mean.
const ROUNDS: usize = 5;
/// Largest share of the variance along the first principal component that is left within two groups
/// of images: the best division of normal draws leaves 0.36, of uniform ones 0.25.
const LEFT_WITHIN: f64 = 0.1;
/// Iterations that find the first principal component.
const ITERATIONS: usize = 30;

/// Whether images are of one wavefront; images are named by their places in the list that was
/// tested, or in that of the estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Agreement {
    /// Reduced χ² of the images about their mean; NaN where they were not tested.
    pub reduced_chi2: f64,
    /// Its degrees of freedom.
    pub freedom: f64,
    /// What follows.
    pub verdict: Verdict,
}

/// What the differences of images say.
#[derive(Debug, Clone, PartialEq)]
pub enum Verdict {
    /// Not tested: a single image, or a wavefront that changes as the scene says.
    Untested,
    /// Noise explains the differences.
    OneWavefront,
    /// Less than a third of the images, these, differ from the others, which agree.
    Outliers(Vec<usize>),
    /// The images are of several wavefronts. The largest group of images that agree.
    SeveralWavefronts(Vec<usize>),
    /// Eight images or more change from one to the next and form no groups.
    Changing,
}

impl Agreement {
    /// That of images which were not tested.
    pub(in crate::modal) fn untested() -> Self {
        Self { reduced_chi2: f64::NAN, freedom: 0.0, verdict: Verdict::Untested }
    }

    /// This agreement of images that are named by their places in `images`.
    pub(in crate::modal) fn of_images(mut self, images: &[usize]) -> Self {
        if let Verdict::Outliers(places) | Verdict::SeveralWavefronts(places) = &mut self.verdict {
            places.iter_mut().for_each(|place| *place = images[*place]);
        }
        self
    }

    /// Whether the images are of several wavefronts, so that their mean is of none.
    pub fn is_contradictory(&self) -> bool {
        matches!(self.verdict, Verdict::SeveralWavefronts(_))
    }

    /// Whether the images differ by more than noise explains.
    pub fn is_significant(&self) -> bool {
        !matches!(self.verdict, Verdict::Untested | Verdict::OneWavefront)
    }
}

/// Images whose differences are tested.
pub(in crate::modal) struct TestedImages {
    /// The modes of each image, nm, `[image, mode]`, pistons by the same whole wavelengths.
    pub(in crate::modal) coefficients_nm: Array2<f64>,
    /// y, `[image, direction]`.
    whitened: Array2<f64>,
    /// a.
    variances: Vec<f64>,
}

/// Coordinates in which the noise of one image is the identity.
pub(in crate::modal) struct Whitening {
    /// R: y = Rᵀ x, `[mode, direction]`.
    root: Array2<f64>,
    /// Orthonormal directions in y of tip and tilt, which are left out.
    pointing: Vec<Array1<f64>>,
}

impl Whitening {
    /// Coordinates for the covariance `noise_nm2`, pistons about their mean.
    ///
    /// # Errors
    /// [`crate::Error::Value`] where no mode has noise.
    pub(in crate::modal) fn new(fitter: &ModalFitter, noise_nm2: &Array2<f64>) -> Result<Self> {
        let modes = noise_nm2.nrows();
        let root = root_of_pseudo_inverse(noise_nm2, null_floor(modes, modes))?;
        let mut pointing: Vec<Array1<f64>> = Vec::new();
        for direction in spanned_tip_and_tilt(&fitter.model)?.outer_iter() {
            let mut along = direction.dot(&root);
            remove(&mut along, &pointing);
            let length = along.dot(&along).sqrt();
            if length > 0.0 {
                pointing.push(along / length);
            }
        }
        Ok(Self { root, pointing })
    }

    /// r.
    fn rank(&self) -> f64 {
        (self.root.ncols() - self.pointing.len()) as f64
    }

    /// y of the modes of one image.
    fn of(&self, coefficients_nm: ArrayView1<f64>) -> Array1<f64> {
        let mut whitened = coefficients_nm.dot(&self.root);
        remove(&mut whitened, &self.pointing);
        whitened
    }

    /// Variance of an image of the covariance `noise_nm2`, in units of that of these coordinates.
    pub(in crate::modal) fn variance(&self, noise_nm2: &Array2<f64>) -> f64 {
        let half = noise_nm2.dot(&self.root);
        let all = (&self.root * &half).sum();
        let pointing = self.pointing.iter().map(|along| self.root.dot(along).dot(&half.dot(along)));
        (all - pointing.sum::<f64>()) / self.rank()
    }
}

impl TestedImages {
    /// Images with these modes (`[image, mode]`, nm) and variances in units of the whitening's. The
    /// pistons are moved by whole wavelengths towards those of the image that most others agree
    /// with.
    pub(in crate::modal) fn new(
        fitter: &ModalFitter,
        whitening: &Whitening,
        mut coefficients_nm: Array2<f64>,
        variances: Vec<f64>,
    ) -> Self {
        let rows = coefficients_nm.outer_iter().map(|row| whitening.of(row));
        let mut whitened: Vec<Array1<f64>> = rows.collect();
        let count = whitened.len();
        // Of each image its modes and y where its pistons are moved towards those of a leader.
        let moved_to = |leader: usize, image: usize| {
            let mut moved_nm = coefficients_nm.row(image).to_vec();
            pistons::wrap_if_monochromatic(&mut moved_nm, &coefficients_nm.row(leader).to_vec(), &fitter.model);
            (ArrayView1::from(&moved_nm) != coefficients_nm.row(image)).then(|| {
                fitter.motions.remove(&mut moved_nm);
                let whitened = whitening.of(ArrayView1::from(&moved_nm));
                (moved_nm, whitened)
            })
        };
        let distance = |leader: usize, image: usize| {
            let moved = moved_to(leader, image);
            let off = &whitened[leader] - moved.as_ref().map_or(&whitened[image], |(_, whitened)| whitened);
            off.dot(&off) / (variances[leader] + variances[image])
        };
        let middle = |&leader: &usize| {
            crate::statistics::median(&(0..count).map(|image| distance(leader, image)).collect::<Vec<_>>())
        };
        let leader = leaders(count).map(|leader| (leader, middle(&leader))).min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((leader, _)) = leader {
            let moved: Vec<_> = (0..count).map(|image| moved_to(leader, image)).collect();
            for (image, moved) in moved.into_iter().enumerate() {
                if let Some((moved_nm, moved)) = moved {
                    coefficients_nm.row_mut(image).assign(&ArrayView1::from(&moved_nm));
                    whitened[image] = moved;
                }
            }
        }
        let directions = whitened.first().map_or(0, Array1::len);
        let whitened = Array2::from_shape_fn((count, directions), |(image, k)| whitened[image][k]);
        Self { coefficients_nm, whitened, variances }
    }

    /// Whether these images are of one wavefront, in coordinates of `rank` dimensions.
    pub(in crate::modal) fn agreement(&self, whitening: &Whitening) -> Agreement {
        let (rank, all) = (whitening.rank(), (0..self.variances.len()).collect::<Vec<_>>());
        let (chi2, freedom) = (self.chi2(&all), rank * (all.len() - 1) as f64);
        let found = |verdict| Agreement { reduced_chi2: chi2 / freedom, freedom, verdict };
        if self.agree(&all, rank) {
            return found(Verdict::OneWavefront);
        }
        let group = self.largest_group(rank);
        let others: Vec<usize> = all.iter().copied().filter(|image| !group.contains(image)).collect();
        let is_minority = !others.is_empty() && 3 * others.len() < all.len();
        found(if is_minority && self.agree(&group, rank) {
            Verdict::Outliers(others)
        } else if all.len() < SEQUENCE || self.has_two_groups() {
            Verdict::SeveralWavefronts(group)
        } else {
            Verdict::Changing
        })
    }

    /// Whether noise explains the differences of `images`, and of each from the others.
    fn agree(&self, images: &[usize], rank: f64) -> bool {
        let freedom = rank * (images.len() - 1) as f64;
        images.len() < 2
            || deviations(self.chi2(images), freedom) < SIGNIFICANT
                && images.iter().all(|&image| self.deviation_from(image, images, rank) < SIGNIFICANT_OF_ONE)
    }

    /// χ² of `images` about their mean.
    fn chi2(&self, images: &[usize]) -> f64 {
        let (mean, _) = self.mean(images.iter().copied());
        let squares = images.iter().map(|&image| {
            let off = &self.whitened.row(image) - &mean;
            off.dot(&off) / self.variances[image]
        });
        squares.sum()
    }

    /// Mean of some images, and its variance.
    fn mean(&self, images: impl Iterator<Item = usize>) -> (Array1<f64>, f64) {
        let (mut sum, mut weights) = (Array1::zeros(self.whitened.ncols()), 0.0);
        for image in images {
            let weight = self.variances[image].recip();
            sum.scaled_add(weight, &self.whitened.row(image));
            weights += weight;
        }
        (sum / weights, weights.recip())
    }

    /// Difference of `image` from the mean of the other `images`, in standard deviations of its χ².
    fn deviation_from(&self, image: usize, images: &[usize], rank: f64) -> f64 {
        let (mean, variance) = self.mean(images.iter().copied().filter(|&other| other != image));
        let off = &self.whitened.row(image) - &mean;
        deviations(off.dot(&off) / (self.variances[image] + variance), rank)
    }

    /// The largest group of images of which each agrees with the others.
    fn largest_group(&self, rank: f64) -> Vec<usize> {
        let count = self.variances.len();
        let about = |leader: usize| -> Vec<usize> {
            let agrees = |&image: &usize| {
                image == leader || self.deviation_from(image, &[leader, image], rank) < SIGNIFICANT_OF_ONE
            };
            (0..count).filter(agrees).collect()
        };
        let mut group = leaders(count).map(about).rev().max_by_key(Vec::len).unwrap_or_default();
        for _ in 0..ROUNDS {
            let agrees = |&image: &usize| {
                group.iter().all(|&member| member == image)
                    || self.deviation_from(image, &group, rank) < SIGNIFICANT_OF_ONE
            };
            let next: Vec<usize> = (0..count).filter(agrees).collect();
            if next.len() < 2 || next == group {
                break;
            }
            group = next;
        }
        group
    }

    /// Whether the images are in two groups along the direction in which they differ most, the
    /// smaller of a third of the images or more.
    fn has_two_groups(&self) -> bool {
        let count = self.variances.len();
        let (mean, _) = self.mean(0..count);
        let off = &self.whitened - &mean.insert_axis(Axis(0));
        let norm = |row: ArrayView1<f64>| row.dot(&row);
        let Some(farthest) = (0..count).max_by(|&a, &b| norm(off.row(a)).total_cmp(&norm(off.row(b)))) else {
            return false;
        };
        let mut along = off.row(farthest).to_owned();
        for _ in 0..ITERATIONS {
            let next = off.t().dot(&off.dot(&along));
            along = &next / norm(next.view()).sqrt();
        }
        let mut places = off.dot(&along).to_vec();
        places.sort_by(f64::total_cmp);
        let squares_about_mean = |places: &[f64]| {
            let mean = places.iter().sum::<f64>() / places.len() as f64;
            places.iter().map(|place| (place - mean).powi(2)).sum::<f64>()
        };
        let all = squares_about_mean(&places);
        let least = count.div_ceil(3);
        (least..=count - least).any(|below| {
            let (low, high) = places.split_at(below);
            squares_about_mean(low) + squares_about_mean(high) < LEFT_WITHIN * all
        })
    }
}

/// Removes `directions`, which are orthonormal, from `vector`.
fn remove(vector: &mut Array1<f64>, directions: &[Array1<f64>]) {
    for direction in directions {
        let share = direction.dot(vector);
        vector.scaled_add(-share, direction);
    }
}

/// Images around which a group is sought, evenly from `count`.
fn leaders(count: usize) -> impl DoubleEndedIterator<Item = usize> {
    let leaders = count.min(LEADERS);
    (0..leaders).map(move |k| k * count / leaders)
}

/// A χ² of `freedom` degrees of freedom beyond its allowance, in standard deviations of a normal
/// variable (Wilson & Hilferty 1931, *PNAS* 17, 684).
fn deviations(chi2: f64, freedom: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    ((chi2 / (freedom * (1.0 + ALLOWANCE))).cbrt() - (1.0 - spread)) / spread.sqrt()
}
