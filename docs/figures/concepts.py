"""Pictures of the page on concepts: why a defocus is needed, segments against NCPA, what the loop hides, error bars."""

import re

import cophase
import matplotlib.pyplot as plt
import numpy as np

from common import READ_NOISE_E, aberrations_nm, exposure_e, image_panel, panel, save, scene


def diversity():
    """A wavefront and its even part's opposite have one image in focus and two behind a defocus."""
    focused = cophase.Model(scene(image__diversity_focus_waves_rms=0, modes__ncpa="zernike", modes__ncpa_count=20))
    defocused = cophase.Model(scene(modes__ncpa="zernike", modes__ncpa_count=20))
    one_nm = np.zeros(focused.modes)
    one_nm[focused.mode_names.index("noll-6")] = 120  # astigmatism: even
    one_nm[focused.mode_names.index("noll-7")] = 80  # coma: odd
    other_nm = one_nm.copy()
    other_nm[focused.mode_names.index("noll-6")] = -120  # W(x) -> -W(-x)
    figure, axes = plt.subplots(2, 3, figsize=(9, 5.4), layout="constrained")
    for row, name, coefficients_nm in zip(axes, ("W(x)", "−W(−x)"), (one_nm, other_nm)):
        panel(row[0], focused.wavefront_nm(coefficients_nm).sum(axis=0), f"wavefront {name}", limit=450)
        middle = np.s_[40:88, 40:88]
        image_panel(row[1], focused.psf(coefficients_nm)[middle], "image in focus: the same")
        image_panel(row[2], defocused.psf(coefficients_nm), "behind 1.5 waves of defocus: different")
    difference = focused.psf(one_nm) - focused.psf(other_nm)
    print(f"largest difference in focus over the peak: {np.abs(difference).max() / focused.psf(one_nm).max():.1e}")
    save(figure, "concepts-diversity.png")


def segments_and_ncpa():
    """What pistons and NCPA of the same size do to the image."""
    model = cophase.Model(scene())
    both_nm = aberrations_nm(model, 40, 40)
    pistons_nm, ncpa_nm = both_nm.copy(), both_nm.copy()
    pistons_nm[model.segment_modes :] = 0
    ncpa_nm[: model.segment_modes] = 0
    flat = model.psf(np.zeros(model.modes))
    figure, axes = plt.subplots(2, 3, figsize=(9, 5.4), layout="constrained")
    for row, name, coefficients_nm, part in zip(axes, ("segments", "NCPA"), (pistons_nm, ncpa_nm), (0, 1)):
        panel(row[0], model.wavefront_nm(coefficients_nm)[part], f"{name}, 40 nm RMS", limit=110)
        image_panel(row[1], model.psf(coefficients_nm), "image behind 1.5 waves of defocus")
        change = (model.psf(coefficients_nm) - flat) / np.sqrt(flat + 1e-3 * flat.max())
        panel(row[2], change / np.abs(change).max(), "change of the image over its noise", limit=0.6, label="relative")
    save(figure, "concepts-segments-ncpa.png")


def loop():
    """Pistons in front of a closed loop without turbulence: what the mirror takes out, and what is left for the camera."""
    # The four lists of the layers are removed together: one that lacks another is refused.
    text = re.sub(r"^(fractions|heights_m|wind_m_s|wind_dir_rad) .*\n", "", cophase.preset("keck-onsky"), flags=re.MULTILINE)
    text = cophase.scene_set(text, wavefront_sensor__photon_noise=False, wavefront_sensor__read_noise_e=0)
    simulator = cophase.Simulator(text)
    simulator.step(3000)
    residual_nm, pistons_nm = simulator.residual_nm, simulator.phasing_nm
    samples = pistons_nm.shape[0]
    block = residual_nm.shape[0] // samples
    residual_nm = residual_nm.reshape(samples, block, samples, block).mean(axis=(1, 3))
    inside = np.isfinite(pistons_nm) & np.isfinite(residual_nm)
    residual_nm = np.where(inside, residual_nm - residual_nm[inside].mean(), np.nan)
    mirror_nm = pistons_nm - residual_nm
    figure, axes = plt.subplots(1, 3, figsize=(9, 3), layout="constrained")
    for axis, values, title in zip(axes, (pistons_nm, mirror_nm, residual_nm), ("segments", "on the mirror", "left for the camera")):
        rms_nm = np.nanstd(np.where(inside, values, np.nan))
        panel(axis, np.where(inside, values, np.nan), f"{title}, {rms_nm:.0f} nm RMS", limit=180)
    save(figure, "concepts-loop.png")


def error_bars():
    """Residual of each piston with its error bar, and the error bars of fainter stars."""
    model = cophase.Model(scene(modes__exact_zernikes=[2, 21]))
    session = cophase.Session(model, threads=-1)
    truth_nm = aberrations_nm(model)
    segments = np.s_[: model.segment_modes]
    psf = model.psf(truth_nm)
    electrons, sigma_nm = np.array([1e6, 3e6, 1e7, 3e7, 1e8, 3e8, 1e9]), []
    for flux_e in electrons:
        fit = session.fit(exposure_e(psf, flux_e), read_noise_e=READ_NOISE_E)
        bars_nm = session.refine().sigma_nm[segments]
        sigma_nm.append(np.sqrt((bars_nm**2).mean()))
        if flux_e == 3e7:
            off_nm = (fit.coefficients_nm - truth_nm)[segments]
            shown = off_nm - off_nm.mean(), bars_nm
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained", width_ratios=[3, 2])
    left.errorbar(np.arange(model.segment_modes), *shown, fmt="o", markersize=3, linewidth=1, color="#1f3b63")
    left.axhline(0, linewidth=0.8, color="gray")
    left.set_title("Pistons from one image of 3·10⁷ electrons: estimate − truth", loc="left", fontsize=9)
    left.set_xlabel("segment")
    left.set_ylabel("nm")
    right.loglog(electrons, sigma_nm, "o-", markersize=4, color="#1f3b63")
    right.set_title("Error bar of a piston", loc="left", fontsize=9)
    right.set_xlabel("electrons of the star")
    right.set_ylabel("nm")
    right.grid(alpha=0.3)
    print("error bars:", ", ".join(f"{flux_e:.0e}: {nm:.2f} nm" for flux_e, nm in zip(electrons, sigma_nm)))
    save(figure, "concepts-error-bars.png")


if __name__ == "__main__":
    diversity()
    segments_and_ncpa()
    loop()
    error_bars()
