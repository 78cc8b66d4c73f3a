#!/usr/bin/env python3
"""Frames a second of a closed loop of OOPAO and of `cophase simulate`, at the size of a preset, one after the other.

    python3 benches/peers/oopao_frames.py --program target/release/cophase --preset tmt-onsky

needs oopao 1.0.0. Both have the preset's samples, lenslets, actuators and layers of turbulence, and no science image: OOPAO a round pupil and a
command matrix of random numbers, since only the time counts. OOPAO holds an influence map of 8 bytes a sample for each actuator, several times: 24 GB are too few
for tmt-onsky. With --mirror 20 its mirror has 20 intervals between actuators, and the ratio is a lower bound.
"""

import argparse
import contextlib
import io
import math
import re
import subprocess
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np

with contextlib.redirect_stdout(io.StringIO()):
    from OOPAO.Atmosphere import Atmosphere
    from OOPAO.DeformableMirror import DeformableMirror
    from OOPAO.ShackHartmann import ShackHartmann
    from OOPAO.Source import Source
    from OOPAO.Telescope import Telescope


def oopao_frames_per_s(scene, frames, intervals=None):
    """Frames a second, and the time before the first frame, s."""
    started = time.perf_counter()
    sensing, layers = scene["wavefront_sensor"], scene["turbulence"]
    lenslets, width_m, frame_s = sensing["lenslets_across"], scene["pupil"]["grid_m"], 1 / scene["control"]["frame_rate_hz"]
    guide = Source("R", 4.0)
    tel = Telescope(lenslets * sensing["samples_per_lenslet"], width_m, samplingTime=frame_s, centralObstruction=0.12)
    guide**tel
    atm = Atmosphere(tel, r0=layers["r0_m"], L0=layers["outer_scale_m"], fractionalR0=layers["fractions"], altitude=layers["heights_m"],
                     windSpeed=layers["wind_m_s"], windDirection=[math.degrees(angle) for angle in layers["wind_dir_rad"]])
    atm.initializeAtmosphere(tel)
    wfs = ShackHartmann(lenslets, tel, lightRatio=sensing["min_light_ratio"], threshold_cog=0.0)
    dm = DeformableMirror(tel, intervals or lenslets, mechCoupling=scene["mirror"]["coupling"], actuator_selection=0.2)
    # Small enough that the mirror stays flat.
    command = np.random.default_rng(1).normal(size=(dm.nValidAct, wfs.nSignal)) * 1e-15
    dm.coefs = np.zeros(dm.nValidAct)

    def frame():
        atm.update()
        guide**atm * tel * dm * wfs
        dm.coefs = dm.coefs - 0.3 * command @ wfs.signal

    frame()
    ready = time.perf_counter()
    for _ in range(frames):
        frame()
    return frames / (time.perf_counter() - ready), ready - started, dm.nValidAct, wfs.nSignal


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--program", required=True)
    arguments.add_argument("--preset", default="keck-onsky")
    arguments.add_argument("--frames", type=int, default=20, help="frames of OOPAO")
    arguments.add_argument("--mirror", type=int, metavar="N", help="intervals between actuators across OOPAO's mirror [default: those of the preset]")
    chosen = arguments.parse_args()
    text = subprocess.run([chosen.program, "scene", chosen.preset], capture_output=True, text=True, check=True).stdout
    scene = tomllib.loads(text)
    settings = ["image.count=2", "control.settle_s=1", "image.interval_s=0.5"]
    with tempfile.TemporaryDirectory() as folder:
        command = [chosen.program, "simulate", chosen.preset, "-o", str(Path(folder) / "images.fits"), "-v"]
        run = subprocess.run(command + [word for setting in settings for word in ("--set", setting)], capture_output=True, text=True, check=True)
    ours = float(re.search(r"\((\d+) frames/s", run.stdout + run.stderr).group(1))
    with contextlib.redirect_stdout(io.StringIO()):
        theirs, ready_s, actuators, slopes = oopao_frames_per_s(scene, chosen.frames, chosen.mirror)
    print(f"{chosen.preset}: cophase {ours:.0f} frames/s, OOPAO {theirs:.2f} ({actuators} actuators, {slopes} slopes, {ready_s:.0f} s to build): "
          f"{ours / theirs:.0f} times")


if __name__ == "__main__":
    main()
