"""NumPy with a hand-written adjoint, and SciPy's BFGS on it: what a careful scientist writes in an afternoon.

The objective is everybody's: J = sum w (f h - d)^2 over the pixels, f the flux that makes it least. With E the field in the
pupil, u = F E, h = |u|^2 and r = f h - d, its gradient by the wavefront is 4 f Im(conj(E) F'(w r u)): two transforms.
"""

import numpy as np
import scipy.fft
import scipy.optimize
from telescope import WAVELENGTH_NM, Telescope

NAME = "NumPy + SciPy BFGS"
#: BFGS starts with steps of the size of the gradient: modes in radians and J as chi squared per pixel make that sensible.
NM = WAVELENGTH_NM / (2 * np.pi)


class Model:
    """One image at a time."""

    def __init__(self, telescope: Telescope, pixels: int, precision: str) -> None:
        self.real = np.dtype(precision.replace("f", "float"))
        self.samples, self.pixels = len(telescope.amplitude), pixels
        self.lit = np.flatnonzero(telescope.labels >= 0)
        maps = telescope.mode_maps().reshape(telescope.modes, -1)[:, self.lit]
        self.modes = np.ascontiguousarray(maps / NM, self.real)
        # So that the PSF over an unbounded detector sums to 1.
        amplitude = telescope.amplitude.ravel()[self.lit]
        amplitude = amplitude / np.sqrt((amplitude**2).sum()) / pixels
        diversity = np.exp(1j * telescope.diversity_nm.ravel()[self.lit] / NM)
        self.aperture = (amplitude * diversity).astype(np.result_type(self.real, np.complex64))

    def load(self, electrons: np.ndarray, weights: np.ndarray) -> None:
        # The transform has the axis in its corner: the image is turned that way once.
        self.data = np.fft.ifftshift(electrons).astype(self.real)
        self.weights = np.fft.ifftshift(weights).astype(self.real)

    def field(self, coefficients_nm: np.ndarray) -> np.ndarray:
        """The field on the glass."""
        phase = coefficients_nm.astype(self.real) @ self.modes
        phasor = np.empty(phase.shape, self.aperture.dtype)
        np.cos(phase, out=phasor.real)
        np.sin(phase, out=phasor.imag)
        return phasor * self.aperture

    def evaluate(self, coefficients_nm: np.ndarray) -> tuple[float, np.ndarray]:
        """J and its gradient per nm."""
        field = self.field(coefficients_nm)
        pupil = np.zeros((self.samples, self.samples), field.dtype)
        pupil.ravel()[self.lit] = field
        # Rows that hold nothing are not transformed: 3/4 of the work of a padded fft2.
        focus = scipy.fft.fft(pupil, self.pixels, axis=1, workers=-1)
        focus = scipy.fft.fft(focus, self.pixels, axis=0, workers=-1, overwrite_x=True)
        psf = focus.real**2 + focus.imag**2
        weighted = self.weights * psf
        flux = self.flux_e = np.vdot(weighted, self.data) / np.vdot(weighted, psf)
        residual = flux * psf - self.data
        weighted = self.weights * residual
        back = scipy.fft.ifft(weighted * focus, axis=0, workers=-1, norm="forward", overwrite_x=True)
        back = scipy.fft.ifft(back[: self.samples], axis=1, workers=-1, norm="forward", overwrite_x=True)
        back = back[:, : self.samples].ravel()[self.lit]
        gradient = self.modes @ (4 * flux * (field.conj() * back).imag)
        return float(np.vdot(weighted, residual)), gradient

    def estimate(self) -> np.ndarray:
        """The minimum, nm, from a flat wavefront."""
        return bfgs(self.evaluate, len(self.modes), self.data.size)


def bfgs(evaluate, modes: int, pixels: int) -> np.ndarray:
    """SciPy's BFGS from a flat wavefront; coefficients in nm."""

    def scaled(radians):
        value, gradient = evaluate(radians * NM)
        return value / pixels, np.asarray(gradient, float) * (NM / pixels)

    found = scipy.optimize.minimize(scaled, np.zeros(modes), jac=True, method="BFGS", options={"gtol": 1e-3})
    return found.x * NM
