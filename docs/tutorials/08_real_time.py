"""
Fits with a deadline
====================

*How do I fit every frame within a deadline?*

A control loop wants a fit of each frame within a time. A :class:`cophase.Session` allocates its memory when it is created, fits
frame by frame, and stops at its deadline with the best so far. A :class:`cophase.Sequence` combines the last frames.
"""

# %%
# The model has few pixels and single precision: what a loop needs is the time of one fit.

import time

import cophase
import matplotlib.pyplot as plt
import numpy as np

scene = """
[pupil]
aperture = "keck"
grid_m = 10.95
samples = 60

[image]
wavelength_nm = 2168.6
samples_per_lambda_over_d = 2
pixels = 96
crop_pixels = 96
diversity_focus_waves_rms = 0.7
read_noise_e = 10

[estimate]
sampling = "native"
"""
model = cophase.Model(scene)
session = cophase.Session(model, precision="f32", threads=1)
print(model)

segments = slice(0, model.segment_modes)
truth_nm = np.zeros(model.modes)
truth_nm[segments] = 57 * np.sin(4 * np.arange(model.segment_modes))
truth_nm[segments] -= truth_nm[segments].mean()
psf = model.psf(truth_nm)
random = np.random.default_rng(4)


def frame_e():
    """A frame of a million electrons."""
    return random.poisson(1e6 * psf) + 10 * random.standard_normal(psf.shape)


# %%
# Frame by frame
# --------------
#
# Each fit has a status: ``OK``, or ``DEADLINE`` where the time was over. A sequence takes the fits that are good.

sequence = cophase.Sequence(model, capacity=50)
durations_s, errors_nm, running_nm = [], [], []


def error(coefficients_nm):
    """RMS error of the pistons; their mean is in no image."""
    return np.std((coefficients_nm - truth_nm)[segments])


for _ in range(50):
    frame = frame_e()
    start = time.perf_counter()
    fit = session.fit(frame, deadline_s=1.0)
    durations_s.append(time.perf_counter() - start)
    errors_nm.append(error(fit.coefficients_nm))
    if fit.status == "OK":
        sequence.push(session)
    running_nm.append(error(sequence.estimate().coefficients_nm))

# %%
# The time of a fit is that of its evaluations; the error of the running estimate falls as the root of the number of frames.

figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
axes[0].hist(np.array(durations_s) * 1e3, bins=20)
axes[0].set_xlabel("time of a fit [ms], on the machine that built this page")
axes[0].set_ylabel("frames")
axes[1].plot(errors_nm, ".", label="one frame")
axes[1].plot(running_nm, label="running estimate")
axes[1].set_ylim(0, None)
axes[1].set_xlabel("frame")
axes[1].set_ylabel("error of the pistons [nm RMS]")
axes[1].legend()
plt.show()

info = sequence.estimate().info
print(f"{info.used} of {info.images} frames used")
print(f"phasing: {info.phasing_rms_nm:.2f} ± {info.phasing_sigma_nm:.2f} nm")
print(f"NCPA: {info.ncpa_rms_nm:.2f} ± {info.ncpa_sigma_nm:.2f} nm")
assert running_nm[-1] < 0.5 * np.mean(errors_nm), (running_nm[-1], np.mean(errors_nm))

# %%
# A deadline that is too short
# ----------------------------
#
# The coefficients are then the best that were found, and the status is ``DEADLINE``.

late = session.fit(frame_e(), deadline_s=1e-3)
print(late.status, f"after {late.reports.evaluations} evaluations, error {error(late.coefficients_nm):.1f} nm")

# %%
# The same in MATLAB and Octave
# -----------------------------
#
# .. tutorial-form:: real_time.m
#
# The same in C
# -------------
#
# The loop neither allocates nor waits: all memory comes before it.
#
# ``tutorial.h`` is that of :doc:`01_one_image`.
#
# .. tutorial-form:: real_time.c
#
# :doc:`/c-realtime` goes on with threads, priorities and latencies.
