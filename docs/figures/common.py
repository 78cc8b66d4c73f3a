"""What the figures of the pages share: scenes, images, panels.

Each script beside this file writes its pictures to this folder: ``PYTHONPATH=bindings/python python docs/figures/concepts.py``, after
``cargo build --release``. Needs NumPy and matplotlib.
"""

from pathlib import Path

import cophase
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

FOLDER = Path(__file__).resolve().parent
#: Pictures stay below 150 kB.
DPI = 100
READ_NOISE_E = 60.0


def scene(**settings):
    """Keck at 2 pixels per lambda/D and without a crop, so that a frame has the pixels of a PSF of the model."""
    own = {"image__samples_per_lambda_over_d": 2, "image__pixels": 128, "image__crop_pixels": 128}
    return cophase.scene_set(cophase.preset("keck-artificial"), **{**own, **settings})


def aberrations_nm(model, pistons_nm=64.0, ncpa_nm=73.0, seed=1):
    """Coefficients of pistons and of Zernikes 4 to 18, normal, of these RMS."""
    random = np.random.default_rng(seed)
    coefficients_nm = np.zeros(model.modes)
    pistons = random.standard_normal(model.segment_modes)
    coefficients_nm[: model.segment_modes] = pistons_nm * (pistons - pistons.mean()) / pistons.std()
    zernikes = [model.mode_names.index(f"noll-{noll}") for noll in range(4, 19)]
    values = random.standard_normal(len(zernikes))
    coefficients_nm[zernikes] = ncpa_nm * values / np.linalg.norm(values)
    return coefficients_nm


def exposure_e(psf, flux_e=3e8, seed=1):
    """Frame of a star of ``flux_e`` electrons with photon and read noise."""
    random = np.random.default_rng(seed)
    return random.poisson(flux_e * psf) + READ_NOISE_E * random.standard_normal(psf.shape)


def panel(axis, values, title, *, limit=None, colours="RdBu_r", label="nm", low=None, ticks=False):
    """A map or an image with rows upwards, as every picture of the program has them."""
    limit = np.nanmax(np.abs(values)) if limit is None else limit
    low = -limit if low is None else low
    image = axis.imshow(values, origin="lower", cmap=colours, vmin=low, vmax=limit, interpolation="nearest")
    axis.set_title(title, loc="left", fontsize=8.5)
    if not ticks:
        axis.set_xticks([])
        axis.set_yticks([])
    bar = axis.figure.colorbar(image, ax=axis, shrink=0.8, pad=0.02)
    bar.ax.tick_params(labelsize=7)
    bar.set_label(label, fontsize=8)


def image_panel(axis, image, title):
    """The square root of an image, relative to its peak."""
    panel(axis, np.sqrt(np.clip(image, 0, None) / image.max()), title, limit=1, low=0, colours="inferno", label="√(I/peak)")


def save(figure, name, colours=256):
    """Writes a picture with few colours, which looks like one with all, at a third of the bytes."""
    path = FOLDER / name
    figure.savefig(path, dpi=DPI)
    plt.close(figure)
    Image.open(path).convert("RGB").quantize(colours, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")
