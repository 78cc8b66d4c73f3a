"""The whole pipeline through the Python package on a file of raw doubles, printed as by pipeline.c, see there:

python3 pipeline.py SCENE.toml FRAMES.raw COUNT ROWS COLS [SLOPES.raw SLOPES] [CHANNEL,CHANNEL]
"""

import struct
import sys

import cophase
import numpy as np


def bits(value):
    return struct.pack(">d", value).hex()


def main(scene, frames, count, rows, cols, *others):
    names = others[-1].split(",") if len(others) % 2 else None
    slopes_mas = np.fromfile(others[0]).reshape(-1, int(count), int(others[1])) if len(others) > 1 else None
    with open(scene, encoding="utf-8") as file:
        estimator = cophase.Estimator(file.read())
    frames_e = np.fromfile(frames).reshape(-1, int(count), int(rows), int(cols))

    def given(each):
        return each if each is None else each[0] if names is None else dict(zip(names, each))

    estimate = estimator.estimate(given(frames_e), slopes_mas=given(slopes_mas))
    for name, nm, sigma_nm in zip(estimate.mode_names, estimate.coefficients_nm, estimate.sigma_nm):
        print("coefficient", name, bits(nm), bits(sigma_nm))
    for index, image in enumerate(estimate.images):
        print("image", index, image.status, bits(image.reduced_chi2), image.rejected_pixels, image.channel)
    for name in estimate.channels:
        print("channel", name)
    for integer, probability, runner_up_nm in estimate.integers:
        print("integer", int(integer), bits(probability), bits(runner_up_nm))
    for error in estimate.model_errors:
        print("error", error.name, *map(bits, error[1:]))
    without = estimate.without_staircases
    if without:
        for part in ("phasing", "ncpa", "wavefront"):
            print("without", part, *(bits(getattr(without.info, f"{part}_{what}_nm")) for what in ("rms", "sigma")))
        maps = (without.phasing_nm, without.ncpa_nm, without.phasing_sigma_nm, without.ncpa_sigma_nm)
        print("without", *(bits(one[one.shape[0] // 2, one.shape[1] // 4]) for one in maps))
    for sentence in estimate.warnings:
        print("warning", sentence)
    print("policy", estimate.policy)
    print("device", estimate.device)


main(*sys.argv[1:])
