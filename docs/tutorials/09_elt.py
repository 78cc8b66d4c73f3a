"""
Extremely Large Telescope
=========================

*How long does an estimate of 798 segments take, and how good is it?*

798 segment pistons and 66 NCPA modes of the ELT from one defocused image: the time it takes, what is uncertain in the result, and
how many images lower it.
"""

# %%
# The telescope
# -------------
#
# The preset ``elt-artificial`` has the segments of the ELT and a point source in its focus. Every other telescope of rings of hexagons is
# described by the same keys of the section ``[pupil]``.

import time

import cophase
import matplotlib.pyplot as plt
import numpy as np

scene = cophase.scene_set(cophase.preset("elt-artificial"), image__pixels=256, image__crop_pixels=256)
model = cophase.Model(scene)
print(model)

# %%
# An image
# --------
#
# The truth: pistons of 50 nm RMS, and 70 nm RMS of NCPA in the Zernike modes 4 (focus) to 36. The brightest pixel has a
# signal-to-noise ratio of 500.

random = np.random.default_rng(6)
segments, ncpa = slice(0, model.segment_modes), slice(model.segment_modes, model.modes)
truth_nm = np.zeros(model.modes)
truth_nm[segments] = 50 * random.standard_normal(model.segment_modes)
truth_nm[segments] -= truth_nm[segments].mean()
for noll in range(4, 37):
    truth_nm[model.mode_names.index(f"noll-{noll}")] = random.standard_normal() / noll
truth_nm[ncpa] *= 70 / np.linalg.norm(truth_nm[ncpa])
psf = model.psf(truth_nm)


def image():
    """An image with photon noise and a read noise of 20 electrons."""
    return random.poisson(500**2 * psf / psf.max()) + 20 * random.standard_normal(psf.shape)


frame_e = image()
true_map_nm, _ = model.wavefront_nm(truth_nm)

figure, axes = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
picture = axes[0].imshow(true_map_nm, origin="lower", cmap="RdBu_r", vmin=-150, vmax=150)
axes[0].set_title("True pistons")
figure.colorbar(picture, ax=axes[0], label="nm of wavefront")
picture = axes[1].imshow(np.sqrt(frame_e.clip(0)), origin="lower", cmap="inferno")
axes[1].set_title("Defocused image")
figure.colorbar(picture, ax=axes[1], label="$\\sqrt{\\mathrm{electrons}}$")
for axis in axes:
    axis.set_axis_off()
plt.show()

# %%
# The estimate
# ------------

start = time.perf_counter()
estimator = cophase.Estimator(scene)
one = estimator.estimate(frame_e)
print(one.report())
print(f"{time.perf_counter() - start:.0f} s, on the machine that built this page")

# %%
# Residuals. Those of phasing and NCPA are smooth, and opposite: the pistons of 798 segments form a tilt or an astigmatism nearly as
# well as the NCPA do, and an image shows their sum. The error bar of the whole wavefront is therefore smaller than those of its parts.

true_ncpa_nm = model.wavefront_nm(truth_nm)[1]
residuals_nm = {
    "phasing": one.phasing_nm - true_map_nm,
    "NCPA": one.ncpa_nm - true_ncpa_nm,
    "wavefront": one.phasing_nm + one.ncpa_nm - true_map_nm - true_ncpa_nm,
}
figure, axes = plt.subplots(1, 3, figsize=(11, 4), layout="constrained")
for axis, (name, map_nm) in zip(axes, residuals_nm.items()):
    picture = axis.imshow(map_nm - np.nanmean(map_nm), origin="lower", cmap="RdBu_r", vmin=-5, vmax=5)
    axis.set_title(f"{name}, {np.nanstd(map_nm):.2f} nm RMS")
    axis.set_axis_off()
figure.colorbar(picture, ax=axes, label="estimate − truth [nm]")
plt.show()

# %%
# What is uncertain?
# ------------------
#
# The eigenvectors of the covariance of the pistons with the largest eigenvalues are the shapes that are known least: here two tilts
# and two astigmatisms.

variances_nm2, shapes = np.linalg.eigh(one.covariance_nm2[segments, segments])
share = variances_nm2[::-1].cumsum() / variances_nm2.sum()
print(f"{np.searchsorted(share, 0.5) + 1} of {model.segment_modes} shapes have half of the variance")

figure, axes = plt.subplots(1, 4, figsize=(11, 3.2), layout="constrained")
for axis, variance_nm2, shape in zip(axes, variances_nm2[::-1], shapes.T[::-1]):
    coefficients_nm = np.zeros(model.modes)
    coefficients_nm[segments] = shape
    axis.imshow(model.wavefront_nm(coefficients_nm)[0], origin="lower", cmap="RdBu_r")
    axis.set_title(f"{np.sqrt(variance_nm2 / model.segment_modes):.2f} nm RMS")
    axis.set_axis_off()
plt.show()

# %%
# More images
# -----------
#
# Four images of the same wavefront are estimated together; the noise halves.

four = estimator.estimate(np.stack([frame_e, *(image() for _ in range(3))]))
for name, estimate in (("one image", one), ("four images", four)):
    info = estimate.info
    print(f"{name}: error bars {info.phasing_sigma_nm:.2f} nm of phasing, {info.ncpa_sigma_nm:.2f} nm of NCPA")

normalised = (one.coefficients_nm - truth_nm)[segments] / one.sigma_nm[segments]
print(f"scatter of the normalised residuals: {normalised.std():.2f}")
assert 0.5 < normalised.std() < 2, normalised
assert four.info.phasing_sigma_nm < 0.6 * one.info.phasing_sigma_nm

# %%
# Behind adaptive optics the presets are ``tmt-onsky`` and ``elt-onsky``: see :doc:`/scaling` for memory and time, and :doc:`/ao-performance`.
