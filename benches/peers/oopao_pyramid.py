#!/usr/bin/env python3
"""Slopes and frames a second of the pyramid sensor of OOPAO and of ours, behind the same pupil, modulation and wavefront.

    COPHASE_LIBRARY=target/release/libcophase.so PYTHONPATH=bindings/python \\
        python3 benches/peers/oopao_pyramid.py --program target/release/cophase

needs oopao 1.0.0, astropy and cffi. Both have 20 pixels across a round pupil of 120 samples, a modulation of 3 lambda/D on as many points, and no
noise; the wavefront is one of our turbulence. A slope of both is an angle: the tilt of the wavefront that has the signal on the mean. OOPAO's
images of the pupil are as far from each other as --separations says, in pixels, and its focal field is sampled the more finely the farther; ours
are infinitely far. Frames a second are those of the sensor alone.
"""

import argparse
import contextlib
import io
import re
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from astropy.io import fits

import cophase

with contextlib.redirect_stdout(io.StringIO()):
    from OOPAO.Pyramid import Pyramid
    from OOPAO.Source import Source
    from OOPAO.Telescope import Telescope

WIDTH_M, PIXELS, SAMPLES = 8.0, 20, 6
MAS = np.pi / 180 / 3600 / 1000
SCENE = """
[pupil]
file = "pupil.fits"
grid_m = {width}
samples = {across}
[image]
wavelength_nm = 2200.0
samples_per_lambda_over_d = 2
pixels = 64
count = 2
interval_s = 0.5
flux_e = 1e6
[modes]
segment = "none"
ncpa = "zernike"
ncpa_count = 20
[turbulence]
r0_m = {r0_m}
outer_scale_m = 30.0
fractions = [1.0]
heights_m = [0.0]
wind_m_s = [10.0]
wind_dir_rad = [0.5]
[wavefront_sensor]
kind = "pyramid"
pixels_across = {pixels}
samples_per_pixel = {samples}
modulation_lambda_over_d = {radius}
modulation_points = {points}
wavelength_nm = {wavelength_nm}
photon_noise = false
[mirror]
actuators_across = 21
pitch_m = 0.4
[control]
filtered_modes = 10
"""


def ours(folder, program, settings):
    """Wavefront of the first frame, nm, its slopes, and the sensor's frames a second."""
    scene = SCENE.format(width=WIDTH_M, across=PIXELS * SAMPLES, pixels=PIXELS, samples=SAMPLES, **settings)
    simulator = cophase.Simulator(scene, folder)
    simulator.step()
    # A run long enough for its mean to be steady beside other work.
    (Path(folder) / "scene.toml").write_text(scene)
    command = [program, "simulate", str(Path(folder) / "scene.toml"), "-o", str(Path(folder) / "run.fits"), "-v"]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    sensor_us = float(re.search(r"^sensor\s+([\d.]+)", run.stdout + run.stderr, re.M).group(1))
    return np.array(simulator.residual_nm), np.array(simulator.slopes_mas), 1e6 / sensor_us


class Theirs:
    """OOPAO's pyramid with its images of the pupil `separation` pixels from each other."""

    def __init__(self, pupil, valid, settings, separation):
        with contextlib.redirect_stdout(io.StringIO()):
            tel = Telescope(PIXELS * SAMPLES, WIDTH_M, samplingTime=1e-3, pupil=pupil)
            guide = Source("H", 4.0)
            guide**tel
            guide * tel
            points = {"nTheta_user_defined": settings["points"], "delta_theta": np.pi / settings["points"]}
            self.sensor = Pyramid(PIXELS, tel, settings["radius"], 0.5, n_pix_separation=separation, postProcessing="slopesMaps",
                                  userValidSignal=valid, **points)
        self.phase_per_nm = 2e-9 * np.pi / settings["wavelength_nm"] / 1e-9
        self.pupil, self.valid = pupil, valid
        x = (np.arange(PIXELS * SAMPLES) - (PIXELS * SAMPLES - 1) / 2) * WIDTH_M / (PIXELS * SAMPLES)
        light = pupil.reshape(PIXELS, SAMPLES, PIXELS, SAMPLES).mean((1, 3))[valid]
        # 1 mas, as ours.
        along_x, _ = self.raw(np.broadcast_to(x * MAS * 1e9, pupil.shape))
        self.unit = 1.0 / np.average(along_x, weights=light)

    def raw(self, opd_nm):
        """Slopes along x and y in OOPAO's unit."""
        self.sensor.wfs_measure(phase_in=opd_nm * self.pupil * self.phase_per_nm)
        maps = np.array(self.sensor.signal_2D)
        return maps[:PIXELS][self.valid], maps[PIXELS:][self.valid]

    def slopes_mas(self, opd_nm):
        return np.concatenate(self.raw(opd_nm)) * self.unit

    def frames_per_s(self, opd_nm, frames):
        phase = opd_nm * self.pupil * self.phase_per_nm
        self.sensor.wfs_measure(phase_in=phase)
        started = time.perf_counter()
        for _ in range(frames):
            self.sensor.wfs_measure(phase_in=phase)
        return frames / (time.perf_counter() - started)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--program", required=True)
    arguments.add_argument("--frames", type=int, default=20, help="frames of OOPAO")
    arguments.add_argument("--radius", type=float, default=3.0, help="modulation, lambda/D")
    arguments.add_argument("--points", type=int, default=20, help="points of the modulation; OOPAO's own number for 3 lambda/D is 20")
    arguments.add_argument("--r0-m", type=float, default=4.0, help="of the turbulence: the wavefront's size")
    arguments.add_argument("--separations", type=int, nargs="+", default=[2, 10, 40])
    chosen = arguments.parse_args()
    across = PIXELS * SAMPLES
    x = (np.arange(across) - (across - 1) / 2) * WIDTH_M / across
    pupil = (np.hypot(*np.meshgrid(x, x)) < WIDTH_M / 2).astype(float)
    valid = pupil.reshape(PIXELS, SAMPLES, PIXELS, SAMPLES).mean((1, 3)) >= 0.5
    settings = {"radius": chosen.radius, "points": chosen.points, "wavelength_nm": 1654.0, "r0_m": chosen.r0_m}
    with tempfile.TemporaryDirectory() as folder:
        fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(pupil, name="PUPIL")]).writeto(Path(folder) / "pupil.fits")
        opd_nm, slopes, rate = ours(folder, chosen.program, settings)
    opd_nm = np.where(pupil > 0, np.nan_to_num(opd_nm), 0.0)
    print(f"cophase: {rate:.0f} frames/s of the sensor, wavefront {opd_nm[pupil > 0].std():.0f} nm RMS")
    for separation in chosen.separations:
        peer = Theirs(pupil, valid, settings, separation)
        found = peer.slopes_mas(opd_nm)
        off, size = np.sqrt(np.mean((found - slopes) ** 2)), np.sqrt(np.mean(slopes**2))
        frames = peer.frames_per_s(opd_nm, chosen.frames)
        print(f"OOPAO, images {separation} pixels apart: slopes differ by {100 * off / size:.2f} % of their RMS, {frames:.1f} frames/s: {rate / frames:.0f} times")


if __name__ == "__main__":
    main()
