"""The example that maps a folder of nights over a local cluster of two workers; run by tests/c_api/python.rs:

    python3 nights.py EXAMPLE.py SCENE.toml FOLDER

FOLDER is empty, and receives the nights.
"""

import csv
import subprocess
import sys
from pathlib import Path

import cophase
import numpy as np
from support import READ_NOISE_E, stars


def main(example, scene_file, folder):
    folder = Path(folder)
    scene = Path(scene_file).read_text()
    frames, _ = stars(cophase.Model(scene))
    assert READ_NOISE_E == 10, "the scene has it"
    # Nights of one and of two images, one without a star, one of another size.
    nights = {"a": frames[:1], "b": frames[1:], "c": 0 * frames[:1], "d": frames[:, 1:, 3:]}
    for name, images in nights.items():
        np.save(folder / f"{name}.npy", images)
    table = folder / "table.csv"
    run = subprocess.run([sys.executable, example, scene_file, folder, table, "2"], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    with open(table, newline="") as file:
        rows = {row["night"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["a.npy", "b.npy", "c.npy", "d.npy"], rows
    estimator = cophase.Estimator(scene)
    for name in "ab":
        expected, row = estimator.estimate(nights[name]).info, rows[f"{name}.npy"]
        assert float(row["phasing_rms_nm"]) == expected.phasing_rms_nm and int(row["images"]) == len(nights[name]), row
        assert (row["status"], row["why"]) == (expected.status, "") and (folder / f"{name}.estimate.fits").exists()
    for name, word in (("c", "constant"), ("d", "3 x 48 x 48 is accepted")):
        assert rows[f"{name}.npy"]["status"] == "failed" and word in rows[f"{name}.npy"]["why"], rows
    # A scene that is wrong ends the script with its sentence, before any worker has one.
    wrong = folder / "wrong.toml"
    wrong.write_text("[pupil]\napertur = 3\n")
    run = subprocess.run([sys.executable, example, wrong, folder, table, "2"], capture_output=True, text=True)
    assert run.returncode != 0 and "apertur" in run.stderr.splitlines()[-1], run.stderr


if __name__ == "__main__":
    main(*sys.argv[1:])
