"""Phasing errors and non-common path aberrations of segmented telescopes.

The library ``libcophase`` in Python. Arrays are ``[row = y, col = x]``; units stand in the names: wavefronts ``_nm`` of
optical path difference, angles on the sky ``_mas``, signal ``_e`` (electrons), time ``_s``.

>>> import cophase
>>> model = cophase.Model(cophase.preset("keck-artificial"))
>>> session = cophase.Session(model)
>>> fit = session.fit(frame)                          # (rows, cols), or a stack of them
>>> segments_nm, ncpa_nm = model.wavefront_nm(fit.coefficients_nm)

And a minute of sky to try it on:

>>> simulator = cophase.Simulator(cophase.preset("keck-onsky"))
>>> simulator.step(100)
>>> simulator.residual_rms_nm, simulator.image_e.shape

Static errors from a sequence of exposures behind adaptive optics:

>>> estimate = cophase.FullPhase(cophase.preset("keck-onsky")).estimate(frames, slopes_mas)
>>> estimate.report.phasing_sigma_nm, estimate.phasing_nm
"""

from ._library import version
from .device import devices
from .errors import (
    BadArgumentError,
    BadFileError,
    BadImageError,
    BadSceneError,
    BadShapeError,
    BadValueError,
    BusyError,
    DeviceError,
    Error,
    InternalError,
    Interrupted,
    PanicError,
)
from .full_phase import Corrections, FullPhase, FullPhaseEstimate
from .model import Model
from .scene import preset
from .sequence import Estimate, Sequence
from .session import Fit, Session
from .simulator import Simulator

__all__ = [
    "BadArgumentError",
    "BadFileError",
    "BadImageError",
    "BadSceneError",
    "BadShapeError",
    "BadValueError",
    "BusyError",
    "Corrections",
    "DeviceError",
    "Error",
    "Estimate",
    "Fit",
    "FullPhase",
    "FullPhaseEstimate",
    "InternalError",
    "Interrupted",
    "Model",
    "PanicError",
    "Sequence",
    "Session",
    "Simulator",
    "devices",
    "preset",
    "version",
]
__version__ = version()
