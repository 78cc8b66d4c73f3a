"""prysm: its propagations, of which each is the adjoint of another, and SciPy's BFGS.

The release on the package index has no gradients of its own; `focus` is unitary, so that `unfocus` is its adjoint but for
the padding, whose adjoint is `crop_center`.
"""

import numpy as np
from numpy_model import NM, bfgs
from prysm.fttools import crop_center
from prysm.propagation import focus, unfocus
from telescope import Telescope

NAME = "prysm + SciPy BFGS"


class Model:
    """One image at a time."""

    def __init__(self, telescope: Telescope, pixels: int) -> None:
        self.samples = len(telescope.amplitude)
        self.padding = pixels / self.samples
        self.lit = telescope.labels >= 0
        self.modes = telescope.mode_maps()[:, self.lit] / NM
        amplitude = telescope.amplitude / np.sqrt((telescope.amplitude**2).sum())
        self.aperture = amplitude * np.exp(1j * telescope.diversity_nm / NM)

    def load(self, electrons: np.ndarray, weights: np.ndarray) -> None:
        self.data, self.weights = electrons, weights

    def evaluate(self, coefficients_nm: np.ndarray) -> tuple[float, np.ndarray]:
        """J and its gradient per nm."""
        phase = np.zeros(self.lit.shape)
        phase[self.lit] = coefficients_nm @ self.modes
        pupil = self.aperture * np.exp(1j * phase)
        field = focus(pupil, self.padding)
        psf = np.abs(field) ** 2
        weighted = self.weights * psf
        flux = np.vdot(weighted, self.data) / np.vdot(weighted, psf)
        residual = flux * psf - self.data
        weighted = self.weights * residual
        back = crop_center(unfocus(weighted * field, 1), self.samples)
        gradient = self.modes @ (4 * flux * (pupil.conj() * back).imag)[self.lit]
        return float(np.vdot(weighted, residual)), gradient

    def estimate(self) -> np.ndarray:
        """The minimum, nm, from a flat wavefront."""
        return bfgs(self.evaluate, len(self.modes), self.data.size)
