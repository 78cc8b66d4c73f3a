"""Model, session and sequence through the Python package; run by tests/c_api/main.rs, see there:

    python3 session.py SCENE.toml DUMP

DUMP receives, as doubles in C order, as in the C test: COUNT frames; their coefficients; the covariance of the first; the
true coefficients; objectives and gradients there.
"""

import math
import os
import pickle
import sys
import threading

import cophase
import numpy as np
from support import BACKGROUND_E, COUNT, FLUX_E, failure, stars


def budgets(scene, model, frames):
    # A budget in the scene plans the model, in this language as in any other: less of it, that reads the same.
    planned = cophase.Model(scene + "\n[estimate]\nbudget_nm = 20\n")
    assert planned.mode_names == model.mode_names and planned.samples == model.samples
    assert planned.pixels < model.pixels
    found = cophase.Session(planned, capacity=COUNT).fit(frames).coefficients_nm
    exact = cophase.Session(model, capacity=COUNT).fit(frames).coefficients_nm
    for one, other in zip(found, exact):
        for part, wanted in zip(planned.wavefront_nm(one), model.wavefront_nm(other)):
            # Twice the budget, which does not count the tilt that the two parts share.
            assert np.nanstd(part - wanted) < 40
    failure(lambda: cophase.Model(scene + "\n[estimate]\nbudget_nm = 0\n"), cophase.BadSceneError)


def models(scene, model):
    assert len(model.mode_names) == len(set(model.mode_names)) == model.modes
    assert 0 < model.segment_modes < model.modes and f"{model.modes} modes" in repr(model)
    c = np.zeros(model.modes)
    c[1], c[-1] = 50, -20
    phasing_nm, ncpa_nm = model.wavefront_nm(c)
    assert phasing_nm.shape == ncpa_nm.shape == (model.samples, model.samples) and ncpa_nm.dtype == np.float64
    assert np.array_equal(np.isnan(phasing_nm), np.isnan(ncpa_nm)) and np.isnan(ncpa_nm).any()
    # The modes have unit RMS: that is what a coefficient is.
    assert np.nanmax(np.abs(phasing_nm)) > 10 and np.nanmax(np.abs(ncpa_nm)) > 20
    assert np.array_equal(model.psf(list(c)), model.psf(np.float32(c)[::-1][::-1]))
    assert model.psf(c).shape == (model.pixels, model.pixels) and 0.5 < model.psf(c).sum() < 1.001
    assert f"({model.modes},) is accepted" in str(failure(lambda: model.psf(c[1:]), cophase.BadShapeError))
    failure(lambda: model.wavefront_nm([c, c]), cophase.BadShapeError)
    assert "complex" in str(failure(lambda: model.psf(1j * c), TypeError))
    failure(lambda: cophase.Model(b"text"), TypeError)
    assert "index 3" in str(failure(lambda: cophase.Model("# a\0"), ValueError))


def pickles(scene, model, frames):
    """Models, estimators and factories of sessions are the same where they are unpickled; sessions do not pickle."""
    again = pickle.loads(pickle.dumps(model))
    assert again is not model and again.mode_names == model.mode_names
    c = np.linspace(-20, 20, model.modes)
    assert np.array_equal(again.psf(c), model.psf(c))
    estimator = cophase.Estimator(scene, policy="realtime", threads=1)
    same = pickle.loads(pickle.dumps(estimator))
    one, other = (each.estimate(frames) for each in (estimator, same))
    assert np.array_equal(one.coefficients_nm, other.coefficients_nm)
    assert one.info.policy == other.info.policy == "realtime"
    factory = pickle.loads(pickle.dumps(cophase.SessionFactory(scene, capacity=COUNT, precision="f32")))
    assert factory.directory == os.getcwd()
    assert factory == cophase.SessionFactory(scene, os.getcwd(), None, COUNT, "f32")
    session = factory()
    assert session is factory() and session.capacity == COUNT and session.model is factory.model()
    own = cophase.Session(model, capacity=COUNT, precision="f32").fit(frames).coefficients_nm
    assert np.array_equal(session.fit(frames).coefficients_nm, own)
    others = []
    thread = threading.Thread(target=lambda: others.append(factory()))
    thread.start()
    thread.join()
    assert others[0] is not session and others[0].model is session.model
    assert "SessionFactory" in str(failure(lambda: pickle.dumps(session), TypeError))
    assert "cophase.Estimate does not pickle" in str(failure(lambda: pickle.dumps(one), TypeError))
    again.close()
    assert "closed" in str(failure(lambda: pickle.dumps(again), TypeError))


