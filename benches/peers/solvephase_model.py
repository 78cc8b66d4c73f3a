"""solvephase: its focal-plane problem on the same pupil, modes, diversity and weights, its own solver.

Levenberg-Marquardt with exact Jacobians from a flat wavefront, its choice for so many modes.
"""

import numpy as np
import solvephase as sp
from telescope import GRID_M, WAVELENGTH_NM, Telescope

NAME = "solvephase"


class Model:
    """One image at a time."""

    def __init__(self, telescope: Telescope, pixels: int, precision: str) -> None:
        samples = len(telescope.amplitude)
        self.pupil = sp.Pupil(telescope.amplitude, GRID_M / samples, GRID_M, segments=telescope.labels + 1)
        self.model = sp.FocalPlaneModel(
            self.pupil,
            WAVELENGTH_NM * 1e-9,
            pixels,
            sampling=pixels / samples,
            diversity=[telescope.diversity_nm * 1e-9],
            offset=-0.5,
            precision={"f32": "single", "f64": "double"}[precision],
        )
        self.basis = sp.Basis.from_maps(self.pupil, telescope.mode_maps())
        self.radian_per_nm = 2 * np.pi / WAVELENGTH_NM

    def load(self, electrons: np.ndarray, weights: np.ndarray) -> None:
        self.electrons, self.weights = electrons, weights
        self.flux_e = electrons.sum()
        self.problem = sp.FocalPlaneProblem(self.model, electrons, basis=self.basis, weights=weights, flux=self.flux_e)
        self.start = self.problem.initial()

    def evaluate(self, coefficients_nm: np.ndarray, flux_e: float | None = None) -> tuple[float, np.ndarray]:
        """J and its gradient per nm at some flux, which is a parameter here and not fitted in each evaluation."""
        at = self.start.copy()
        at[: coefficients_nm.size] = coefficients_nm * self.radian_per_nm
        at[-1] = np.log((flux_e or self.flux_e) / self.flux_e)
        value, gradient = self.problem.objective(at)
        return 2 * value, 2 * np.asarray(gradient[: coefficients_nm.size]) * self.radian_per_nm

    def estimate(self) -> np.ndarray:
        """The minimum, nm, from a flat wavefront: a new problem, as each image needs one."""
        problem = sp.FocalPlaneProblem(self.model, self.electrons, basis=self.basis, weights=self.weights)
        return 1e9 * sp.solve(problem).coefficients
