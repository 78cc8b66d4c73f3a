"""Pictures of residuals for the page on troubleshooting: one planted cause each, read by a scene that lacks it."""

import cophase
import matplotlib.pyplot as plt
import numpy as np

from common import READ_NOISE_E, aberrations_nm, exposure_e, panel, save, scene

#: Keys of the images that the reader's scene does not have.
CAUSES = {
    "nothing": {},
    "plate scale 0.5 % off": {"image__samples_per_lambda_over_d": 2.01},
    "pupil turned by 0.5°": {"pupil__rotation_deg": 0.5},
    "square pixels as points": {"image__pixel_fill": 1},
    "bandwidth of 4 %": {"image__bandwidth_fraction": 0.04},
    "obscuration of 2.6 m": {"pupil__central_obscuration_m": 2.6},
    "companion of 1 %": {},
    "saturated at 70 %": {},
    "counts for electrons": {},
}


def frame_of(cause, settings, truth_nm):
    """The frame of a cause, electrons."""
    model = cophase.Model(scene(modes__exact_zernikes=[2, 21], **settings))
    psf = model.psf(truth_nm)
    if cause.startswith("companion"):
        psf = 0.99 * psf + 0.01 * np.roll(psf, (14, 9), axis=(0, 1))
    frame_e = exposure_e(psf)
    if cause.startswith("saturated"):
        frame_e = np.minimum(frame_e, 0.7 * frame_e.max())
    if cause.startswith("counts"):
        frame_e = frame_e / 4
    return frame_e


def main():
    reader = cophase.Model(scene(modes__exact_zernikes=[2, 21]))
    session = cophase.Session(reader, threads=-1)
    truth_nm = aberrations_nm(reader)
    figure, axes = plt.subplots(3, 3, figsize=(7, 6.4), layout="constrained")
    for axis, (cause, settings) in zip(axes.flat, CAUSES.items()):
        frame_e = frame_of(cause, settings, truth_nm)
        fit = session.fit(frame_e, read_noise_e=READ_NOISE_E)
        report = fit.reports
        expected_e = float(report.flux_e) * reader.psf(fit.coefficients_nm) + float(report.background_e)
        residual = (frame_e - expected_e) / np.sqrt(expected_e.clip(0) + READ_NOISE_E**2)
        chi2 = float(report.reduced_chi2)
        title = f"{cause}: χ² {chi2:.2f}" if chi2 < 10 else f"{cause}: χ² {chi2:.0f}"
        panel(axis, residual, title, limit=6, label="σ")
        print(f"{cause}: reduced chi squared {chi2:.3g}, {fit.status}")
    save(figure, "residuals.png", colours=48)


if __name__ == "__main__":
    main()
