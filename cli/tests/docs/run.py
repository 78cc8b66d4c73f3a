"""Runs blocks of a page one after the other: python3 run.py FILE...; see interpreters.rs.

Presets are small scenes of the same kind. Setups have `exposures` and `image_e` for frames.
"""

import sys
from pathlib import Path

import cophase
import numpy as np

HERE = Path(__file__).parent
SMALL = {path.stem: path.read_text() for path in (HERE / "presets").glob("*.toml")}
SMALL["keck-onsky"] = (HERE.parents[2] / "tests/c_api/sky.toml").read_text() + '\n[estimate]\nmethod = "full-phase"\n'


def image_e(model, seed=1):
    """An image of a star with two segments out of phase: photon and read noise."""
    random = np.random.default_rng(seed)
    truth_nm = np.zeros(model.modes)
    truth_nm[2], truth_nm[20] = 60, -60
    return random.poisson(1e7 * model.psf(truth_nm)) + random.normal(0, 60, (model.pixels, model.pixels))


def exposures(scene):
    """Four exposures behind adaptive optics, and the slopes of each."""
    simulator = cophase.Simulator(scene)
    frames, slopes_mas = [], []
    for image in range(4):
        simulator.step(60 if image else 300)
        frames.append(simulator.image_e)
        slopes_mas.append(simulator.slopes_mas)
    return np.stack(frames), np.stack(slopes_mas)


def main(files):
    cophase.preset = SMALL.__getitem__
    names = {"__name__": "page", "cophase": cophase, "np": np, "image_e": image_e, "exposures": exposures}
    for file in files:
        print(f"-- {Path(file).name}", file=sys.stderr)  # the last line before a traceback
        exec(compile(Path(file).read_text(), file, "exec"), names)


main(sys.argv[1:])
