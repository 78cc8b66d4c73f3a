"""Estimators and their estimates through the Python package; run by tests/c_api/main.rs, see there:

    python3 estimator.py SCENE.toml DUMP

The scene has a loop, and is given estimate.method = "full-phase": a MAP estimate. DUMP receives, as doubles in C order,
as in the C test: frames, slopes, coefficients and their standard deviations, covariance, maps, error budget,
corrections.
"""

import os
import signal
import sys
import threading
import time
from pathlib import Path

import cophase
import numpy as np
from support import failure, stars

COUNT, SETTLED, BETWEEN = 4, 300, 60
MAP = '\n[estimate]\nmethod = "full-phase"\n'
MODAL = "\n[modes]\nncpa_count = 20\n"


def sky(scene):
    """Exposures (COUNT, rows, cols), the slopes of each (COUNT, slopes), and the truth (phasing, NCPA)."""
    with cophase.Simulator(scene) as simulator:
        frames, slopes_mas = [], []
        for image in range(COUNT):
            simulator.step(BETWEEN if image else SETTLED)
            frames.append(simulator.image_e)
            slopes_mas.append(simulator.slopes_mas)
        return np.stack(frames), np.stack(slopes_mas), simulator.phasing_nm, simulator.ncpa_nm


def refusals(scene, estimator, frames, slopes_mas):
    bad = failure(lambda: cophase.Estimator(scene + MAP + "optimizer = 'bfgs'\n"), cophase.BadSceneError)
    assert "bfgs" in str(bad) and "full-phase" in str(bad), bad
    bad = failure(lambda: cophase.Estimator(scene, policy="quick"), ValueError)
    assert "'quick'" in str(bad) and "'realtime'" in str(bad), bad
    failure(lambda: cophase.Estimator(scene, threads=-2), cophase.BadValueError)
    failure(lambda: cophase.Estimator(scene, threads=100_000), cophase.BadValueError)
    bad = failure(lambda: estimator.estimate(frames, slopes_mas=slopes_mas[:, 1:]), cophase.BadShapeError)
    assert f"{slopes_mas.shape[1] - 1} slopes" in str(bad), bad
    bad = failure(lambda: estimator.estimate(frames, slopes_mas=-slopes_mas), cophase.BadValueError)
    assert "opposite sign" in str(bad) and "estimate.telemetry" in str(bad), bad
    assert "--" not in str(bad), bad
    wrong = [
        ({"slopes_mas": slopes_mas[1:]}, cophase.BadShapeError),
        ({"slopes_mas": slopes_mas[None]}, cophase.BadShapeError),
        ({"slopes_mas": np.full_like(slopes_mas, np.nan)}, cophase.BadValueError),
        ({"mask": np.zeros(frames.shape[2:])}, cophase.BadShapeError),
        ({"mask": np.zeros(frames.shape[1:])[1:]}, cophase.BadShapeError),
        ({"mask": np.zeros(frames.shape)[1:]}, cophase.BadShapeError),
        ({"read_noise_e": -1.0}, cophase.BadValueError),
        ({"gain_e": -1.0}, cophase.BadValueError),
        ({"dark": frames}, cophase.BadShapeError),
        ({"frames": frames[:, 1:]}, cophase.BadShapeError),
        ({"frames": 0 * frames}, cophase.BadImageError),
    ]
    for arguments, kind in wrong:
        failure(lambda: estimator.estimate(**{"frames": frames, **arguments}), kind)
    estimator.cancel()
    failure(lambda: estimator.estimate(frames), cophase.Interrupted)


