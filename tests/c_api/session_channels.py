"""A session of several channels through the Python package on a file of raw doubles, printed as by session_channels.c, see there:

python3 session_channels.py SCENE.toml FRAMES.raw ROWS COLS
"""

import struct
import sys

import cophase
import numpy as np


def bits(value):
    return struct.pack(">d", value).hex()


def group(status, report, *more):
    print("joint", status, int(report.is_contradictory), bits(report.reduced_chi2), bits(report.freedom), *more)


def main(scene, frames, rows, cols):
    with open(scene, encoding="utf-8") as file:
        model = cophase.Model(file.read())
    session = cophase.Session(model, device="cpu", capacity=2)
    frames_e = np.fromfile(frames).reshape(-1, int(rows), int(cols))
    mode_names = model.channel(1).mode_names
    for name in session.channels:
        print("channel", name)
    session.calibrate(gain_e=2.0, channel=session.channels[1])
    session.calibrate(channel=1)
    # By name, in another order than the scene's.
    fit = session.fit(dict(reversed(list(zip(session.channels, frames_e)))))
    assert np.array_equal(fit.coefficients_nm, session.fit(list(frames_e), deadline_s=3600.0).coefficients_nm)
    for name, nm, sigma_nm in zip(mode_names, fit.coefficients_nm, fit.sigma_nm):
        print("coefficient", name, bits(nm), bits(sigma_nm))
    for index, report in enumerate(fit.reports):
        print("image", index, fit.image_status[index], bits(report.reduced_chi2), report.is_used, report.channel)
    group(fit.status, fit.groups)
    for sentence in session.warnings:
        print("warning", sentence)
    # Two groups in one call: each has the bits of a call of its own.
    both = session.fit([np.stack([frame_e, frame_e]) for frame_e in frames_e])
    assert both.reports.shape == (2, 2) and both.groups.shape == both.status.shape == (2,)
    assert all(name in cophase.Fit.__doc__ for name in both.groups.dtype.names if name != "piston_probability")
    assert np.array_equal(both.coefficients_nm, [fit.coefficients_nm] * 2) and np.array_equal(both.sigma_nm, [fit.sigma_nm] * 2)
    assert session.message(1, session.channels[1])
    refined = session.refine(1)
    for name, nm, variance_nm2 in zip(mode_names, refined.coefficients_nm, refined.covariance_nm2.diagonal()):
        print("refined", name, bits(nm), bits(variance_nm2))
    group(refined.status, refined, bits(refined.piston_probability))
    print("policy", session.policy)
    session.cancel()
    for refused, call in [
        (cophase.Interrupted, lambda: session.fit(list(frames_e))),
        (cophase.BadShapeError, lambda: session.fit(list(frames_e[:1]))),
        (cophase.BadShapeError, lambda: session.fit({"blue": frames_e[0]})),
        (ValueError, lambda: session.calibrate(channel="blue")),
        (cophase.BadValueError, lambda: model.psf(np.zeros(model.modes))),
        (cophase.BadValueError, lambda: model.channel(2)),
        (cophase.BadValueError, lambda: cophase.Sequence(model, 3)),
    ]:
        try:
            call()
        except refused:
            continue
        raise AssertionError(f"no {refused.__name__}")


main(*sys.argv[1:])
