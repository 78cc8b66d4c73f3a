# %% [markdown]
# # An artificial source, imaged once
#
# The phasing errors of Keck's 36 segments and the non-common path aberrations (NCPA), with error bars, from one defocused
# image of a point source inside the telescope. Runs as a script (`python artificial_source.py [PICTURE.png]`) or
# cell by cell in an editor that knows `# %%`. Needs matplotlib.

# %%
import re
import sys

import cophase
import matplotlib.pyplot as plt
import numpy as np

# %% [markdown]
# ## The model
#
# The preset describes telescope, camera and modes. Here the camera has the sampling that the estimator works at, so that
# the model's own PSF is an image of it.

# %%
scene = cophase.preset("keck-artificial")
for key, value in {"samples_per_lambda_over_d": 2, "pixels": 128}.items():
    scene = re.sub(rf"^{key} .*$", f"{key} = {value}", scene, flags=re.MULTILINE)
model = cophase.Model(scene)
print(model)

# %% [markdown]
# ## An image
#
# 64 nm RMS of piston errors and 73 nm RMS of NCPA in the Zernike modes 4 (focus) to 18; photon and read noise at a peak
# signal-to-noise ratio of 500. The frame comes from the model that will fit it, so the error of the estimate is noise.

# %%
random = np.random.default_rng(1)
segments, ncpa = np.s_[: model.segment_modes], np.s_[model.segment_modes :]
zernikes = [model.mode_names.index(f"noll-{noll}") for noll in range(4, 19)]
truth_nm = np.zeros(model.modes)
truth_nm[segments] = 64 * random.standard_normal(model.segment_modes)
truth_nm[zernikes] = random.standard_normal(len(zernikes))
truth_nm[zernikes] *= 73 / np.linalg.norm(truth_nm[zernikes])

psf = model.psf(truth_nm)
rows, cols = model.frame_shape
window = tuple(slice(size // 2 - model.pixels // 2, size // 2 + model.pixels // 2) for size in (rows, cols))
read_noise_e = 60.0
frame_e = np.zeros((rows, cols))
frame_e[window] = psf * 500**2 / psf.max()
frame_e = random.poisson(frame_e) + read_noise_e * random.standard_normal(frame_e.shape)

# %% [markdown]
# ## The estimate
#
# A session fits single images with a given model. `cophase.Estimator(scene).estimate(frames)` is the full pipeline, which
# also selects the model and rejects outliers.

# %%
session = cophase.Session(model, threads=-1)
fit = session.fit(frame_e, read_noise_e=read_noise_e)
covariance_nm2 = session.refine().covariance_nm2
report = fit.reports
print(
    f"{fit.status}: reduced chi squared {report.reduced_chi2:.3f}, {report.evaluations} evaluations, {report.seconds:.2f} s"
)

# %% [markdown]
# Maps follow from coefficients, and so do their error bars: the wavefront of each mode, weighed with the covariance.
# An image does not depend on piston, nor on how tilt is divided between segments and NCPA: both are removed from the maps.

# %%
unit_nm = np.stack([model.wavefront_nm(mode) for mode in np.eye(model.modes)])
inside = ~np.isnan(unit_nm[0, 0])
y, x = np.nonzero(inside)
tilts = np.linalg.qr(np.stack([np.ones_like(x), x, y], axis=1).astype(float))[0]


def flat(values):
    """Samples inside the pupil without piston and tilt."""
    return values - (values @ tilts) @ tilts.T


basis_nm = flat(unit_nm[..., inside].astype(float))  # (modes, 2, samples)
estimate_nm, true_nm = (np.tensordot(c, basis_nm, 1) for c in (fit.coefficients_nm, truth_nm))
spread = np.linalg.cholesky(covariance_nm2 + 1e-12 * np.eye(model.modes) * np.trace(covariance_nm2))
sigma_nm = np.sqrt((np.tensordot(spread.T, basis_nm, 1) ** 2).sum(axis=0))


def rms(values):
    return np.sqrt((values**2).mean(axis=-1))


for name, *maps in zip(("phasing", "NCPA"), true_nm, estimate_nm - true_nm, sigma_nm):
    true, residual, sigma = map(rms, maps)
    print(f"{name:8} {true:6.2f} nm RMS, residual {residual:.3f}, one sigma {sigma:.3f}")

# %% [markdown]
# ## The picture

# %%
figure, axes = plt.subplots(3, 4, figsize=(15, 11), layout="constrained")


def show(axis, values, title, unit="nm", **colours):
    image = axis.imshow(values, origin="lower", **colours)
    axis.set_title(title, loc="left", fontsize=10)
    axis.set_xticks([])
    axis.set_yticks([])
    figure.colorbar(image, ax=axis, shrink=0.85, label=unit)


for row, name, true, estimate, sigma in zip(axes, ("Phasing", "NCPA"), true_nm, estimate_nm, sigma_nm):
    panels = {"truth": true, "estimate": estimate, "residual": estimate - true, "one sigma": sigma}
    for axis, (title, values) in zip(row, panels.items()):
        map_nm = np.full(inside.shape, np.nan)
        map_nm[inside] = values
        largest = np.abs(true if title in ("truth", "estimate") else values).max()
        colours = {"vmin": 0, "cmap": "viridis"} if title == "one sigma" else {"vmin": -largest, "cmap": "RdBu_r"}
        show(axis, map_nm, f"{name} {title}, {rms(values):.3g} nm RMS", vmax=largest, **colours)

show(axes[2, 0], np.sqrt(frame_e.clip(0)), "Image", "$\\sqrt{e}$", cmap="inferno")
flux_e, background_e = float(report.flux_e), float(report.background_e)
expected_e = np.full(frame_e.shape, np.nan)
expected_e[window] = flux_e * model.psf(fit.coefficients_nm) + background_e
noise_e = np.sqrt(expected_e.clip(0) + read_noise_e**2)
show(axes[2, 1], (frame_e - expected_e) / noise_e, "Image - model", "$\\sigma$", vmin=-4, vmax=4, cmap="RdBu_r")
errors = {"Segments": segments, "NCPA modes": ncpa}
for axis, (title, modes) in zip(axes[2, 2:], errors.items()):
    off_nm = (fit.coefficients_nm - truth_nm)[modes]
    if title == "Segments":
        off_nm -= off_nm.mean()  # the piston of all
    bars_nm = np.sqrt(np.diag(covariance_nm2))[modes]
    axis.errorbar(np.arange(off_nm.size), off_nm, bars_nm, fmt="o", markersize=3, linewidth=1, color="#1f3b63")
    axis.axhline(0, linewidth=0.8, color="gray")
    axis.set_title(f"{title}: estimate - truth with one sigma", loc="left", fontsize=10)
    axis.set_xlabel("mode")
    axis.set_ylabel("nm")

picture = sys.argv[1] if sys.argv[1:] else "artificial_source.png"
figure.savefig(picture, dpi=110)
print(f"{picture} has the maps")
