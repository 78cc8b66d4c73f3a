"""
Behind adaptive optics
======================

*How do I estimate static errors from short exposures behind adaptive optics?*

Short exposures of a star behind an adaptive optics (AO) loop: turbulence changes from one to the next, the static errors of
segments and NCPA stay. The full-phase estimate retrieves the wavefront behind each exposure and separates the static errors
from the turbulence and from the response of the loop to them.
"""

# %%
# The preset ``keck-onsky`` is a simulated night at Keck. Seven segments and a coarser sensor are enough here; the turbulence is
# frozen during an exposure.

import cophase
import matplotlib.pyplot as plt
import numpy as np

scene = cophase.scene_set(
    cophase.preset("keck-onsky"),
    pupil__aperture="hexagonal",
    pupil__rings=1,
    pupil__grid_m=5.625,
    pupil__samples=64,
    image__pixels=128,
    image__exposure_s=0.0,
    image__diversity_focus_waves_rms=1.0,
    wavefront_sensor__lenslets_across=10,
    mirror__actuators_across=11,
    estimate__method="full-phase",
)

# %%
# Exposures and slopes
# --------------------
#
# The simulator steps through the frames of the loop. An exposure is taken every 300 frames, with the slopes of the wavefront
# sensor at that time.

simulator = cophase.Simulator(scene)
simulator.step(1000)  # until the loop has closed
frames_e, slopes_mas = [], []
for _ in range(8):
    simulator.step(300)
    frames_e.append(simulator.image_e)
    slopes_mas.append(simulator.slopes_mas)

figure, axes = plt.subplots(1, 4, figsize=(10, 3), layout="constrained")
for axis, frame_e in zip(axes, frames_e):
    axis.imshow(np.sqrt(frame_e.clip(0)), origin="lower", cmap="inferno")
    axis.set_axis_off()
figure.suptitle("Exposures: the speckles change, the static errors stay")
plt.show()

# %%
# The estimate
# ------------
#
# Its error bars come from the scatter between the images. The report has the number of further images that halve them.

estimate = cophase.Estimator(scene).estimate(np.stack(frames_e), slopes_mas=np.stack(slopes_mas))
print(estimate.report())


def flat(map_nm):
    """A map without piston and tilt, which no image shows."""
    inside = ~np.isnan(map_nm)
    y, x = np.nonzero(inside)
    planes = np.stack([np.ones(x.size), x, y], axis=1)
    flat_nm = map_nm.copy()
    flat_nm[inside] -= planes @ np.linalg.lstsq(planes, map_nm[inside], rcond=None)[0]
    return flat_nm


rows = {"phasing": (simulator.phasing_nm, estimate.phasing_nm), "NCPA": (simulator.ncpa_nm, estimate.ncpa_nm)}
figure, axes = plt.subplots(2, 3, figsize=(10, 6.4), layout="constrained")
for row, (name, (true_nm, found_nm)) in zip(axes, rows.items()):
    panels = {"truth": flat(true_nm), "estimate": flat(found_nm), "residual": flat(found_nm - true_nm)}
    largest = np.nanmax(np.abs(panels["truth"]))
    for axis, (title, map_nm) in zip(row, panels.items()):
        picture = axis.imshow(map_nm, origin="lower", vmin=-largest, vmax=largest, cmap="RdBu_r")
        axis.set_title(f"{name} {title}, {np.nanstd(map_nm):.1f} nm RMS", fontsize=10)
        axis.set_axis_off()
    figure.colorbar(picture, ax=row, label="nm of wavefront")
plt.show()

for name, (true_nm, found_nm) in rows.items():
    assert np.nanstd(flat(found_nm - true_nm)) < 0.5 * np.nanstd(flat(true_nm)), name

# %%
# What to correct
# ---------------
#
# :meth:`cophase.Estimate.correct` computes what to add to segments, mirror and reference slopes. Modes within their error bars are held.

correction = estimate.correct()
print("pistons to add:", np.round(correction.pistons_nm, 1), "nm")
print("held:", correction.segments_held)