def from_arrays():
    """A telescope of one's own, without segments and with two."""
    n = 32
    y, x = ((np.mgrid[:n, :n] + 0.5) / n - 0.5) * 2.1
    pupil = x**2 + y**2 < 0.95
    modes = np.stack([2 * x, math.sqrt(6) * (x**2 - y**2), math.sqrt(24) * x * y])
    scene = """
        pupil.grid_m = 11.25
        [image]
        wavelength_nm = 2200
        samples_per_lambda_over_d = 2
        pixels = 48
        diversity_focus_waves_rms = 0.5
        [modes]
        exact_zernikes = []
    """
    model = cophase.Model.from_arrays(scene, pupil=pupil, modes=modes)
    assert (model.modes, model.segment_modes, model.samples, model.frame_shape) == (3, 0, n, (48, 48)), model
    truth_nm = [30, -40, 20]
    _, ncpa_nm = model.wavefront_nm(truth_nm)
    # A map of up to 200 nm, in double precision.
    assert np.allclose(ncpa_nm[pupil], np.tensordot(truth_nm, modes, 1)[pupil], rtol=0, atol=1e-10)
    same = cophase.Model.from_arrays(scene, pupil=pupil * 1.0, modes=modes.T.copy().T)
    assert np.array_equal(same.psf(truth_nm), model.psf(truth_nm))
    segments = np.where(pupil, x > 0, -1)  # int64
    halves = cophase.Model.from_arrays(scene, pupil=pupil, segments=segments, modes=modes, diversity_nm=500 * modes[1])
    assert (halves.modes, halves.segment_modes) == (5, 2), halves
    # Without modes and [modes], those of a scene, on its grid.
    fine = np.kron(segments, np.ones((8, 8), int))
    plain = scene.replace("exact_zernikes = []", "").replace("grid_m = 11.25", "grid_m = 11.25\n pupil.samples = 64")
    default = cophase.Model.from_arrays(plain, pupil=fine >= 0, segments=fine)
    assert default.modes > 66 and default.segment_modes == 2 and default.samples == 64, default
    refused = [
        ({"pupil": 2.0 * pupil}, cophase.BadValueError),
        ({"pupil": pupil[1:]}, cophase.BadShapeError),
        ({"pupil": pupil, "modes": modes[:, 2:]}, cophase.BadShapeError),
        ({"pupil": pupil, "segments": segments + 0.5}, cophase.BadValueError),
        ({"pupil": pupil, "modes": modes[0, 0]}, cophase.BadShapeError),
        ({"pupil": np.ma.masked_array(pupil)}, TypeError),
    ]
    for arrays, kind in refused:
        failure(lambda: cophase.Model.from_arrays(scene, **{"modes": modes, **arrays}), kind)


def choices(model):
    assert next(iter(cophase.devices())) == "cpu"
    assert "capacity is -1" in str(failure(lambda: cophase.Session(model, capacity=-1), OverflowError))
    assert "capacity is 'x'" in str(failure(lambda: cophase.Session(model, capacity="x"), TypeError))
    assert "f16" in str(failure(lambda: cophase.Session(model, precision="f16"), ValueError))
    assert "capacity is 0" in str(failure(lambda: cophase.Session(model, capacity=0), ValueError))
    failure(lambda: cophase.Session(model, device="gpu?"), cophase.BadValueError)
    failure(lambda: cophase.Session(model, threads=7), cophase.BadValueError)
    failure(lambda: cophase.Session(model, step_tolerance_nm=math.nan), cophase.BadValueError)
    with cophase.Session(model, device="cpu", capacity=2, precision="f32", threads=-1, max_evaluations=50) as session:
        assert repr(session) == f"<cophase.Session: {model.modes} modes, up to 2 images, on cpu>"
        assert session.model is model and session.capacity == 2 and session.device == "cpu"
        assert session.policy == "realtime"
    assert repr(session) == "<cophase.Session: closed>"
    session.close()


