"""Full-phase estimates through the Python package; run by tests/c_api/main.rs, see there:

python3 full_phase.py SCENE.toml DUMP
"""

import sys
import threading

import cophase
import numpy as np
from support import failure

COUNT, SETTLED, BETWEEN = 4, 300, 60


def sky(scene):
    """Exposures (COUNT, rows, cols), the slopes of each (COUNT, slopes), and the truth (phasing, NCPA)."""
    with cophase.Simulator(scene) as simulator:
        frames, slopes_mas = [], []
        for image in range(COUNT):
            simulator.step(BETWEEN if image else SETTLED)
            frames.append(simulator.image_e)
            slopes_mas.append(simulator.slopes_mas)
        return np.stack(frames), np.stack(slopes_mas), simulator.phasing_nm, simulator.ncpa_nm


def refusals(scene, full_phase, frames, slopes_mas):
    bad = failure(lambda: cophase.FullPhase(scene + "\n[estimate]\noptimizer = 'bfgs'\n"), cophase.BadSceneError)
    assert "bfgs" in str(bad) and "full-phase" in str(bad), bad
    without_loop = cophase.FullPhase(scene[: scene.index("[wavefront_sensor]")])
    bad = failure(lambda: without_loop.estimate(frames, slopes_mas, knows="telemetry"), cophase.BadSceneError)
    assert "no [wavefront_sensor] and [control]" in str(bad), bad
    bad = failure(lambda: full_phase.estimate(frames, knows="telemetry"), cophase.BadSceneError)
    assert "images come without slopes" in str(bad), bad
    bad = failure(lambda: full_phase.estimate(frames, knows="everything"), ValueError)
    assert "'everything'" in str(bad) and "telemetry" in str(bad), bad
    bad = failure(lambda: full_phase.estimate(frames, slopes_mas[:, 1:]), cophase.BadShapeError)
    assert f"{slopes_mas.shape[1] - 1} slopes" in str(bad), bad
    failure(lambda: full_phase.estimate(frames, slopes_mas[1:]), cophase.BadShapeError)
    failure(lambda: full_phase.estimate(frames, slopes_mas[0, 0]), cophase.BadShapeError)
    failure(lambda: full_phase.estimate(frames[:, 1:], slopes_mas), cophase.BadShapeError)
    failure(lambda: full_phase.estimate(frames, np.full_like(slopes_mas, np.nan)), cophase.BadValueError)
    failure(lambda: full_phase.estimate(frames, slopes_mas, threads=-1), cophase.BadValueError)
    failure(lambda: full_phase.estimate(0 * frames), cophase.BadImageError)
    failure(full_phase.corrections, cophase.BadValueError)
    full_phase.cancel()
    failure(lambda: full_phase.estimate(frames, slopes_mas), cophase.Interrupted)


class Enough(Exception):
    """What a caller's own code raises."""


def watched(full_phase, frames, slopes_mas):
    """What looks on may stop an estimate, and the next one runs. Whatever the thread, the numbers are the same."""

    def stop(_):
        raise Enough("enough was seen")

    failure(lambda: full_phase.estimate(frames, slopes_mas, progress=stop), Enough)
    seen, found = [], []
    thread = threading.Thread(
        target=lambda: found.append(full_phase.estimate(frames, slopes_mas, threads=1, progress=seen.append))
    )
    thread.start()
    thread.join()
    report = found[0].report
    assert seen == sorted(seen) and seen[-1] == full_phase.retrieved == report.images * report.passes, seen
    return found[0]


def main(scene, dump):
    with open(scene, encoding="utf-8") as file:
        scene = file.read()
    frames, slopes_mas, *truth = sky(scene)
    full_phase = cophase.FullPhase(scene, directory=".")
    assert full_phase.frame_shape == frames.shape[1:] and "72 x 80" in repr(full_phase)
    refusals(scene, full_phase, frames, slopes_mas)
    first = watched(full_phase, frames, slopes_mas)

    # Columns, other types and raw values: the same bits.
    full_phase.calibrate(dark=np.full(frames.shape[1:], 8.0), gain_e=2.0)
    raw = np.asfortranarray(frames.astype(np.float64) / 2 + 8)
    found = full_phase.estimate(raw, np.asfortranarray(slopes_mas.astype(">f4")))
    assert np.array_equal(found.coefficients_nm, first.coefficients_nm)
    assert found.knows == "telemetry" and found.report.settled == 1 and found.report.used == found.reports.used.sum()
    assert list(found.status) == COUNT * ["OK"] and len(found.messages) == COUNT and "reduced" in found.messages[0]
    assert len(found.mode_names) == found.coefficients_nm.size and found.segment_modes == 7
    assert not any("loop's answer" in sentence for sentence in found.warnings)
    assert np.allclose(found.sigma_nm**2, found.covariance_nm2.diagonal(), rtol=1e-12, atol=0)
    # Half of the truth is found by far: four exposures leave 8 of 60 and 7 of 50 nm.
    for estimate, true in zip((found.phasing_nm, found.ncpa_nm), truth):
        assert np.nanstd(estimate - true) < 0.5 * np.nanstd(true)
    assert full_phase.images_needed() == 0 and full_phase.images_needed(phasing_nm=0.1) > COUNT
    failure(lambda: full_phase.images_needed(ncpa_nm=0.0), cophase.BadValueError)

    limited = full_phase.corrections(limit_nm=5)
    assert np.abs(limited.pistons_nm).max() == 5 and limited.limited > 0
    corrections = full_phase.corrections()
    assert corrections.corrected_modes == limited.corrected_modes > 0
    with open(dump, "wb") as file:
        maps = (found.phasing_nm, found.ncpa_nm, found.phasing_sigma_nm, found.ncpa_sigma_nm)
        moves = (corrections.pistons_nm, corrections.actuators_nm, corrections.actuators_m, corrections.slopes_mas)
        for array in (frames, slopes_mas, found.coefficients_nm, found.sigma_nm, found.covariance_nm2, *maps, *moves):
            file.write(array.astype(np.float64).tobytes())

    # What is not known of the loop is warned of.
    blind = full_phase.estimate(raw, knows="spectrum")
    assert blind.knows == "spectrum" and "loop's answer" in blind.warnings[-1], blind.warnings
    full_phase.close()
    failure(lambda: full_phase.retrieved, cophase.BadArgumentError)


main(*sys.argv[1:])
