"""A session of several channels through the Python package on a file of raw doubles, printed as by joint_session.c, see there:

python3 joint_session.py SCENE.toml FRAMES.raw ROWS COLS
"""

import struct
import sys

import cophase
import numpy as np


def bits(value):
    return struct.pack(">d", value).hex()


def joint(fit, *more):
    print("joint", fit.status, int(fit.is_contradictory), bits(fit.reduced_chi2), bits(fit.freedom), *more)


def main(scene, frames, rows, cols):
    with open(scene, encoding="utf-8") as file:
        session = cophase.JointSession(file.read(), device="cpu")
    frames_e = np.fromfile(frames).reshape(-1, int(rows), int(cols))
    mode_names = session.models[0].mode_names
    for name in session.channels:
        print("channel", name)
    session.calibrate(session.channels[1], gain_e=2.0)
    session.calibrate(1)
    # By name, in another order than the scene's.
    fit = session.fit(dict(reversed(list(zip(session.channels, frames_e)))))
    assert np.array_equal(fit.coefficients_nm, session.fit(list(frames_e), deadline_s=3600.0).coefficients_nm)
    for name, nm, sigma_nm in zip(mode_names, fit.coefficients_nm, fit.sigma_nm):
        print("coefficient", name, bits(nm), bits(sigma_nm))
    for index, report in enumerate(fit.reports):
        status = cophase.Fit(fit.coefficients_nm, fit.reports).status[index]
        print("image", index, status, bits(report.reduced_chi2), report.is_used, report.channel)
    joint(fit)
    for sentence in session.warnings:
        print("warning", sentence)
    refined = session.refine()
    for name, nm, variance_nm2 in zip(mode_names, refined.coefficients_nm, refined.covariance_nm2.diagonal()):
        print("refined", name, bits(nm), bits(variance_nm2))
    joint(refined, bits(refined.piston_probability))
    print("policy", session.policy)
    assert session.message(session.channels[0])
    session.cancel()
    for refused, call in [
        (cophase.Interrupted, lambda: session.fit(list(frames_e))),
        (cophase.BadShapeError, lambda: session.fit(list(frames_e[:1]))),
        (ValueError, lambda: session.fit({"blue": frames_e[0]})),
        (ValueError, lambda: session.calibrate("blue")),
        (cophase.BadSceneError, lambda: cophase.JointSession(cophase.preset("keck-artificial"))),
    ]:
        try:
            call()
        except refused:
            continue
        raise AssertionError(f"no {refused.__name__}")


main(*sys.argv[1:])
