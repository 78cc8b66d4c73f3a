"""Images that come one by one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ._arrays import record, values
from ._handle import Handle
from ._library import check, ffi, lib, scalar
from .model import Model
from .session import Session

_REPORT = record("cophase_sequence_report")


@dataclass(frozen=True, eq=False)
class Estimate:
    """What the images of a sequence say together.

    Attributes
    ----------
    coefficients_nm : (modes,) array
        nm of wavefront.
    sigma_nm : (modes,) array
        Their error bars, 1 sigma.
    report : record
        ``images`` that are kept, those that were ``used``, those ``clipped`` as outliers; ``phasing_rms_nm`` and its error
        bar ``phasing_sigma_nm``, ``ncpa_rms_nm`` and its ``ncpa_sigma_nm`` (RMS over the pupil); ``reduced_chi2``, the
        median of the images used. Read as ``report.used``.
    """

    coefficients_nm: NDArray[np.float64]
    sigma_nm: NDArray[np.float64]
    report: np.record


class Sequence(Handle):
    """The running static estimate of images that come one by one.

    Parameters
    ----------
    model : Model
        Of the sessions whose images are pushed.
    capacity : int
        How many images are kept; the oldest make way.
    """

    def __init__(self, model: Model, capacity: int) -> None:
        self._modes = model.modes
        self._capacity = capacity
        create, destroy = lib.cophase_sequence_create, lib.cophase_sequence_destroy
        self._own("cophase_sequence", destroy, create, model._handle, capacity)

    def _says(self) -> str:
        return f"{self._modes} modes, the last {self._capacity} images"

    def push(self, session: Session) -> None:
        """Takes all images of a session's last fit, whatever became of them.

        Raises
        ------
        BadValueError
            For a session of another model.
        BusyError
            While the session fits in another thread.
        """
        check(lib.cophase_sequence_push(self._handle, session._handle))

    def clear(self) -> None:
        """Forgets all images."""
        check(lib.cophase_sequence_clear(self._handle))

    def estimate(self) -> Estimate:
        """The static estimate so far: mean or median of the images as the scene says (``estimate.combine``).

        Up to seven images are judged one by one; from eight on by one another, and error bars are from the scatter
        between them.

        Raises
        ------
        BadImageError
            Where no image was fitted yet.
        """
        coefficients_nm, sigma_nm = np.empty(self._modes), np.empty(self._modes)
        report = np.recarray(1, _REPORT)
        check(
            lib.cophase_sequence_estimate(
                self._handle,
                values(coefficients_nm),
                values(sigma_nm),
                self._modes,
                ffi.cast("cophase_sequence_report *", report.ctypes.data),
                _REPORT.itemsize,
            )
        )
        return Estimate(coefficients_nm, sigma_nm, report[0])

    def covariance_nm2(self) -> NDArray[np.float64]:
        """Covariance ``(modes, modes)`` of the estimate so far, nm^2.

        Raises
        ------
        BadImageError
            Where no image was fitted yet.
        """
        out = np.empty((self._modes, self._modes))
        check(lib.cophase_sequence_covariance_nm2(self._handle, values(out), self._modes))
        return out

    def images_needed(self, phasing_nm: float = math.inf, ncpa_nm: float = math.inf) -> int:
        """How many further images like those so far bring both error bars down to these, nm RMS over the pupil.

        0 where they are there. Infinity asks nothing.

        Raises
        ------
        BadImageError
            Where no image was fitted yet.
        """
        return scalar("uint64_t", lib.cophase_sequence_images_needed, self._handle, phasing_nm, ncpa_nm)
