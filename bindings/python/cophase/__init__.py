"""Phasing errors and non-common path aberrations of segmented telescopes, from defocused images of a star.

The library ``libcophase`` in Python. Arrays are ``[row = y, col = x]``. A unit ends each name: wavefronts ``_nm`` of
optical path difference, angles on the sky ``_mas``, signal ``_e`` (electrons), time ``_s``.

All images of a scene at once, as the program does it. A scene is a TOML file, a preset or TOML text:

>>> import cophase
>>> estimate = cophase.Estimator("keck-artificial").estimate(frames)                    # (images, rows, cols)
>>> print(estimate.report())
>>> estimate.phasing_nm, estimate.ncpa_nm, estimate.info.phasing_sigma_nm

Images as a camera delivers them, with a deadline:

>>> model = cophase.Model("scene.toml")
>>> session = cophase.Session(model)
>>> fit = session.fit(frame, deadline_s=0.5)                                            # (rows, cols), or a stack
>>> segments_nm, ncpa_nm = model.wavefront_nm(fit.coefficients_nm)

Simulated exposures behind adaptive optics:

>>> simulator = cophase.Simulator("keck-onsky")
>>> simulator.step(100)
>>> simulator.info.residual_rms_nm, simulator.image_e.shape
"""

from ._library import devices, preset, scene_set, version
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
from .estimate import Correction, Estimate, ModelError, WithoutStaircases
from .estimator import Estimator, Progress
from .model import Model
from .sequence import Sequence, SequenceEstimate
from .session import Fit, RefinedFit, Session
from .session_factory import SessionFactory
from .simulator import Simulator

__all__ = [
    "BadArgumentError",
    "BadFileError",
    "BadImageError",
    "BadSceneError",
    "BadShapeError",
    "BadValueError",
    "BusyError",
    "Correction",
    "DeviceError",
    "Error",
    "Estimate",
    "Estimator",
    "Fit",
    "InternalError",
    "Interrupted",
    "Model",
    "ModelError",
    "PanicError",
    "Progress",
    "RefinedFit",
    "Sequence",
    "SequenceEstimate",
    "Session",
    "SessionFactory",
    "Simulator",
    "WithoutStaircases",
    "devices",
    "preset",
    "scene_set",
    "version",
]
__version__ = version()
