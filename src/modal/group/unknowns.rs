//! Unknowns of a group: the modes that all images share, the amplitude of the diversities where it
//! is unknown, and tip and tilt of each image but the first, whose own are among the modes.

use ndarray::{Array1, Array2, ArrayView1, ArrayViewMut1, s};

/// Amplitude of the diversities of a group.
#[derive(Clone)]
pub(in crate::modal) enum Amplitude {
    Known,
    /// A coefficient of the models of the images, behind their modes.
    Coefficient,
    /// Coefficients of the modes, nm, that one nm of it adds in each image.
    InModes(Vec<Array1<f64>>),
}

/// Unknowns of a group, in this order: modes (nm), amplitude (nm of the largest diversity), tip and
/// tilt of the second image and of those after it (nm RMS).
pub(in crate::modal) struct Unknowns {
    modes: usize,
    amplitude: Amplitude,
    /// Coefficients of tip and tilt, `[axis, mode]`.
    tilts: Array2<f64>,
    images: usize,
}

impl Unknowns {
    pub(in crate::modal) fn new(modes: usize, amplitude: Amplitude, tilts: Array2<f64>, images: usize) -> Self {
        Self { modes, amplitude, tilts, images }
    }

    /// Number of the unknowns.
    pub(in crate::modal) fn count(&self) -> usize {
        self.shared() + self.tilts.nrows() * self.images.saturating_sub(1)
    }

    /// Number of those that all images share, which come first.
    pub(in crate::modal) fn shared(&self) -> usize {
        self.modes + usize::from(self.amplitude().is_some())
    }

    /// Number of the coefficients of an image's model.
    fn coefficients(&self) -> usize {
        self.modes + usize::from(matches!(self.amplitude, Amplitude::Coefficient))
    }

    /// Place of the amplitude.
    pub(in crate::modal) fn amplitude(&self) -> Option<usize> {
        (!matches!(self.amplitude, Amplitude::Known)).then_some(self.modes)
    }

    /// Coefficients of the modes that one nm of the amplitude adds in an image.
    fn amplitude_in_modes(&self, image: usize) -> Option<&Array1<f64>> {
        match &self.amplitude {
            Amplitude::InModes(each) => Some(&each[image]),
            Amplitude::Known | Amplitude::Coefficient => None,
        }
    }

    /// Coefficients of tip and tilt of an image, `[axis, shared unknown]`.
    pub(super) fn tilts(&self) -> Array2<f64> {
        let mut padded = Array2::zeros((self.tilts.nrows(), self.shared()));
        padded.slice_mut(s![.., ..self.modes]).assign(&self.tilts);
        padded
    }

    /// Place of the first of an image's own tip and tilt; `None` for the first image.
    pub(super) fn first_tilt(&self, image: usize) -> Option<usize> {
        (image > 0 && self.tilts.nrows() > 0).then(|| self.own(image).0)
    }

    /// Place of the first of an image's own unknowns, and how many there are.
    fn own(&self, image: usize) -> (usize, usize) {
        let count = self.tilts.nrows();
        (self.shared() + count * image.saturating_sub(1), if image == 0 { 0 } else { count })
    }

    /// Coefficients of the model of `image` at `point`: modes, and the amplitude where it is one.
    pub(super) fn of_image(&self, image: usize, point: &[f64]) -> Array1<f64> {
        let mut own = Array1::zeros(self.coefficients());
        self.write_coefficients(image, point, own.view_mut());
        own
    }

    /// [`Unknowns::of_image`], without allocation.
    pub(in crate::modal) fn write_coefficients(&self, image: usize, point: &[f64], mut own: ArrayViewMut1<f64>) {
        own.assign(&ArrayView1::from(&point[..self.coefficients()]));
        let mut modes = own.slice_mut(s![..self.modes]);
        if let Some(direction) = self.amplitude_in_modes(image) {
            modes.scaled_add(point[self.modes], direction);
        }
        let (first, count) = self.own(image);
        for (tilt, nm) in self.tilts.outer_iter().zip(&point[first..first + count]) {
            modes.scaled_add(*nm, &tilt);
        }
    }

    /// Adds what the gradient of one image, by the coefficients of its model, is of that by the
    /// unknowns. Allocates nothing.
    pub(in crate::modal) fn add_gradient(&self, image: usize, gradient: &[f64], sum: &mut [f64]) {
        sum.iter_mut().zip(gradient).for_each(|(sum, own)| *sum += own);
        let (first, count) = self.own(image);
        let modes = ArrayView1::from(&gradient[..self.modes]);
        if let Some(direction) = self.amplitude_in_modes(image) {
            sum[self.modes] += direction.dot(&modes);
        }
        for (tilt, sum) in self.tilts.outer_iter().zip(&mut sum[first..first + count]) {
            *sum += tilt.dot(&modes);
        }
    }

    /// Adds the Gauss-Newton matrix of one image, by the coefficients of its model.
    pub(in crate::modal) fn add_information(&self, image: usize, information: &Array2<f64>, sum: &mut Array2<f64>) {
        let mut design = Array2::zeros((self.coefficients(), sum.ncols()));
        design.slice_mut(s![.., ..self.coefficients()]).diag_mut().fill(1.0);
        if let Some(direction) = self.amplitude_in_modes(image) {
            design.slice_mut(s![..self.modes, self.modes]).assign(direction);
        }
        let (first, count) = self.own(image);
        for (column, tilt) in (first..first + count).zip(self.tilts.outer_iter()) {
            design.slice_mut(s![..self.modes, column]).assign(&tilt);
        }
        *sum += &design.t().dot(&information.dot(&design));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use ndarray::array;

    #[test]
    fn gradients_are_the_adjoint_of_coefficients() {
        let tilts = array![[0.0, 1.0, 0.5], [0.2, 0.0, 1.0]];
        let in_modes = [[0.0, 1.0, -2.0], [0.0, -1.0, 2.0], [0.5, 0.0, 0.3]].map(|nm| Array1::from(nm.to_vec()));
        let form = array![[2.0, 0.1, 0.0, 0.3], [0.1, 1.0, 0.2, 0.0], [0.0, 0.2, 3.0, 0.1], [0.3, 0.0, 0.1, 4.0]];
        for (amplitude, coefficients) in [(Amplitude::Coefficient, 4), (Amplitude::InModes(in_modes.to_vec()), 3)] {
            let unknowns = Unknowns::new(3, amplitude, tilts.clone(), 3);
            assert_eq!((unknowns.count(), unknowns.shared(), unknowns.amplitude()), (8, 4, Some(3)));
            let point: Vec<f64> = (1..=8).map(f64::from).collect();
            let gradient = &[0.3, -1.0, 2.0, 0.7][..coefficients];
            for image in 0..3 {
                let mut sum = vec![0.0; 8];
                unknowns.add_gradient(image, gradient, &mut sum);
                let along: f64 = sum.iter().zip(&point).map(|(a, b)| a * b).sum();
                let other = unknowns.of_image(image, &point).dot(&ArrayView1::from(gradient));
                assert_relative_eq!(along, other, max_relative = 1e-14);
            }
            // The matrix of a quadratic form of the coefficients is that form of the unknowns.
            let form = form.slice(s![..coefficients, ..coefficients]).to_owned();
            let mut sum = Array2::zeros((8, 8));
            unknowns.add_information(2, &form, &mut sum);
            let (own, x) = (unknowns.of_image(2, &point), Array1::from(point.clone()));
            assert_relative_eq!(x.dot(&sum.dot(&x)), own.dot(&form.dot(&own)), max_relative = 1e-14);
        }
    }
}
