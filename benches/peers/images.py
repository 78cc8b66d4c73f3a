"""The images that everybody reads, with the truth behind them: what `cophase image` makes."""

import subprocess
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from astropy.io import fits
from telescope import Telescope, coordinates_m, zernikes

PIXELS = 240
READ_NOISE_E = 60.0
#: The scene: keck-artificial at 2 pixels per lambda/D. The truth is made on 960 samples.
SETTINGS = {
    "image.samples_per_lambda_over_d": "2",
    "image.pixels": str(PIXELS),
    "image.read_noise_e": str(READ_NOISE_E),
    "modes.ncpa": '"zernike"',
    "modes.exact_zernikes": "[]",
}


def make(program: Path, folder: Path, seeds: int, each: int) -> list[Path]:
    """A file of `each` images for every seed: one truth, `each` draws of noise."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for seed in range(1, seeds + 1):
        files.append(folder / f"seed-{seed}.fits")
        settings = SETTINGS | {"image.count": str(each)}
        words = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
        command = [program, "image", "keck-artificial", "-o", files[-1], "--seed", str(seed), "--quiet", *words]
        subprocess.run(command, check=True)
    return files


@dataclass
class Images:
    """Images and their truths.

    Attributes
    ----------
    electrons : (images, 240, 240) array
    seed : (images,) array
        Which of the truths is behind each image.
    piston_nm : (truths, 36) array
    low_order_nm : (truths, 21) array
        The NCPA in Noll 1 to 21, which hold them exactly.
    """

    electrons: np.ndarray
    seed: np.ndarray
    piston_nm: np.ndarray
    low_order_nm: np.ndarray

    @classmethod
    def read(cls, files: list[Path]) -> "Images":
        telescope = Telescope.of(120)
        x, y = np.meshgrid(*2 * [coordinates_m(120)])
        electrons, seed, pistons, low_order = [], [], [], []
        for number, path in enumerate(files):
            with fits.open(path) as file:
                cube = np.atleast_3d(file["IMAGES"].data).astype(float).reshape(-1, PIXELS, PIXELS)
                piston_nm = np.array(file["TRUTH"].data["PISTON_NM"], float)
                phasing_nm, ncpa_nm = (np.array(file[f"TRUTH_{name}"].data, float) for name in ("PHASING", "NCPA"))
            seen = np.isfinite(ncpa_nm)
            both = seen & (telescope.labels >= 0)
            # A different order of the segments would compare everybody with nonsense.
            assert np.abs(phasing_nm - piston_nm[telescope.labels])[both].max() < 1e-6, (
                "the segments are in another order"
            )
            basis = zernikes(x[seen], y[seen], range(1, 22))
            coefficients, *_ = np.linalg.lstsq(basis.T, ncpa_nm[seen], rcond=None)
            assert np.abs(coefficients @ basis - ncpa_nm[seen]).max() < 1e-6, "Noll 1 to 21 do not hold the NCPA"
            electrons.append(cube)
            seed.extend(len(cube) * [number])
            pistons.append(piston_nm)
            low_order.append(coefficients)
        # One truth after the other, so that the first few images differ in their truths.
        order = np.argsort(np.concatenate([np.arange(len(cube)) for cube in electrons]), kind="stable")
        stacked = np.concatenate(electrons)[order]
        return cls(stacked, np.array(seed)[order], np.array(pistons), np.array(low_order))

    def __len__(self):
        return len(self.electrons)

    @cached_property
    def weights(self):
        """Inverse variance of each pixel as far as the image tells."""
        return 1 / (np.maximum(self.electrons, 0) + READ_NOISE_E**2)

    def errors_nm(self, telescope: Telescope, coefficients_nm: np.ndarray) -> np.ndarray:
        """Errors of the estimates of the first images, (estimates, 2): phasing and NCPA, nm RMS over the pupil (weighted
        by the glass in a sample) without piston, tip and tilt."""
        samples, lit = len(telescope.amplitude), (telescope.labels >= 0) & np.isfinite(telescope.ncpa[0])
        x, y = (axis[lit] for axis in np.meshgrid(*2 * [coordinates_m(samples)]))
        weight = telescope.amplitude[lit] / telescope.amplitude[lit].sum()
        tilts = np.linalg.qr(np.stack([np.ones_like(x), x, y], axis=1) * np.sqrt(weight)[:, None])[0]
        low_order = zernikes(x, y, range(1, 22))
        ncpa = telescope.ncpa[:, lit]

        def rms(map_nm):
            whitened = map_nm * np.sqrt(weight)
            return np.linalg.norm(whitened - tilts @ (tilts.T @ whitened))

        errors = []
        for estimate_nm, seed in zip(coefficients_nm, self.seed):
            pistons, smooth = np.split(estimate_nm, [telescope.segments])
            phasing = (pistons - self.piston_nm[seed])[telescope.labels[lit]]
            errors.append([rms(phasing), rms(smooth @ ncpa - self.low_order_nm[seed] @ low_order)])
        return np.array(errors)


def pooled(errors_nm: np.ndarray) -> list[float]:
    """Root of the mean square over images: phasing, NCPA."""
    return np.sqrt((errors_nm**2).mean(axis=0)).tolist()
