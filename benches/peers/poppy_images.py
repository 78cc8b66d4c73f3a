#!/usr/bin/env python3
"""Images of a Keck-like telescope by POPPY, read by `cophase estimate`: residuals against error bars.

    python3 benches/peers/poppy_images.py --program target/release/cophase --draws 5
    python3 benches/peers/poppy_images.py --program target/release/cophase --draws 5 --tilts

needs poppy 1.1.2 and 6 GB of memory. POPPY makes segments, NCPA, defocus, optics and pixels, and writes the maps that the estimate is compared with; the
scene has POPPY's own quantities. One image at a defocus of 6 waves peak to valley tells pistons; with --tilts the segments have tips and
tilts too, and there are images at both defocuses. Noise is drawn by NumPy.
"""

import argparse
import contextlib
import io
import math
import tempfile
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.io import fits
from program import report

with contextlib.redirect_stderr(io.StringIO()):
    import poppy

# POPPY's segments have hard edges on a grid of samples: multiples of one have their upper and lower edges between two samples.
SAMPLES, SAMPLE_M = 4096, 0.0027
RINGS, FLAT_M, GAP_M, GRID_M = 3, 576 * SAMPLE_M, 4 * SAMPLE_M, SAMPLES * SAMPLE_M
SIDE_M = FLAT_M / math.sqrt(3)
# The circle around the hexagons, over which POPPY's Zernikes and its lens are defined here.
RADIUS_M = math.hypot(SIDE_M / 2, RINGS * (FLAT_M + GAP_M) + FLAT_M / 2)
WAVELENGTH_M, PIXEL_ARCSEC, PIXELS, DEFOCUS_WAVES_PV, READ_NOISE_E = 2.1686e-6, 0.01, 256, 6.0, 20.0
PISTON_RMS_M, TILT_RMS_M, NCPA_RMS_M, NOLL = 60e-9, 30e-9, 60e-9, range(4, 19)

SCENE = f"""\
[pupil]
aperture = "hexagonal"
central_segment = false
rings = {RINGS}
segment_side_m = {SIDE_M}
segment_gap_m = {GAP_M}
grid_m = {GRID_M}

[image]
wavelength_nm = {WAVELENGTH_M * 1e9}
pixel_arcsec = {PIXEL_ARCSEC}
pixels = {PIXELS}
read_noise_e = {READ_NOISE_E}
flip_x = true
flip_y = true
diversity_focus_waves_pv = {DEFOCUS_WAVES_PV}
"""
CHANNELS = f"""
[[image.channel]]
name = "plus"

[[image.channel]]
name = "minus"
diversity_focus_waves_pv = {-DEFOCUS_WAVES_PV}
"""
MODES = """
[modes]
segment = "{segment}"
ncpa = "zernike"
ncpa_count = 40
"""


def aberrations(seed, tilts):
    """Segments and NCPA as optics of POPPY."""
    rng = np.random.default_rng(seed)
    segments = poppy.dms.HexSegmentedDeformableMirror(
        rings=RINGS, flattoflat=FLAT_M * u.m, gap=GAP_M * u.m, center=False)
    # A hexagon's RMS along an axis is sqrt(5/24) of its side; tip and tilt together have the stated RMS.
    slope = TILT_RMS_M / (math.sqrt(5 / 24 * 2) * SIDE_M) if tilts else 0.0
    for segment in segments.segmentlist:
        piston, tip, tilt = rng.normal(size=3) * [PISTON_RMS_M, slope, slope]
        segments.set_actuator(segment, piston * u.m, tip * u.rad, tilt * u.rad)
    orders = np.array([poppy.zernike.noll_indices(noll)[0] for noll in NOLL])
    terms = rng.normal(size=len(orders)) / orders
    terms *= NCPA_RMS_M / math.hypot(*terms)
    ncpa = poppy.ZernikeWFE(coefficients=[0.0] * 3 + list(terms), radius=RADIUS_M)
    return segments, ncpa


def image(segments, ncpa, waves, peak_snr, rng):
    """Image through a lens, electrons; without oversampling the pixels of POPPY are points, as those of the scene."""
    system = poppy.OpticalSystem(npix=SAMPLES, pupil_diameter=GRID_M * u.m, oversample=1)
    system.add_pupil(segments)
    system.add_pupil(ncpa)
    system.add_pupil(poppy.ThinLens(nwaves=waves, reference_wavelength=WAVELENGTH_M, radius=RADIUS_M * u.m))
    system.add_detector(pixelscale=PIXEL_ARCSEC, fov_pixels=PIXELS)
    psf = system.calc_psf(wavelength=WAVELENGTH_M)[0].data
    # Signal of the brightest pixel: s / sqrt(s + noise^2) is the ratio.
    signal = peak_snr**2 * (0.5 + math.sqrt(0.25 + (READ_NOISE_E / peak_snr) ** 2))
    return rng.poisson(psf / psf.max() * signal) + rng.normal(size=psf.shape) * READ_NOISE_E


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--program", required=True)
    arguments.add_argument("--draws", type=int, default=5)
    arguments.add_argument("--tilts", action="store_true")
    arguments.add_argument("--peak-snr", type=float, default=200.0)
    chosen = arguments.parse_args()
    defocuses = {"plus": DEFOCUS_WAVES_PV, "minus": -DEFOCUS_WAVES_PV} if chosen.tilts else {"plus": DEFOCUS_WAVES_PV}
    modes = MODES.format(segment="piston-tip-tilt" if chosen.tilts else "piston")
    ratios = {"phasing": [], "ncpa": []}
    for seed in range(1, chosen.draws + 1):
        segments, ncpa = aberrations(seed, chosen.tilts)
        rng = np.random.default_rng(1000 + seed)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "scene.toml").write_text(SCENE + (CHANNELS if chosen.tilts else "") + modes)
            estimate, images = [chosen.program, "estimate", "--scene", folder / "scene.toml", "-o", folder / "est.fits"], []
            for channel, waves in defocuses.items():
                path = folder / f"{channel}.fits"
                hdu = fits.PrimaryHDU(image(segments, ncpa, waves, chosen.peak_snr, rng))
                hdu.header["BUNIT"] = "electron"
                hdu.writeto(path)
                images += ["--channel", f"{channel}={path}"] if chosen.tilts else [path]
            found = report(estimate + images)
            truth = []
            whole = poppy.CompoundAnalyticOptic([segments, ncpa])
            for what, optic in {"phasing": segments, "ncpa": ncpa, "opd": whole}.items():
                truth.append(folder / f"{what}.fits")
                optic.to_fits(str(truth[-1]), what="opd", npix=SAMPLES, grid_size=GRID_M)
            compare = [chosen.program, "compare", folder / "est.fits"]
            apart = report(compare + ["--truth-phasing", truth[0], "--truth-ncpa", truth[1]])
            both = report(compare + ["--truth-opd", truth[2]])
        line = f"draw {seed}:"
        for what, values in ratios.items():
            residual, sigma = apart[f"{what}_residual_nm"], found[f"{what}_sigma_nm"]
            values.append(residual / sigma)
            line += f" {what} {residual:.3f} nm (error bar {sigma:.3f}),"
        print(line, f"OPD {both['wavefront_residual_nm']:.3f} nm, chi2 {found['reduced_chi2']:.3f}", *found["warnings"], flush=True)
    for what, values in ratios.items():
        print(f"{what}: residual over error bar {math.sqrt(np.mean(np.square(values))):.2f}, largest {max(values):.2f}")


if __name__ == "__main__":
    main()
