"""Phasing errors and non-common path aberrations of segmented telescopes.

The library ``libcophase`` in Python. Arrays are ``[row = y, col = x]``; units stand in the names: wavefronts ``_nm`` of
optical path difference, angles on the sky ``_mas``, signal ``_e`` (electrons), time ``_s``.

>>> import cophase
>>> simulator = cophase.Simulator(cophase.preset("keck-onsky"))
>>> simulator.step(100)
>>> simulator.residual_rms_nm, simulator.image_e.shape
"""

from ._library import Error, version
from .scene import preset
from .simulator import Simulator

__all__ = ["Error", "Simulator", "preset", "version"]
__version__ = version()
