"""
A pair of images
================

*What do two images show that one does not?*

Two images of the same wavefront, defocused to both sides, determine the amplitude of their defocus. One image does not: if the
defocus differs from that of the scene, the estimate is wrong and nothing shows it.
"""

# %%
# The defocus of the scene is 1 wave RMS; in truth it is 2 % larger.

import cophase
import matplotlib.pyplot as plt
import numpy as np

scene = """
[pupil]
aperture = "hexagonal"
rings = 1
samples = 120

[image]
wavelength_nm = 2000
samples_per_lambda_over_d = 2
pixels = 128
crop_pixels = 128
diversity_focus_waves_rms = 1.0
read_noise_e = 20

[modes]
ncpa = "zernike"
ncpa_count = 14
exact_zernikes = []
"""
pair = (
    scene
    + """
[[image.channel]]
name = "plus"
diversity_focus_waves_rms = 1.0

[[image.channel]]
name = "minus"
diversity_focus_waves_rms = -1.0
"""
)

models = {
    name: cophase.Model(cophase.scene_set(scene, image__diversity_focus_waves_rms=defocus))
    for name, defocus in (("plus", 1.02), ("minus", -1.02))
}
segments = slice(0, models["plus"].segment_modes)
mode = np.arange(models["plus"].modes)
truth_nm = 15 * np.cos(5 * mode)
truth_nm[segments] = 80 * np.sin(4 * mode[segments])
truth_nm[segments] -= truth_nm[segments].mean()

random = np.random.default_rng(3)
frames_e = {}
for name, model in models.items():
    psf = model.psf(truth_nm)
    frames_e[name] = random.poisson(300**2 * psf / psf.max()) + 20 * random.standard_normal(psf.shape)

figure, axes = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
for axis, (name, frame_e) in zip(axes, frames_e.items()):
    axis.imshow(np.sqrt(frame_e.clip(0))[32:96, 32:96], origin="lower", cmap="inferno")
    axis.set_title(name)
    axis.set_axis_off()
plt.show()

# %%
# Three estimates
# ---------------
#
# - from one image: the reduced χ² is 1, and the focus is off by 40 nm;
# - from both images with the defocus of the scene: a warning: the channels contradict each other;
# - from both images with ``estimate.fit_optics = ["defocus"]``: the defocus is found, and the focus with it.

estimates = {
    "one image": cophase.Estimator(scene).estimate(frames_e["plus"]),
    "pair": cophase.Estimator(pair).estimate(frames_e),
    "pair, defocus fitted": cophase.Estimator(
        cophase.scene_set(pair, estimate__fit_optics=["defocus"])
    ).estimate(frames_e),
}
focus = models["plus"].mode_names.index("noll-4")
for name, estimate in estimates.items():
    error_nm = estimate.coefficients_nm[focus] - truth_nm[focus]
    print(f"error of focus, {name}: {error_nm:.3f} ± {estimate.sigma_nm[focus]:.3f} nm")
    print(f"   reduced χ² {estimate.info.reduced_chi2:.2f}")
    for warning in estimate.warnings:
        print("   warning:", warning)

# %%
# The report of the last one states the defocus with its error bar:

print(estimates["pair, defocus fitted"].report())

# %%
# Errors of the modes
# -------------------

figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
modes = np.arange(len(truth_nm))
for offset, (name, estimate) in zip((-0.25, 0, 0.25), estimates.items()):
    axis.bar(modes + offset, estimate.coefficients_nm - truth_nm, 0.25, label=name)
axis.set_xticks(modes, models["plus"].mode_names, rotation=90)
axis.set_ylabel("estimate − truth [nm]")
axis.legend()
plt.show()

assert abs((estimates["one image"].coefficients_nm - truth_nm)[focus]) > 20
assert np.abs(estimates["pair, defocus fitted"].coefficients_nm - truth_nm).max() < 2

# %%
# The same in MATLAB and Octave
# -----------------------------
#
# .. tutorial-form:: pair.m
#
# The same in C
# -------------
#
# ``tutorial.h`` is that of :doc:`01_one_image`.
#
# .. tutorial-form:: pair.c
