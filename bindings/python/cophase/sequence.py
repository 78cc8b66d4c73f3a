"""Sequences: the running estimate of images that come one by one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from ._arrays import doubles
from ._handle import Handle
from ._library import check, ffi, lib, result, struct
from .model import Model
from .session import Session


@dataclass(frozen=True, eq=False)
class SequenceEstimate:
    """Running estimate of a sequence.

    Attributes
    ----------
    coefficients_nm : (modes,) array
        nm of wavefront.
    sigma_nm : (modes,) array
        Standard deviation of each coefficient, nm.
    covariance_nm2 : (modes, modes) array
        Covariance of the coefficients, nm^2.
    info : namespace
        ``images`` in the sequence, those that were ``used``, those ``clipped`` as outliers; ``phasing_rms_nm`` and its
        error bar ``phasing_sigma_nm``, ``ncpa_rms_nm`` and its ``ncpa_sigma_nm`` (RMS over the pupil);
        ``reduced_chi2``, the median of the images used.
    """

    coefficients_nm: NDArray[np.float64]
    sigma_nm: NDArray[np.float64]
    covariance_nm2: NDArray[np.float64]
    info: SimpleNamespace


class Sequence(Handle):
    """The last images that sessions of a model fitted, and their running estimate.

    Parameters
    ----------
    model : Model
        Model of the sessions whose images are pushed.
    capacity : int
        Number of images that are kept; the oldest are dropped beyond it.
    """

    def __init__(self, model: Model, capacity: int) -> None:
        self._modes = model.modes
        self._capacity = capacity
        self._own("cophase_sequence", lib.cophase_sequence_create, model._handle, capacity)

    def _summary(self) -> str:
        return f"{self._modes} modes, the last {self._capacity} images"

    def push(self, session: Session) -> None:
        """Adds all images of a session's last fit, of any status.

        Raises
        ------
        BadValueError
            For a session of another model.
        BusyError
            While the session fits in another thread.
        """
        if session._handle == ffi.NULL:  # which C reads as clear()
            session.cancel()
        check(lib.cophase_sequence_push(self._handle, session._handle))

    def clear(self) -> None:
        """Drops all images."""
        check(lib.cophase_sequence_push(self._handle, ffi.NULL))

    def estimate(self) -> SequenceEstimate:
        """Estimate so far: mean, clipped mean or median of the images as the scene says (``estimate.combine``).

        From eight images on, outliers are found by comparing images, and error bars are from the scatter between them.
        :class:`cophase.BadImageError` if no image was fitted.
        """
        modes = self._modes
        arrays = np.empty(modes), np.empty(modes), np.empty((modes, modes))
        inputs = (self._handle, *map(doubles, arrays), modes)
        info = struct("cophase_sequence_report", lib.cophase_sequence_estimate, *inputs)
        return SequenceEstimate(*arrays, info)

    def images_needed(self, phasing_nm: float = math.inf, ncpa_nm: float = math.inf) -> int:
        """Number of further images like those so far that bring both error bars (nm RMS over the pupil) down to these.

        0 if they are. Infinity asks nothing of an error bar.

        Raises
        ------
        BadImageError
            If no image was fitted.
        BadValueError
            If errors that all images share alone are larger.
        """
        return result("uint64_t", lib.cophase_sequence_images_needed, self._handle, phasing_nm, ncpa_nm)