def fits(model, session, frames, truth_nm):
    """The truth comes back, within its error bars; each image has a report."""
    failure(session.message, cophase.BadValueError)
    failure(session.refine, cophase.BadValueError)
    fit = session.fit(frames)
    assert fit.coefficients_nm.shape == truth_nm.shape and fit.reports.shape == fit.status.shape == (COUNT,)
    assert list(fit.status) == ["OK"] * COUNT, session.message()
    assert all(name in cophase.Fit.__doc__ for name in fit.reports.dtype.names)
    # Its scatter is sqrt(2 / 1500) at most.
    assert (abs(fit.reports.reduced_chi2 - 1) < 0.2).all(), fit.reports
    assert (abs(fit.reports.flux_e / FLUX_E - 1) < 0.01).all() and (fit.reports.evaluations > 1).all()
    assert (abs(fit.reports.background_e - BACKGROUND_E) < 3).all() and (fit.reports.seconds > 0).all()
    for k in range(COUNT):
        error_nm = fit.coefficients_nm[k] - truth_nm[k]
        # Nothing sees the piston of all segments together.
        error_nm[: model.segment_modes] -= error_nm[: model.segment_modes].mean()
        covariance_nm2 = session.refine(k).covariance_nm2
        # Six sigma: not one in ten million of these errors is larger.
        assert (error_nm**2 < 36 * np.diag(covariance_nm2)).all(), (error_nm, np.diag(covariance_nm2) ** 0.5)
        assert session.message(k)
    assert session.warnings == []
    failure(lambda: session.message(COUNT), cophase.BadValueError)
    failure(lambda: session.message(-1), OverflowError)

    # One image alone has no axis of images.
    covariance_nm2 = session.refine().covariance_nm2
    one = session.fit(frames[0])
    assert one.coefficients_nm.shape == (model.modes,) and one.reports.shape == one.status.shape == ()
    assert one.status == "OK" and one.reports.flux_e == fit.reports.flux_e[0]
    assert np.array_equal(one.coefficients_nm, fit.coefficients_nm[0])

    # One that is dark beside two that are not.
    dark = frames.copy()
    dark[1] = 0
    spoilt = session.fit(dark)
    assert list(spoilt.status) == ["OK", "UNUSABLE", "OK"] and np.isnan(spoilt.coefficients_nm[1]).all()
    assert np.array_equal(spoilt.coefficients_nm[::2], fit.coefficients_nm[::2])
    return fit.coefficients_nm, covariance_nm2


def layouts(model, session, frames, c):
    """Whole electrons are one estimate, whatever holds them, wherever they lie and in whatever company."""

    def same(frames, c):
        # NaN is not equal: each image could be used.
        assert np.array_equal(session.fit(frames).coefficients_nm, c)

    large = np.full([2 * extent + 3 for extent in frames.shape], -7.0)
    window = tuple(slice(2, 2 + 2 * extent, 2) for extent in frames.shape)
    large[window] = frames
    same(large[window], c)
    same(np.asfortranarray(frames), c)
    same(frames[::-1, ::-1, ::-1].copy()[::-1, ::-1, ::-1], c)
    same(frames.transpose(2, 0, 1).copy().transpose(1, 2, 0), c)
    same(np.broadcast_to(frames[1], frames.shape), c[[1] * COUNT])
    same(frames[::-1], c[::-1])
    record = np.zeros(frames.shape, [("time", "u1"), ("frame", "f4")])
    record["frame"] = frames
    same(record["frame"], c)
    frozen = frames.copy()
    frozen.flags.writeable = False
    same(frozen, c)
    for kind in ("f4", "f8", "u2", "i4", ">f4", ">f8", ">u2", ">i4", "u4", "i8", "u8"):
        same(frames.astype(kind), c)
    few = frames.clip(0, 255)
    as_bytes = session.fit(few).coefficients_nm
    same(few.astype("u1"), as_bytes)
    few = few.clip(0, 127)
    same(few.astype("i1"), session.fit(few).coefficients_nm)
    bright = frames > 1000
    same(bright, session.fit(bright.astype("f4")).coefficients_nm)
    for threads in (-1, 1):
        other = cophase.Session(model, capacity=COUNT, precision="f32", threads=threads)
        # A tenth of an error bar.
        assert abs(other.fit(frames).coefficients_nm - c).max() < 0.05
    for kind in ("c8", "S3", "O", "M8[s]", np.longdouble):
        if np.dtype(kind) != np.float64:  # what some platforms take for a long double
            assert "has the type" in str(failure(lambda: session.fit(np.zeros(model.frame_shape, kind)), TypeError))
    assert "masked" in str(failure(lambda: session.fit(np.ma.masked_less(frames, 0)), TypeError))
    quantities(session, frames, c, same)
    wrong = (frames[0, 0], frames[None], frames[:, 1:], frames[:0], np.concatenate([frames, frames]), frames[0].T[1:])
    for frame in wrong:
        failure(lambda: session.fit(frame), cophase.BadShapeError)
    same(frames, c)


class Quantity(np.ndarray):
    """As a quantity of Astropy: an array with a unit."""

    unit = None


class CCDData:
    """As those of Astropy."""

    def __init__(self, data, unit, mask=None, uncertainty=None):
        self.data, self.unit, self.mask, self.uncertainty = data, unit, mask, uncertainty

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.data, dtype)


