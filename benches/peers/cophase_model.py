"""Ours, through the Python package that a user installs."""

from dataclasses import replace

import cophase
import numpy as np
from images import PIXELS, READ_NOISE_E
from telescope import DEFOCUS_WAVES, GRID_M, NOLL, WAVELENGTH_NM, Telescope

NAME = "cophase"


#: The telescope and camera of keck-artificial at 2 pixels per lambda/D. The flux alone is fitted, and nothing is moved:
#: what is asked of everybody.
SCENE = """
[pupil]
grid_m = {grid_m}
samples = {samples}
[image]
wavelength_nm = {wavelength_nm}
diversity_focus_waves_rms = {defocus_waves}
pixels = {pixels}
crop_pixels = {crop}
read_noise_e = {read_noise_e}
[modes]
ncpa = "zernike"
ncpa_count = {ncpa_count}
exact_zernikes = []
[estimate]
fit_background = false
recentre = false
step_tolerance_nm = {tolerance_nm}
"""

#: Where our own models stop, nm: a tenth of what they err by. The model of the peers goes on to the default.
OWN_TOLERANCE_NM = 0.1
DEFAULT_TOLERANCE_NM = 0.001


def scene(samples: int, crop: int, tolerance_nm: float) -> str:
    return SCENE.format(
        grid_m=GRID_M,
        samples=samples,
        wavelength_nm=WAVELENGTH_NM,
        defocus_waves=DEFOCUS_WAVES,
        pixels=PIXELS,
        crop=crop,
        read_noise_e=READ_NOISE_E,
        ncpa_count=len(NOLL),
        tolerance_nm=tolerance_nm,
    )


def same_arrays(telescope: Telescope) -> cophase.Model:
    """The model that the peers have: the same grey pupil, modes and diversity, every pixel."""
    return cophase.Model.from_arrays(
        scene(len(telescope.amplitude), PIXELS, DEFAULT_TOLERANCE_NM),
        pupil=telescope.amplitude,
        segments=telescope.labels.astype(float),
        modes=telescope.ncpa,
        diversity_nm=telescope.diversity_nm,
    )


def own(samples: int, crop: int) -> tuple[cophase.Model, Telescope]:
    """Our own model of the same telescope: a band-limited pupil and the pixels that carry signal. With it the telescope
    whose modes are those of the model."""
    model = cophase.Model(scene(samples, crop, OWN_TOLERANCE_NM))
    telescope = Telescope.of(samples)
    units = np.eye(model.modes)[model.segment_modes :]
    return model, replace(telescope, ncpa=np.stack([model.wavefront_nm(unit)[1] for unit in units]))


def devices() -> dict[str, tuple[str | None, str]]:
    """What is here, by name: device and precision. Batches in f32 on OpenCL where there is one."""
    here = {"CPU f64": ("cpu", "f64"), "CPU f32": ("cpu", "f32")}
    return here | {f"{name} f32": (name, "f32") for name in cophase.devices() if name.startswith("opencl")}


class Model:
    """One image at a time, or a batch."""

    def __init__(self, model: cophase.Model, device: str, precision: str, capacity: int) -> None:
        self.session = cophase.Session(model, device=device, precision=precision, capacity=capacity, threads=0)

    def load(self, electrons: np.ndarray, weights: np.ndarray) -> None:
        """An image, or a stack; the weights follow from the image and the scene's read noise."""
        self.electrons = electrons
        self.session.load(electrons)

    def evaluate(self, coefficients_nm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """J and its gradient per nm."""
        return self.session.evaluate(coefficients_nm)

    def estimate(self) -> np.ndarray:
        """The minima, nm, from a flat wavefront."""
        return self.session.fit(self.electrons).coefficients_nm
