"""Failures through the Python package: every exception, threads, Ctrl-C; run by tests/c_api/main.rs, see there:

    python3 failures.py SCENE.toml [DEBUG]

With DEBUG the library is one that fails on demand.
"""

import contextlib
import os
import pickle
import signal
import sys
import tempfile
import threading
from pathlib import Path

import cophase
import numpy as np
from cophase._interrupt import interruptible
from cophase._library import lib, words
from support import failure, stars

#: Frames whose fit takes some seconds, so that another thread finds it running.
MANY = 3000


def every_status_has_its_exception():
    kinds = {}
    for number in range(1, 100):
        name = words(lib.cophase_status_name(number))
        if name == "UNKNOWN":
            break
        (kinds[name],) = (kind for kind in cophase.Error.__subclasses__() if kind.status == name)
        assert getattr(cophase, kinds[name].__name__) is kinds[name] and kinds[name].__name__ in cophase.__all__
    assert len(kinds) == len(cophase.Error.__subclasses__()) == lib.COPHASE_PANIC
    again = pickle.loads(pickle.dumps(cophase.BusyError("a sentence")))
    assert type(again) is cophase.BusyError and str(again) == "a sentence" and again.status == "BUSY"


def one_of_each(scene, model, session, frame):
    """Those of one thread's misuse."""
    error = failure(lambda: cophase.Model("[pupil]\napertur = 3\n"), cophase.BadSceneError)
    assert error.status == "BAD_SCENE" and "apertur" in str(error)
    absent = scene.replace('aperture = "hexagonal"', 'file = "no such.fits"').replace("rings    = 1", "")
    assert "no such.fits" in str(failure(lambda: cophase.Model(absent, "/no such folder"), cophase.BadFileError))
    missing = cophase.scene_set(scene, mirror__actuator_file="none.txt")
    bad = failure(lambda: cophase.Estimator(missing), cophase.BadFileError)
    assert "none.txt" in str(bad) and "mirror.actuator_file" in str(bad), bad
    failure(lambda: session.fit(frame[1:]), cophase.BadShapeError)
    whole = np.zeros((512, 512))
    assert "cophase reduce" in str(failure(lambda: cophase.Estimator(scene).estimate(whole), cophase.BadShapeError))
    failure(lambda: session.evaluate(np.zeros(model.modes)), cophase.BadValueError)
    failure(lambda: session.evaluate(np.zeros(model.modes), 0 * frame), cophase.BadImageError)
    failure(lambda: cophase.Session(model, device="opencl:9:9"), cophase.DeviceError)
    closed = cophase.Session(model)
    closed.close()
    failure(closed.cancel, cophase.BadArgumentError)
    session.cancel()
    failure(lambda: session.fit(frame), cophase.Interrupted)
    assert session.fit(frame).status == "OK"


def scenes_by_name(path, scene):
    """A scene is a file, a preset or a text, wherever one is taken."""
    text = cophase.preset("keck-artificial")
    assert cophase.scene_set("keck-artificial", image__pixels=128) == cophase.scene_set(text, image__pixels=128)
    assert cophase.scene_set(path) == cophase.scene_set(Path(path)) == scene
    factory = cophase.SessionFactory(Path(path))
    assert factory == cophase.SessionFactory(path) == cophase.SessionFactory(scene, os.path.dirname(path))
    assert factory.scene == scene and cophase.Model(path).mode_names == factory.model().mode_names
    takers = (cophase.Estimator, cophase.Model, cophase.Simulator, cophase.scene_set)
    with tempfile.TemporaryDirectory() as folder:
        # The files that it names are beside it.
        mine, raw = os.path.join(folder, "mine.toml"), os.path.join(folder, "raw.fits")
        Path(mine).write_text(cophase.scene_set(scene, mirror__actuator_file="none.txt"))
        Path(raw).write_bytes(b"SIMPLE  =\xff")
        error = failure(lambda: cophase.Estimator(mine), cophase.BadFileError)
        assert os.path.join(folder, "none.txt") in str(error), error
        recipe = cophase.Estimator(Path(path), directory=folder).__reduce__()[1]
        assert recipe[0] == scene and recipe[-1] == folder
        for take in takers:
            error = failure(lambda: take(os.path.join(folder, "no.toml")), cophase.BadFileError)
            assert "no.toml" in str(error) and "no such file" in str(error) and "keck-artificial" in str(error), error
            assert "raw.fits: is not a text" in str(failure(lambda: take(raw), cophase.BadFileError))
            assert f"{folder}: " in str(failure(lambda: take(Path(folder)), cophase.BadFileError))
            error = failure(lambda: take("keck-artifical"), cophase.BadSceneError)
            assert "did you mean 'keck-artificial'?" in str(error), error
            failure(lambda: take(3), TypeError)
    # A simulation without noise needs a flux.
    dark = {"image__photon_noise": False, "image__read_noise_e": 0}
    assert "image.flux_e" in str(failure(lambda: cophase.scene_set("keck-onsky", **dark), cophase.BadSceneError))


