#!/usr/bin/env python3
"""Images of a JWST-like telescope by HCIPy, read by `cophase estimate jwst-pair`: residuals against error bars and seconds.

    python3 benches/peers/jwst_hcipy.py --program target/release/cophase --draws 5

needs hcipy 0.7.1 and astropy. HCIPy makes pupil (its own hexagons and struts, supersampled), wavefront and propagation; from the
preset come the numbers of the telescope only. Noise is drawn by NumPy.
"""

import argparse
import json
import math
import subprocess
import tempfile
import time
import tomllib
from pathlib import Path

import hcipy
import numpy as np
from astropy.io import fits


def telescope(scene, samples, oversampling):
    """Transmission and owner of each sample, and the centres of the segments."""
    pupil = scene["pupil"]
    width, side, gap = pupil["grid_m"], pupil["segment_side_m"], pupil["segment_gap_m"]
    grid = hcipy.make_pupil_grid(samples, width)
    pitch = math.sqrt(3) * side + gap
    centres = hcipy.make_hexagonal_grid(pitch, pupil["rings"])
    inside = np.hypot(centres.x, centres.y) > pitch / 2
    xs, ys = centres.x[inside], centres.y[inside]
    shape = hcipy.make_hexagonal_aperture(2 * side, angle=math.pi / 2)
    transmission, owner = hcipy.Field(np.zeros(grid.size), grid), np.full(grid.size, -1)
    for segment, (x, y) in enumerate(zip(xs, ys)):
        near = np.hypot(grid.x - x, grid.y - y) < 1.1 * side
        patch = hcipy.evaluate_supersampled(hcipy.make_shifted_aperture(shape, (x, y)), grid, oversampling)
        transmission += patch
        owner[near & (patch > 0)] = segment
    for angle in pupil["spider_vanes_deg"]:
        end = width * np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
        vane = hcipy.make_spider((0, 0), end, pupil["spider_width_m"])
        transmission *= hcipy.evaluate_supersampled(lambda points, vane=vane: vane(points).astype(float), grid, oversampling)
    return grid, transmission, owner, np.stack([xs, ys])


def rms(values, weight):
    """Weighted RMS about the mean."""
    share = weight / weight.sum()
    return math.sqrt(np.sum(share * values**2) - np.sum(share * values) ** 2)


def draw(scene, seed, grid, weight, owner, centres, zernikes):
    """Segment errors as planes (nm, nm/m, nm/m), and NCPA, nm."""
    rng, aberrations = np.random.default_rng(seed), scene["aberrations"]
    # A hexagon's RMS along x is sqrt(5/24) of its side; tip and tilt together have the stated RMS.
    unit_m = math.sqrt(5 / 24 * 2) * scene["pupil"]["segment_side_m"]
    piston = rng.normal(size=centres.shape[1]) * aberrations["segment_piston_rms_nm"]
    slopes = rng.normal(size=centres.shape) * aberrations["segment_tip_tilt_rms_nm"] / unit_m
    orders = [hcipy.noll_to_zernike(noll)[0] for noll in range(4, len(zernikes) + 1)]
    ncpa = sum(rng.normal() / order * mode for order, mode in zip(orders, zernikes[3:]))
    return piston, slopes, ncpa * aberrations["ncpa_rms_nm"] / rms(ncpa, weight)


def segment_errors(piston, slopes, centres, owner, x, y):
    """Segment errors at points of known owners, nm."""
    return piston[owner] + slopes[0, owner] * (x - centres[0, owner]) + slopes[1, owner] * (y - centres[1, owner])