def quantities(session, frames, c, same):
    """What NumPy would drop is honoured, where it changes nothing, or refused."""

    def quantity(unit):
        values = frames.view(Quantity)
        values.unit = unit
        return values

    for plain in (quantity("electron"), CCDData(frames, "electron"), CCDData(frames, "electron", frames < -1e9)):
        same(plain, c)
    for unit in ("adu", "electron / s", "ct", "mJy"):
        assert unit in str(failure(lambda: session.fit(quantity(unit)), TypeError))
        assert unit in str(failure(lambda: session.fit(CCDData(frames, unit)), TypeError))
    assert "mask" in str(failure(lambda: session.fit(CCDData(frames, "electron", frames > 10)), TypeError))
    noisy = CCDData(frames, "electron", uncertainty=frames)
    assert "uncertainty" in str(failure(lambda: session.fit(noisy), TypeError))


def ways(model, session, frames, c):
    """Starts, noise, deadlines."""
    cold = session.fit(frames)
    warm = session.fit(frames, start_nm=c, deadline_s=1e4)
    assert (warm.reports.evaluations < cold.reports.evaluations).all() and list(warm.status) == ["OK"] * COUNT
    assert np.array_equal(
        session.fit(frames[1], start_nm=np.float32(c[1])[::-1][::-1], deadline_s=math.inf).coefficients_nm,
        session.fit(frames, start_nm=np.float32(c)).coefficients_nm[1],
    )
    assert "(3, 2)" in str(failure(lambda: session.fit(frames, start_nm=c[:, :2]), cophase.BadShapeError))
    failure(lambda: session.fit(frames, start_nm=1j * c), TypeError)
    failure(lambda: session.fit(frames, start_nm=c + math.nan), cophase.BadValueError)
    assert session.fit(frames[0], read_noise_e=1000).reports.reduced_chi2 < 0.1
    assert session.fit(frames[0], read_noise_e=0).status == "MISFIT"
    failure(lambda: session.fit(frames, read_noise_e=-1), cophase.BadValueError)
    assert "deadline_s is 0" in str(failure(lambda: session.fit(frames, deadline_s=0.0), ValueError))
    failure(lambda: session.fit(frames, deadline_s=-1), cophase.BadValueError)
    failure(lambda: session.fit(frames, deadline_s="soon"), TypeError)
    late = session.fit(frames, deadline_s=1e-9)
    assert list(late.status) == ["DEADLINE"] * COUNT and np.isfinite(late.coefficients_nm).all()
    assert np.array_equal(session.fit(frames).coefficients_nm, c)


def calibrations(model, session, frames, c):
    """electrons = (raw - dark) * gain / flat; powers of two, so that nothing is rounded on the way."""
    rows, cols = model.frame_shape
    # A detector that is not square lacks some of the pixels that are fitted.
    lacking = session.fit(frames).reports.bad_pixels
    dark = np.broadcast_to(np.arange(cols, dtype=np.uint16) % 5, (rows, cols))
    flat = np.broadcast_to(np.float32(2) ** (np.arange(rows) % 2)[:, None], (rows, cols))
    raw = frames * flat * 2 + dark
    session.calibrate(dark=dark, flat=flat, gain_e=0.5)
    assert np.array_equal(session.fit(raw).coefficients_nm, c)
    session.calibrate(saturation=frames.max())
    assert (session.fit(frames).reports.bad_pixels > lacking).any()
    y, x = rows // 2 - 4, cols // 2
    bad = np.zeros((rows, cols), bool)
    bad[y, x : x + 3] = True
    unknown = np.where(bad, np.nan, frames)
    session.calibrate()
    without = session.fit(unknown)
    assert list(without.reports.bad_pixels) == list(lacking + 3)
    session.calibrate(bad=bad)
    assert np.array_equal(session.fit(np.where(bad, 6e4, frames)).coefficients_nm, without.coefficients_nm)
    failure(lambda: session.calibrate(dark=dark[1:]), cophase.BadShapeError)
    failure(lambda: session.calibrate(gain_e=-1), cophase.BadValueError)
    failure(lambda: session.calibrate(gain_e="much"), TypeError)
    session.calibrate()
    assert np.array_equal(session.fit(frames).coefficients_nm, c)


