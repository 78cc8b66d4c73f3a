"""
An error budget
===============

*Where do the error bars come from, and how do I reach a given error?*

An estimate lists the terms of its error bars: noise, and an error
of the defocus if the scene states one. With a budget in the scene the planner chooses the cheapest model whose error stays
within it.
"""

# %%
# Seven segments and fourteen Zernike modes, so that each step takes a second or two:

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
"""
model = cophase.Model(scene)
random = np.random.default_rng(2)
truth_nm = 15 * random.standard_normal(model.modes)
truth_nm[: model.segment_modes] *= 4


def image(peak_snr):
    """An image whose brightest pixel has this signal-to-noise ratio."""
    psf = model.psf(truth_nm)
    frame_e = np.zeros(model.frame_shape)
    edge = (model.frame_shape[0] - model.pixels) // 2
    frame_e[edge : edge + model.pixels, edge : edge + model.pixels] = psf * peak_snr**2 / psf.max()
    return random.poisson(frame_e) + 20 * random.standard_normal(frame_e.shape)


# %%
# Noise
# -----
#
# With noise alone the error bars are the Cramér-Rao bound of the image. While the photons of the star dominate they fall as the
# inverse of the signal-to-noise ratio; the read noise of 20 electrons makes faint images worse.

ratios = np.array([30, 100, 300, 1000])
sigmas_nm = []
for ratio in ratios:
    info = cophase.Estimator(scene).estimate(image(ratio)).info
    sigmas_nm.append((info.phasing_sigma_nm, info.ncpa_sigma_nm))
sigmas_nm = np.array(sigmas_nm)

figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
axis.loglog(ratios, sigmas_nm, "o-", label=["phasing", "NCPA"])
axis.loglog(ratios, sigmas_nm[-1, 0] * ratios[-1] / ratios, color="grey", linestyle=":", label="1 / SNR")
axis.set_xlabel("peak signal-to-noise ratio")
axis.set_ylabel("error bar [nm RMS over the pupil]")
axis.legend()
plt.show()

# %%
# An error of the defocus
# -----------------------
#
# One defocused image does not show by how much it is defocused: an error of the defocus is an error of the NCPA's focus.
# ``tolerance.defocus_fraction`` states how well the defocus is known, and puts that into the error bars.

errors = [0.0, 0.001, 0.01]
budgets = [
    cophase.Estimator(cophase.scene_set(scene, tolerance__defocus_fraction=error)).estimate(image(300)).error_budget
    for error in errors
]
for error, budget in zip(errors, budgets):
    for name, phasing_nm, ncpa_nm in budget:
        print(f"defocus known to {error:6.1%}: {name:10} phasing {phasing_nm:6.3f} nm, NCPA {ncpa_nm:7.3f} nm")

figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
names = ["noise", "diversity"]
terms = {name: [next((term[2] for term in budget if term[0] == name), 0.0) for budget in budgets] for name in names}
for offset, (name, values_nm) in zip((-0.2, 0.2), terms.items()):
    axis.bar(np.arange(len(errors)) + offset, values_nm, 0.4, label=name)
axis.set_yscale("log")
axis.set_xticks(range(len(errors)), [f"{error:.1%}" for error in errors])
axis.set_xlabel("error of the defocus")
axis.set_ylabel("contribution to the NCPA [nm RMS]")
axis.legend()
plt.show()

# %%
# Two images on both sides of the focus measure the defocus: see :doc:`03_pair`.
#
# The cheapest model within a budget
# ----------------------------------
#
# ``estimate.budget_nm`` is the error that is allowed to phasing and NCPA, noise included. The planner simulates images, tries
# candidates, and keeps the cheapest: fewer samples of the pupil, fewer pixels, single precision.

frame_e = image(300)
planned = cophase.Estimator(cophase.scene_set(scene, estimate__budget_nm=3)).estimate(frame_e)
full = cophase.Estimator(scene).estimate(frame_e)
before = set(scene.splitlines())
print("keys that the plan sets:", [line for line in planned.scene.splitlines() if "=" in line and line not in before])
for name, estimate in (("full", full), ("planned", planned)):
    error_nm = estimate.coefficients_nm - truth_nm
    error_nm[: model.segment_modes] -= error_nm[: model.segment_modes].mean()
    print(f"{name:8} error {np.linalg.norm(error_nm):.2f} nm, NCPA error bar {estimate.info.ncpa_sigma_nm:.2f} nm")
    assert np.linalg.norm(error_nm) < 3