def faults(model, frame):
    """An object is lost after a panic, and only that."""
    session = cophase.Session(model)
    os.environ["COPHASE_FAULT"] = "internal"
    failure(lambda: session.fit(frame), cophase.InternalError)
    os.environ["COPHASE_FAULT"] = "panic"
    failure(lambda: session.fit(frame), cophase.PanicError)
    del os.environ["COPHASE_FAULT"]
    failure(lambda: session.fit(frame), cophase.PanicError)
    session.close()
    assert cophase.Session(model).fit(frame).status == "OK"


def busy(session):
    try:
        session.message()
    except cophase.BusyError:
        return True
    except cophase.BadValueError:  # no fit yet
        pass
    return False


def patiently(call):
    """What ``call`` returns, once nobody who looks whether the session is busy keeps it busy by that."""
    while True:
        with contextlib.suppress(cophase.BusyError):
            return call()


def child_of_a_fork(scene, session, frame):
    """A child has none of its parent's threads: its calls fail at once, and it ends."""
    pid = os.fork()
    if pid == 0:
        try:
            sentences = [
                str(failure(call, cophase.BusyError))
                for call in (lambda: session.fit(frame), lambda: cophase.Model(scene), lambda: cophase.Estimator(scene).estimate(frame))
            ]
            os._exit(0 if all("fork" in sentence for sentence in sentences) else 1)
        except BaseException:
            os._exit(2)
    signal.alarm(60)
    assert os.waitpid(pid, 0)[1] == 0
    signal.alarm(0)
    assert session.fit(frame).status == "OK"


def threads(model, frame):
    """Two on one session, one of which cancels; or closes it while it works, and the work goes on."""
    session = cophase.Session(model, capacity=MANY)
    many = np.broadcast_to(frame, (MANY, *frame.shape))
    outcome = []

    def fit():
        try:
            outcome.append(patiently(lambda: session.fit(many)).status[-1])
        except cophase.Error as error:
            outcome.append(error.status)

    def close():
        handle = session._handle
        session.close()
        assert lib.cophase_session_cancel(handle) == lib.COPHASE_OK

    for end in (session.cancel, close):
        thread = threading.Thread(target=fit)
        thread.start()
        while thread.is_alive() and not busy(session):
            pass
        failure(lambda: session.fit(frame), cophase.BusyError)
        failure(lambda: cophase.Sequence(model, 3).push(session), cophase.BusyError)
        end()
        thread.join()
        assert outcome.pop() == "INTERRUPTED"
    failure(lambda: session.fit(frame), cophase.BadArgumentError)


def ctrl_c(model, frame):
    """It stops a fit that runs, and nothing else."""
    # Not so where a shell in the background has it ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    session = cophase.Session(model, capacity=MANY)

    def press():
        while not busy(session):
            pass
        os.kill(os.getpid(), signal.SIGINT)

    def stopped(call):
        try:
            patiently(call)
        except KeyboardInterrupt:
            return True
        return False

    thread = threading.Thread(target=press)
    thread.start()
    assert stopped(lambda: session.fit(np.broadcast_to(frame, (MANY, *frame.shape))))
    thread.join()
    assert session.fit(frame).status == "OK"

    # Too late to stop anything: the fit is over when the signal comes.
    calls = []

    def call():
        session.fit(frame, deadline_s=0.1)
        calls.append(frame)
        os.kill(os.getpid(), signal.SIGINT)

    assert stopped(lambda: interruptible(call, session.cancel)) and len(calls) == 1
    assert session.fit(frame).status == "OK"

    # Nothing stops the set-up of a model: it is left to end by itself, long before or after which the signal has its effect.
    is_over = threading.Event()

    def set_up():
        os.kill(os.getpid(), signal.SIGINT)
        is_over.wait(60)

    assert stopped(lambda: interruptible(set_up)) and not is_over.is_set()
    is_over.set()


def main(path, debug=None):
    scene = Path(path).read_text("utf-8")
    scenes_by_name(path, scene)
    model = cophase.Model(scene)
    frame = stars(model)[0][0]
    every_status_has_its_exception()
    one_of_each(scene, model, cophase.Session(model), frame)
    if debug:
        faults(model, frame)
    child_of_a_fork(scene, cophase.Session(model), frame)
    threads(model, frame)
    ctrl_c(model, frame)


main(*sys.argv[1:])
