# %% [markdown]
# # On the sky
#
# Phasing errors of the segments and non-common path aberrations (NCPA), with error bars and corrections, from short exposures
# of a star behind adaptive optics and the slopes of the wavefront sensor. Runs as a script (`python on_sky.py [PICTURE.png]`) or cell by cell in an editor that knows `# %%`. Needs matplotlib.

# %%
import re
import sys

import cophase
import matplotlib.pyplot as plt
import numpy as np

# %% [markdown]
# ## The telescope
#
# The preset is Keck. Seven of its segments are enough here and need less time, with less defocus for a smaller detector;
# turbulence is frozen during each exposure.

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
# The wavefront behind each exposure, static errors separated from the turbulence: maximum a posteriori (MAP).
scene += '\n[estimate]\nmethod = "full-phase"\n'

# %% [markdown]
# ## Exposures
#
# 64 nm RMS of piston errors and 73 nm RMS of NCPA, which the loop does not correct.

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
# The estimate uses the slopes, if they are given, and the loop that the scene describes. `estimate.ao_knowledge = "spectrum"` in the
# scene makes it use neither; the error bars are larger then.

# %%
estimator = cophase.Estimator(scene)
estimate = estimator.estimate(np.stack(frames_e), slopes_mas=np.stack(slopes_mas))
info = estimate.info
print(estimate.report())


def flat(map_nm):
    """A map without piston and tilt."""
    inside = ~np.isnan(map_nm)
    y, x = np.nonzero(inside)
    planes = np.stack([np.ones(x.size), x, y], axis=1)
    flat_nm = map_nm.copy()
    flat_nm[inside] -= planes @ np.linalg.lstsq(planes, map_nm[inside], rcond=None)[0]
    return flat_nm


rows = {
    "phasing": (simulator.phasing_nm, estimate.phasing_nm, estimate.phasing_sigma_nm, info.phasing_sigma_nm),
    "NCPA": (simulator.ncpa_nm, estimate.ncpa_nm, estimate.ncpa_sigma_nm, info.ncpa_sigma_nm),
}
for name, (true_nm, found_nm, _, sigma_nm) in rows.items():
    true, residual = np.nanstd(flat(true_nm)), np.nanstd(flat(found_nm - true_nm))
    print(f"{name:8} {true:5.1f} nm RMS, residual {residual:.1f}, one sigma {sigma_nm:.1f}")
print(f"{info.images_to_halve:.0f} more images halve both error bars")

# %% [markdown]
# ## Corrections
#
# What to add to the segments, to the mirror's commands, and to the sensor's reference slopes, which keep the mirror there. A
# mode within the deadband of the scene's section [commands] is not corrected.

# %%
correction = estimate.correct()
print("pistons to add:", np.round(correction.pistons_nm).astype(int), "nm")
print(f"{correction.corrected_modes} NCPA modes to correct, with {correction.actuators_nm.size} actuators")

# %% [markdown]
# ## The picture
#
# The error bar of a map includes piston and tilt of all segments together; the sigma above does not.

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
