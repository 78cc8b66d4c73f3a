"""
A closed loop
=============

*How do I correct the segments in several rounds?*

Estimate, correct, take the next image: the phasing errors fall to the noise in one or two steps, and stay there while the segments
drift.
"""

# %%
# Seven segments, an image with a peak signal-to-noise ratio of 100. The section ``[commands]`` of a scene has the policy of the
# corrections: the gain, and the deadband within which a mode is held.

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
diversity_focus_waves_rms = 1.0
read_noise_e = 20

[modes]
ncpa = "zernike"
ncpa_count = 14
exact_zernikes = []

[commands]
gain = 0.7
deadband_sigma = 1.0
"""
model = cophase.Model(scene)
estimator = cophase.Estimator(scene)
random = np.random.default_rng(5)
segments = model.segment_modes
ncpa_nm = 15 * random.standard_normal(model.modes - segments)


def exposure(pistons_nm):
    """An image of these pistons and of the NCPA."""
    psf = model.psf(np.concatenate([pistons_nm, ncpa_nm]))
    frame_e = np.zeros(model.frame_shape)
    edge = (model.frame_shape[0] - model.pixels) // 2
    frame_e[edge : edge + model.pixels, edge : edge + model.pixels] = psf * 100**2 / psf.max()
    return random.poisson(frame_e) + 20 * random.standard_normal(frame_e.shape)


# %%
# The loop
# --------
#
# Between images each segment drifts by 2 nm RMS. ``pistons_nm`` of a correction is what to add to the segments.

pistons_nm = 100 * random.standard_normal(segments)
history_nm, sigmas_nm, held = [], [], []
for _ in range(12):
    estimate = estimator.estimate(exposure(pistons_nm))
    correction = estimate.correct()
    history_nm.append(pistons_nm - pistons_nm.mean())
    sigmas_nm.append(estimate.info.phasing_sigma_nm)
    held.append(sum(reason != "" for reason in correction.segments_held))
    pistons_nm = pistons_nm + correction.pistons_nm + 2 * random.standard_normal(segments)

rms_nm = np.std(history_nm, axis=1)
for step, (rms, count) in enumerate(zip(rms_nm, held)):
    print(f"image {step:2}: pistons {rms:7.2f} nm RMS, {count} of {segments} held")

# %%
# With a gain of 0.7 the errors fall to 0.3 of themselves with each image, until the drift and the noise hold them.

figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
axes[0].plot(history_nm, "o-", markersize=3)
axes[0].set_ylabel("piston of each segment [nm]")
axes[1].semilogy(rms_nm, "o-", label="RMS of the pistons")
axes[1].semilogy(sigmas_nm, ":", label="error bar of one image")
axes[1].legend()
for axis in axes:
    axis.set_xlabel("image")
plt.show()

assert rms_nm[-4:].max() < 0.1 * rms_nm[0], rms_nm

# %%
# A drift that is known lets a filter combine the images of a night: see :doc:`/tracking`.
