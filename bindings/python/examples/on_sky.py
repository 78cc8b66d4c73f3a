# %% [markdown]
# # On the sky
#
# Short exposures of a star behind adaptive optics; from all of them together, and from what the wavefront sensor measured
# meanwhile, the phasing errors of the segments and the non-common path aberrations (NCPA), with error bars and corrections.
# Runs as a script (`python on_sky.py [PICTURE.png]`) or cell by cell in an editor that knows `# %%`. Needs matplotlib.

# %%
import re
import sys

import cophase
import matplotlib.pyplot as plt
import numpy as np

# %% [markdown]
# ## The telescope
#
# The preset is Keck. Seven of its segments are enough here, and quick, with less defocus for a smaller detector; turbulence
# is frozen during each exposure.

# %%
scene = cophase.preset("keck-onsky")
for key, value in {
    "aperture": '"hexagonal"',
    "rings": 1,
    "grid_m": 5.625,
    "samples": 64,
    "pixels": 128,
    "exposure_s": 0.0,
    "lenslets_across": 10,
    "actuators_across": 11,
    "diversity_focus_waves_rms": 1.0,
}.items():
    scene, found = re.subn(rf"^{key} .*$", f"{key} = {value}", scene, flags=re.MULTILINE)
    assert found == 1, key

# %% [markdown]
# ## Exposures
#
# 64 nm RMS of piston errors and 73 nm RMS of NCPA, behind a loop that knows of neither.

# %%
simulator = cophase.Simulator(scene)
simulator.step(1000)  # the loop has closed
frames_e, slopes_mas = [], []
for _ in range(10):
    simulator.step(300)
    frames_e.append(simulator.image_e)
    slopes_mas.append(simulator.slopes_mas)

# %% [markdown]
# ## The estimate
#
# Without the slopes it knows the loop, but not what the sensor saw; with `knows="spectrum"` not even that. The less it
# knows, the larger the error bars.

# %%
estimator = cophase.FullPhase(scene)
estimate = estimator.estimate(np.stack(frames_e), np.stack(slopes_mas))
report = estimate.report
print(f"{report.used} of {report.images} images, {report.passes} passes, knows {estimate.knows}, {report.seconds:.1f} s")
for sentence in estimate.warnings:
    print("warning:", sentence)


def flat(map_nm):
    """Without piston and tilt."""
    glass = ~np.isnan(map_nm)
    y, x = np.nonzero(glass)
    planes = np.stack([np.ones(x.size), x, y], axis=1)
    left_nm = map_nm.astype(float)
    left_nm[glass] -= planes @ np.linalg.lstsq(planes, left_nm[glass], rcond=None)[0]
    return left_nm


rows = {
    "phasing": (simulator.phasing_nm, estimate.phasing_nm, estimate.phasing_sigma_nm, report.phasing_sigma_nm),
    "NCPA": (simulator.ncpa_nm, estimate.ncpa_nm, estimate.ncpa_sigma_nm, report.ncpa_sigma_nm),
}
for name, (true_nm, found_nm, _, sigma_nm) in rows.items():
    true, residual = np.nanstd(flat(true_nm)), np.nanstd(flat(found_nm - true_nm))
    print(f"{name:8} {true:5.1f} nm RMS, residual {residual:.1f}, one sigma {sigma_nm:.1f}")
print(estimator.images_needed(phasing_nm=5), "more images for 5 nm of phasing")

# %% [markdown]
# ## Corrections
#
# What to add to the segments, and to the mirror's commands and the sensor's reference slopes, which keep them there. What is
# under its error bar is left alone.

# %%
corrections = estimator.corrections()
print("pistons to add:", np.round(corrections.pistons_nm).astype(int), "nm")
print(f"{corrections.corrected_modes} NCPA modes to correct, with {corrections.actuators_nm.size} actuators")

# %% [markdown]
# ## The picture
#
# The error bar of a map holds what is piston and tilt of all segments together, which the sigma above leaves out.

# %%
figure, axes = plt.subplots(2, 4, figsize=(15, 7), layout="constrained")
for row, (name, (true_nm, found_nm, bar_nm, _)) in zip(axes, rows.items()):
    panels = {"truth": flat(true_nm), "estimate": flat(found_nm), "residual": flat(found_nm - true_nm)}
    largest = np.nanmax(np.abs(panels["truth"]))
    for axis, (title, map_nm) in zip(row, panels.items()):
        image = axis.imshow(map_nm, origin="lower", vmin=-largest, vmax=largest, cmap="RdBu_r")
        axis.set_title(f"{name} {title}, {np.nanstd(map_nm):.1f} nm RMS", loc="left", fontsize=10)
    figure.colorbar(image, ax=row[:3], shrink=0.85, label="nm")
    image = row[3].imshow(bar_nm, origin="lower", vmin=0)
    row[3].set_title(f"{name} one sigma", loc="left", fontsize=10)
    figure.colorbar(image, ax=row[3], shrink=0.85, label="nm")
for axis in axes.flat:
    axis.set_xticks([])
    axis.set_yticks([])

picture = sys.argv[1] if sys.argv[1:] else "on_sky.png"
figure.savefig(picture, dpi=110)
print(f"{picture} has the maps")
