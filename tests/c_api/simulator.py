"""The simulator through the Python package; run by tests/c_api/main.rs, see there:

python3 simulator.py SCENE.toml FRAMES DUMP
"""

import sys
import threading

import cophase
import numpy as np


def failure(call):
    """The failure that ``call`` must raise."""
    try:
        call()
    except cophase.Error as error:
        return error
    raise AssertionError("nothing was raised")


def misuse():
    bad = failure(lambda: cophase.Simulator("[pupil]\napertur = 3\n"))
    assert bad.status == "BAD_SCENE" and "apertur" in str(bad), bad
    assert failure(lambda: cophase.preset("keck-onsy")).status == "BAD_SCENE"
    assert "[wavefront_sensor]" in cophase.preset("keck-onsky")
    scene = cophase.preset("keck-artificial")
    changed = cophase.scene_set(scene, image__peak_snr=37, modes__exact_zernikes=[4, 18], estimate__device="cpu")
    words = cophase.scene_set(scene, estimate__fit_optics=["plate-scale", "rotation"])
    assert 'fit_optics = ["plate-scale", "rotation"]' in words, words
    assert "= 37" in changed and "[4, 18]" in changed and '= "cpu"' in changed
    assert cophase.scene_set(changed, image__peak_snr=None) != changed
    assert "image.pixels = 7" in str(failure(lambda: cophase.scene_set(scene, image__pixels=7)))
    # The last failure is a thread's own.
    seen = []
    thread = threading.Thread(target=lambda: seen.append(str(failure(lambda: cophase.preset("ü")))))
    thread.start()
    thread.join()
    assert "ü" in seen[0], seen


def main(scene, frames, dump):
    misuse()
    with open(scene, encoding="utf-8") as file:
        text = file.read()
    simulator = cophase.Simulator(text, directory=".")
    assert simulator.warnings == [], simulator.warnings
    coarse = cophase.Simulator(cophase.scene_set(text, wavefront_sensor__samples_per_lenslet=6))
    assert len(coarse.warnings) == 1 and coarse.warnings[0].startswith("60 samples across the pupil"), coarse.warnings
    early = failure(lambda: simulator.image_e)
    assert early.status == "BAD_VALUE" and "step first" in str(early), early
    simulator.step(int(frames))
    assert simulator.info.frames == int(frames) and simulator.info.frame_s == 1 / 1054
    assert np.isnan(simulator.info.divergence_s)
    # The weights differ only at the pupil's edge, on a few percent of the samples.
    residual = simulator.residual_nm
    assert abs(np.nanstd(residual) / simulator.info.residual_rms_nm - 1) < 0.1
    image = simulator.image_e
    assert image.shape == (simulator.info.rows, simulator.info.cols)
    truth = [simulator.phasing_nm, simulator.ncpa_nm]
    with open(dump, "wb") as file:
        for array in (simulator.slopes_mas, simulator.commands_nm, residual, image, *truth):
            assert array.dtype == np.float64
            file.write(array.astype(np.float32).tobytes())
    with simulator:
        pass
    assert failure(lambda: simulator.step(1)).status == "BAD_ARGUMENT"
    simulator.close()


main(*sys.argv[1:])