def estimate(program, images, folder):
    """Report, maps and seconds of the program's estimate from the images of the channels."""
    command = [program, "estimate", "--scene", "jwst-pair", "-o", str(folder / "est.fits"), "--json"]
    for name, pixels in images.items():
        path = folder / f"{name}.fits"
        fits.PrimaryHDU(pixels).writeto(path)
        fits.setval(path, "BUNIT", value="electron")
        command += ["--channel", f"{name}={path}"]
    started = time.perf_counter()
    report = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    seconds = time.perf_counter() - started
    with fits.open(folder / "est.fits") as found:
        return report, {name: found[name].data for name in ("PHASING", "NCPA")}, seconds


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--program", required=True)
    arguments.add_argument("--draws", type=int, default=5)
    arguments.add_argument("--peak-snr", type=float, default=200.0)
    arguments.add_argument("--samples", type=int, default=1024)
    chosen = arguments.parse_args()
    text = subprocess.run([chosen.program, "scene", "jwst-pair"], check=True, capture_output=True, text=True).stdout
    scene = tomllib.loads(text)
    image, width = scene["image"], scene["pupil"]["grid_m"]
    nm, count = image["wavelength_nm"], image["pixels"]
    grid, transmission, owner, centres = telescope(scene, chosen.samples, 8)
    weight, lit = np.asarray(transmission), transmission > 0
    pixel = nm * 1e-9 / width / image["samples_per_lambda_over_d"]
    corner = np.full(2, -(count // 2) * pixel)
    focal = hcipy.CartesianGrid(hcipy.RegularCoords([pixel, pixel], [count, count], corner))
    propagator = hcipy.FraunhoferPropagator(grid, focal)
    diameter = 2 * np.hypot(grid.x[lit], grid.y[lit]).max()
    zernikes = [np.asarray(hcipy.zernike(*hcipy.noll_to_zernike(noll), D=diameter, grid=grid)) for noll in range(1, 37)]
    # The scene's defocus has unit RMS over the pupil.
    focus = zernikes[3] / rms(zernikes[3], weight)
    pulls = {"PHASING": [], "NCPA": []}
    for seed in range(1, chosen.draws + 1):
        piston, slopes, ncpa = draw(scene, seed, grid, weight, owner, centres, zernikes)
        phasing = np.zeros(grid.size)
        phasing[lit] = segment_errors(piston, slopes, centres, owner[lit], grid.x[lit], grid.y[lit])
        images, rng = {}, np.random.default_rng(1000 + seed)
        for channel in image["channel"]:
            turns = (phasing + ncpa) / nm + channel["diversity_focus_waves_rms"] * focus
            wavefront = hcipy.Wavefront(hcipy.Field(weight * np.exp(2j * np.pi * turns), grid), nm * 1e-9)
            psf = np.asarray(propagator(wavefront).power.shaped)
            noise_e = image["read_noise_e"]
            # Signal of the brightest pixel: s / sqrt(s + noise^2) is the ratio.
            signal = chosen.peak_snr**2 * (0.5 + math.sqrt(0.25 + (noise_e / chosen.peak_snr) ** 2))
            images[channel["name"]] = rng.poisson(psf / psf.max() * signal) + rng.normal(size=psf.shape) * noise_e
        with tempfile.TemporaryDirectory() as folder:
            report, maps, seconds = estimate(chosen.program, images, Path(folder))
        samples = len(maps["NCPA"])
        x, y = np.meshgrid(*2 * [(np.arange(samples) - (samples - 1) / 2) * width / samples])
        row, column = (np.round((at / width + 0.5) * chosen.samples - 0.5).astype(int) for at in (y, x))
        place = row * chosen.samples + column
        # Samples at an edge may belong to no segment here, or to another.
        sure = np.isfinite(maps["NCPA"]) & (weight[place] == 1)
        own, x, y = owner[place][sure], x[sure], y[sure]
        truth = {"PHASING": segment_errors(piston, slopes, centres, own, x, y), "NCPA": ncpa[place][sure]}
        plane = np.stack([np.ones_like(x), x, y], axis=1)
        line = f"draw {seed}:"
        for name, found in maps.items():
            off = found[sure] - truth[name]
            off -= plane @ np.linalg.lstsq(plane, off, rcond=None)[0]
            sigma = report[f"{name.lower()}_sigma_nm"]
            pulls[name].append(off.std() / sigma)
            line += f" {name} {off.std():.3f} nm (error bar {sigma:.3f}),"
        print(line, f"chi2 {report['reduced_chi2']:.3f}, {seconds:.1f} s", *report["warnings"], flush=True)
    for name, values in pulls.items():
        print(f"{name}: residual over error bar {math.sqrt(np.mean(np.square(values))):.2f}")


if __name__ == "__main__":
    main()
