"""
One image
=========

*How do I estimate segment errors and NCPA from one image, and how do I check the error bars?*

The phasing errors of 36 segments and the non-common path aberrations (NCPA), with error bars, from one defocused image of a
point source inside the telescope. The image is simulated, so the result can be compared with the truth.
"""

# %%
# The scene
# ---------
#
# A scene is a text in TOML that describes telescope, camera and modes. The library comes with several; here the image has
# fewer pixels and less light than in the preset ``keck-artificial``.

import cophase
import matplotlib.pyplot as plt
import numpy as np

scene = cophase.scene_set(
    cophase.preset("keck-artificial"),
    image__samples_per_lambda_over_d=2,
    image__pixels=128,
    image__crop_pixels=128,
)
model = cophase.Model(scene)
print(model)

# %%
# An image
# --------
#
# The truth: pistons of 64 nm RMS, and 73 nm RMS of NCPA in the Zernike modes 4 (focus) to 18. The image follows from the PSF
# of the model: photons, read noise.

segments = slice(0, model.segment_modes)
truth_nm = np.zeros(model.modes)
truth_nm[segments] = 90 * np.sin(4 * np.arange(model.segment_modes))
for noll in range(4, 19):
    truth_nm[model.mode_names.index(f"noll-{noll}")] = 27 * np.cos(5 * noll)

random = np.random.default_rng(1)
read_noise_e = 60.0
psf = model.psf(truth_nm)
frame_e = random.poisson(200**2 * psf / psf.max()) + read_noise_e * random.standard_normal(psf.shape)

figure, axis = plt.subplots(figsize=(5, 4), layout="constrained")
picture = axis.imshow(np.sqrt(frame_e.clip(0)), origin="lower", cmap="inferno")
axis.set_title("Defocused image")
figure.colorbar(picture, label="$\\sqrt{\\mathrm{electrons}}$")
plt.show()

# %%
# The estimate
# ------------
#
# An :class:`cophase.Estimator` is the full pipeline, the same as ``cophase estimate``. Its report names the RMS of both
# errors with their standard deviations, the reduced χ² of the image, which is about 1 where the model explains it, and
# warnings.

estimate = cophase.Estimator(scene).estimate(frame_e, read_noise_e=read_noise_e)
print(estimate.report())
print(f"phasing: {estimate.info.phasing_rms_nm:.2f} ± {estimate.info.phasing_sigma_nm:.2f} nm")
print(f"NCPA: {estimate.info.ncpa_rms_nm:.2f} ± {estimate.info.ncpa_sigma_nm:.2f} nm")

# %%
# Maps of the wavefront and of its error bars:

figure, axes = plt.subplots(2, 2, figsize=(9, 7.5), layout="constrained")
maps = {
    "Phasing": estimate.phasing_nm,
    "NCPA": estimate.ncpa_nm,
    "Phasing, one sigma": estimate.phasing_sigma_nm,
    "NCPA, one sigma": estimate.ncpa_sigma_nm,
}
for axis, (title, map_nm) in zip(axes.flat, maps.items()):
    largest = np.nanpercentile(np.abs(map_nm), 99)
    colours = {"vmin": 0, "cmap": "viridis"} if "sigma" in title else {"vmin": -largest, "cmap": "RdBu_r"}
    picture = axis.imshow(map_nm, origin="lower", vmax=largest, **colours)
    axis.set_title(title)
    axis.set_axis_off()
    figure.colorbar(picture, ax=axis, label="nm of wavefront")
plt.show()

# %%
# Is it right?
# ------------
#
# The piston of each segment against the truth, with its error bar. An image does not depend on the mean of all pistons, which
# is 0 in the estimate. The normalised residuals should scatter by about 1.

true_nm = truth_nm[segments] - truth_nm[segments].mean()
found_nm, sigma_nm = estimate.coefficients_nm[segments], estimate.sigma_nm[segments]

figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
axis.errorbar(range(model.segment_modes), found_nm - true_nm, sigma_nm, fmt="o")
axis.axhline(0, color="grey", linewidth=0.8)
axis.set_xlabel("segment")
axis.set_ylabel("estimate − truth [nm]")
plt.show()

normalised = (found_nm - true_nm) / sigma_nm
print(f"scatter of the normalised residuals: {normalised.std():.2f}")
assert 0.5 < normalised.std() < 2, normalised

# %%
# The same in MATLAB and Octave
# -----------------------------
#
# .. tutorial-form:: one_image.m
#
# The same in C
# -------------
#
# .. tutorial-form:: one_image.c tutorial.h