def ctrl_c(estimator, frames, slopes_mas):
    """It stops an estimate that is running, from the thread that watches its progress, and not the next one."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    stages = []

    def press():
        while estimator.progress.stage != "retrieving":
            time.sleep(0.01)
        stages.append(estimator.progress)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=press)
    thread.start()
    try:
        estimator.estimate(frames, slopes_mas=slopes_mas)
        raise AssertionError("Ctrl-C stopped nothing")
    except KeyboardInterrupt:
        thread.join()
    assert stages[0].total == COUNT and stages[0].done < COUNT, stages
    assert estimator.progress.stage == "idle"


def modal(dump):
    """A modal estimate of the realtime policy has what a MAP estimate lacks; commands to a controller that numbers the
    segments from 100 and takes half a unit for each nm."""
    table = Path(f"{dump}.txt")
    table.write_text("".join(f"{k} {100 + k} 0.5\n" for k in range(7)))
    scene = Path(__file__).with_name("tiny.toml").read_text("utf-8")
    scene += f'\n[mirror]\nactuators_across = 7\npitch_m = 0.8\n[commands]\nsegment_file = "{table}"\n'
    frame = stars(cophase.Model(scene))[0][0]
    estimate = cophase.Estimator(scene, policy="realtime", threads=1).estimate(frame)
    assert (estimate.method, estimate.policy, estimate.info.ao_knowledge) == ("modal", "realtime", None), estimate.info
    assert np.allclose(estimate.image_coefficients_nm[0], estimate.coefficients_nm, rtol=0, atol=1e-9)
    correction = estimate.correct()
    table.unlink()
    assert correction.segment_commands == {str(100 + k): 0.5 * nm for k, nm in enumerate(correction.pistons_nm)}
    assert correction.actuator_commands == {} and correction.actuators_nm.size > 20 and correction.slopes_mas.size == 0
    assert np.abs(correction.pistons_nm).max() > 0
    failure(estimate.correct, cophase.BadFileError)
    assert estimate.images.policy[0] == "realtime" and np.isnan(estimate.info.images_to_halve)


def the_same(estimator, modal, frames, slopes_mas, first):
    """Other types, orders and raw values: the same bits. Bad pixels marked in three ways, too: of modal estimates, as
    which they are read in the same way and take less time."""
    again = estimator.estimate(
        np.asfortranarray(frames / 2 + 8),
        slopes_mas=np.asfortranarray(slopes_mas.astype(">f8")),
        dark=np.full(frames.shape[1:], 8.0),
        gain_e=2.0,
    )
    assert np.array_equal(again.coefficients_nm, first.coefficients_nm)
    mask = np.zeros(frames.shape[1:], bool)
    mask[30, 41:43] = True
    unknown = [
        {"frames": np.where(mask, np.nan, frames)},
        {"frames": frames, "mask": mask},
        {"frames": frames, "mask": np.broadcast_to(mask, frames.shape)},
    ]
    single = np.zeros(frames.shape, bool)
    single[0] = mask
    alone = [modal.estimate(np.where(single, np.nan, frames)), modal.estimate(frames, mask=single)]
    assert np.array_equal(alone[0].coefficients_nm, alone[1].coefficients_nm)
    masked = [modal.estimate(**arguments) for arguments in unknown]
    assert all(np.array_equal(estimate.coefficients_nm, masked[0].coefficients_nm) for estimate in masked)
    assert not np.array_equal(masked[0].coefficients_nm, modal.estimate(frames).coefficients_nm)
    warned = [any("not finite" in sentence for sentence in estimate.warnings) for estimate in masked]
    assert warned == [True, False, False], [estimate.warnings for estimate in masked]


def results(found, truth):
    info = found.info
    assert all(name in cophase.Estimate.__doc__ for name in vars(info))
    assert all(name in cophase.Estimate.__doc__ for name in found.images.dtype.names)
    assert (found.method, found.policy, info.ao_knowledge, info.precision) == ("map", "full", "telemetry", "f32"), info
    assert info.has_settled is True and info.images == COUNT and info.used == found.images.is_used.sum()
    assert list(found.images.status) == COUNT * ["OK"] and "reduced" in found.images[0].message
    assert info.modes == len(found.mode_names) == found.coefficients_nm.size and info.segment_modes == 7
    assert found.image_coefficients_nm is None
    assert "phasing" in found.report() and "[image]" in found.scene and found.device and found.model
    assert info.warnings == len(found.warnings)
    assert np.allclose(found.sigma_nm**2, found.covariance_nm2.diagonal(), rtol=1e-12, atol=0)
    assert len(found.error_budget) == info.error_terms and "noise" in found.error_budget[0][0]
    budget_nm = np.array([term[1:] for term in found.error_budget])
    assert np.allclose((budget_nm**2).sum(axis=0) ** 0.5, [info.phasing_sigma_nm, info.ncpa_sigma_nm])
    # Four exposures leave 8 of 60 and 7 of 50 nm: less than half.
    for estimate, true in zip((found.phasing_nm, found.ncpa_nm), truth):
        assert estimate.dtype == np.float64 and np.nanstd(estimate - true) < 0.5 * np.nanstd(true)


def files(found, dump):
    """Files that are written, and a correction with a limit and without."""
    path = Path(f"{dump}.fits")
    found.write(path)
    assert path.read_bytes().startswith(b"SIMPLE")
    path.unlink()
    failure(lambda: found.write("/nowhere/estimate.fits"), cophase.BadFileError)
    failure(lambda: found.correct(limit_nm=-1), cophase.BadValueError)
    limited = found.correct(limit_nm=5, path=path)
    assert np.abs(limited.pistons_nm).max() == 5 and limited.limited > 0
    assert path.read_bytes().startswith(b"SIMPLE")
    path.unlink()
    correction = found.correct()
    assert correction.corrected_modes == limited.corrected_modes > 0
    assert correction.ncpa_held.count("") == correction.corrected_modes and correction.ncpa_drop_nm2 > 0
    assert correction.warnings == []
    assert len(correction.segments_held) == correction.pistons_nm.size + correction.tilts_nm.size
    return correction.pistons_nm, correction.actuators_nm, correction.actuators_m, correction.slopes_mas


def main(scene, dump):
    with open(scene, encoding="utf-8") as file:
        scene = file.read()
    frames, slopes_mas, *truth = sky(scene)
    estimator = cophase.Estimator(scene + MAP, directory=".")
    assert repr(estimator) == "<cophase.Estimator: policy full, idle>" and estimator.progress.stage == "idle"
    refusals(scene, estimator, frames, slopes_mas)
    ctrl_c(estimator, frames, slopes_mas)
    found = estimator.estimate(frames, slopes_mas=slopes_mas)
    results(found, truth)
    moves = files(found, dump)
    the_same(cophase.Estimator(scene + MAP, threads=1), cophase.Estimator(scene + MODAL), frames, slopes_mas, found)
    modal(dump)
    estimator.close()
    failure(lambda: estimator.progress, cophase.BadArgumentError)

    maps_nm = (found.phasing_nm, found.ncpa_nm, found.phasing_sigma_nm, found.ncpa_sigma_nm)
    budget_nm = np.array([term[1:] for term in found.error_budget])
    numbers = (found.coefficients_nm, found.sigma_nm, found.covariance_nm2, *maps_nm, budget_nm, *moves)
    with open(dump, "wb") as file:
        for array in (frames, slopes_mas, *numbers):
            assert array.dtype == np.float64
            file.write(array.tobytes())
    found.close()
    failure(found.report, cophase.BadArgumentError)


main(*sys.argv[1:])
