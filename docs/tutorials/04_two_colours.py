"""
Two colours
===========

*How do I find pistons of more than half a wavelength?*

An image at one wavelength does not show a step of a whole wavelength between two segments. Images at two wavelengths do: their
whole wavelengths agree at one piston only, up to the beat of the two.
"""

# %%
# Pistons of several micrometres, seen at 2168.6 nm and at 1640 nm. A channel has what differs from ``[image]``; the pixels of the
# camera keep their angle on the sky.

import cophase
import matplotlib.pyplot as plt
import numpy as np

one_colour = """
[pupil]
aperture = "hexagonal"
rings = 1
samples = 120

[image]
wavelength_nm = 2168.6
samples_per_lambda_over_d = 2
pixels = 128
diversity_focus_waves_rms = 1.0
read_noise_e = 20

[modes]
ncpa = "zernike"
ncpa_count = 14
exact_zernikes = []
"""
two_colours = (
    one_colour
    + """
[[image.channel]]
name = "K"

[[image.channel]]
name = "H"
wavelength_nm = 1640
"""
)

model = cophase.Model(two_colours)
segments = slice(0, model.segment_modes)
random = np.random.default_rng(3)
truth_nm = 10 * random.standard_normal(model.modes)
truth_nm[segments] = 1500 * random.standard_normal(model.segment_modes)
truth_nm[segments] -= truth_nm[segments].mean()

frames_e = {}
for name in model.channels:
    channel = model.channel(name)
    psf = channel.psf(truth_nm)
    frame_e = np.zeros(channel.frame_shape)
    edge = (channel.frame_shape[0] - channel.pixels) // 2
    frame_e[edge : edge + channel.pixels, edge : edge + channel.pixels] = psf * 300**2 / psf.max()
    frames_e[name] = random.poisson(frame_e) + 20 * random.standard_normal(frame_e.shape)

# %%
# One colour, then two
# --------------------

one = cophase.Estimator(one_colour).estimate(frames_e["K"])
two = cophase.Estimator(two_colours).estimate(frames_e)
print(two.report())

# %%
# The joint estimate lists, for each segment, the whole wavelengths that were added, their probability, and how far off the
# next most probable number is:

for segment, (waves, probability, next_nm) in enumerate(two.integers):
    print(f"segment {segment}: {waves:+.0f} waves, probability {probability:.4f}, next one {next_nm:+.0f} nm away")

# %%
# The pistons relative to segment 0, against the truth. With one colour they are right up to whole wavelengths (grey lines); with
# two they are right.

figure, axis = plt.subplots(figsize=(8, 4.5), layout="constrained")
true_nm = truth_nm[segments] - truth_nm[0]
for order in range(-4, 5):
    axis.axhline(2168.6 * order, color="lightgrey", linewidth=0.8)
for name, estimate, marker in (("one colour", one, "x"), ("two colours", two, "o")):
    found_nm = estimate.coefficients_nm[segments] - estimate.coefficients_nm[0]
    axis.plot(found_nm - true_nm, marker, label=name)
axis.set_ylim(-4.5 * 2168.6, 4.5 * 2168.6)
axis.set_xlabel("segment")
axis.set_ylabel("piston, estimate − truth [nm]")
axis.legend()
plt.show()

error_nm = two.coefficients_nm[segments] - two.coefficients_nm[0] - true_nm
print(f"largest error with two colours: {np.abs(error_nm).max():.2f} nm")
assert np.abs(error_nm).max() < 5