def gradients(model, session, frames, truth_nm):
    fresh = cophase.Session(model, capacity=COUNT)
    failure(lambda: fresh.evaluate(truth_nm), cophase.BadValueError)
    objectives, gradients = session.evaluate(truth_nm, frames)
    assert objectives.shape == (COUNT,) and gradients.shape == truth_nm.shape
    step_nm = 0.01
    for mode in range(model.modes):
        away_nm = step_nm * np.eye(model.modes)[mode]
        above, below = (session.evaluate(truth_nm + sign * away_nm)[0] for sign in (1, -1))
        # The objective is some 2000 and rounds at 1e-16 of it: 2e-11 per nm after the division. Its third derivative is
        # the curvature (1 over the error bar of about 0.5 nm, squared) over a radian of 345 nm: 0.01 per nm^3, which
        # times step^2 / 6 is 2e-7.
        allowed = 1e-5 * (1 + abs(gradients[:, mode]))
        assert (abs((above - below) / (2 * step_nm) - gradients[:, mode]) < allowed).all(), mode
    failure(lambda: session.evaluate(truth_nm[:, 1:]), cophase.BadShapeError)
    failure(lambda: session.evaluate(truth_nm[None]), cophase.BadShapeError)
    failure(lambda: session.evaluate(truth_nm, frames[:2]), cophase.BadShapeError)
    failure(lambda: session.evaluate(truth_nm, 0 * frames), cophase.BadImageError)
    one, gradient = session.evaluate(truth_nm[1], frames[1], read_noise_e=10)
    assert one.shape == () and gradient.shape == (model.modes,)
    assert one == objectives[1] and np.array_equal(gradient, gradients[1])
    return objectives, gradients


def sequences(model, session, frames):
    failure(lambda: cophase.Sequence(model, 0), cophase.BadValueError)
    sequence = cophase.Sequence(model, 7)
    assert "last 7 images" in repr(sequence)
    for call in (sequence.estimate, sequence.images_needed):
        failure(call, cophase.BadImageError)
    session.fit(frames)
    sequence.push(session)
    session.fit(frames[:2])
    sequence.push(session)
    estimate = sequence.estimate()
    report = estimate.info
    assert estimate.coefficients_nm.shape == estimate.sigma_nm.shape == (model.modes,)
    assert all(name in cophase.SequenceEstimate.__doc__ for name in vars(report))
    assert report.images == 5 and 0 < report.used <= 5 - report.clipped
    assert min(report.phasing_rms_nm, report.phasing_sigma_nm, report.ncpa_rms_nm, report.ncpa_sigma_nm) > 0
    covariance_nm2 = estimate.covariance_nm2
    # Both up to the rounding of sums of some ten products.
    assert np.allclose(np.diag(covariance_nm2) ** 0.5, estimate.sigma_nm, rtol=1e-12)
    assert np.allclose(covariance_nm2, covariance_nm2.T, rtol=0, atol=1e-12 * covariance_nm2.max())
    assert sequence.images_needed() == 0 < sequence.images_needed(phasing_nm=report.phasing_sigma_nm / 10)
    failure(lambda: sequence.images_needed(ncpa_nm=-1), cophase.BadValueError)
    for _ in range(2):
        session.fit(frames)
        sequence.push(session)
    assert sequence.estimate().info.images == 7
    sequence.clear()
    failure(sequence.estimate, cophase.BadImageError)
    with sequence, cophase.Model(cophase.preset("keck-artificial")) as other:
        stranger = cophase.Session(other)
        failure(lambda: sequence.push(stranger), cophase.BadValueError)
        stranger.close()
        failure(lambda: sequence.push(stranger), cophase.BadArgumentError)
    failure(lambda: sequence.push(session), cophase.BadArgumentError)


def main(scene, dump):
    with open(scene, encoding="utf-8") as file:
        scene = file.read()
    model = cophase.Model(scene)
    session = cophase.Session(model, capacity=COUNT)
    frames, truth_nm = stars(model)
    c, covariance_nm2 = fits(model, session, frames, truth_nm)
    models(scene, model)
    pickles(scene, model, frames)
    budgets(scene, model, frames)
    from_arrays()
    choices(model)
    layouts(model, session, frames, c)
    ways(model, session, frames, c)
    calibrations(model, session, frames, c)
    objectives, slopes = gradients(model, session, frames, truth_nm)
    sequences(model, session, frames)
    # What is made of a model lives on its own.
    model.close()
    failure(lambda: model.psf(truth_nm[0]), cophase.BadArgumentError)
    assert np.array_equal(session.fit(frames).coefficients_nm, c)
    with open(dump, "wb") as file:
        for array in (frames, c, covariance_nm2, truth_nm, objectives, slopes):
            assert array.dtype == np.float64
            file.write(array.tobytes())


main(*sys.argv[1:])
