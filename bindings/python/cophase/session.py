"""The workspace that images are fitted in."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arrays import images, input_view, numbers, record, values
from ._handle import Handle
from ._interrupt import interruptible
from ._library import check, ffi, lib, options, scalar, text, text_of, words
from .model import Model

_REPORT = record("cophase_report")
_PRECISIONS = {"f32": lib.COPHASE_F32, "f64": lib.COPHASE_F64}

#: Calls that end this soon by themselves need no Ctrl-C.
_SOON_S = 0.1


@dataclass(frozen=True, eq=False)
class Fit:
    """What a fit found. Its arrays have an axis of images in front if the frames were a stack.

    Attributes
    ----------
    coefficients_nm : (modes,) or (images, modes) array
        nm of wavefront; NaN for an image that could not be used.
    reports : () or (images,) record array
        ``status``, a number (:attr:`status` has its name); ``bad_pixels`` that took no part; ``evaluations`` of the
        model; ``reduced_chi2``, 1 where the model is right; ``flux_e`` of the star, electrons; ``background_e``, electrons
        per pixel; ``tip_nm`` and ``tilt_nm`` of the fitted wavefront along x and y, nm RMS; ``seconds`` that it took.
        Read as ``reports.flux_e``.
    """

    coefficients_nm: NDArray[np.float64]
    reports: np.recarray[Any, np.dtype[Any]]

    @property
    def status(self) -> NDArray[np.str_]:
        """What became of each image: ``OK``, ``MISFIT`` (fitted, with a residual larger than the noise),
        ``WRONG_MINIMUM``, ``NOT_CONVERGED``, ``DEADLINE`` (the best so far) or ``UNUSABLE``."""
        numbers = self.reports["status"]
        names = [words(lib.cophase_image_status_name(int(number))) for number in numbers.flat]
        return np.array(names, np.str_).reshape(numbers.shape)


class Session(Handle):
    """One thread's workspace to fit images in: making it pays every cost that comes once.

    One call at a time (:class:`cophase.BusyError` otherwise), but for :meth:`cancel`; other Python threads run on during
    a call. The same frame gives the same bits, whatever else is in the call, in every language.

    Parameters
    ----------
    model : Model
        What is fitted.
    device : str, optional
        A name of :func:`cophase.devices`, or ``"auto"``: a GPU where there is one. Without it, the CPU.
    capacity : int
        Most images of a call.
    precision : {"f64", "f32"}
        f32 takes half the memory and a third to half of the time, and costs some 0.02 nm.
    threads : int
        Of the CPU: 1 for the caller's own, 0 for all that there are.
    max_evaluations : int, optional
        Of the model, for one image; without it, what the scene says.
    step_tolerance_nm : float, optional
        A fit stops where neither a coefficient nor the RMS of the wavefront would move by more than this; without it,
        what the scene says.

    Raises
    ------
    DeviceError
        Where the device is not there, or cannot run the model.
    """

    def __init__(
        self,
        model: Model,
        device: str | None = None,
        capacity: int = 1,
        precision: str = "f64",
        threads: int = 1,
        max_evaluations: int | None = None,
        step_tolerance_nm: float | None = None,
    ) -> None:
        if precision not in _PRECISIONS:
            raise ValueError(f"precision is {precision!r}: {' or '.join(_PRECISIONS)} is accepted")
        how = options(
            "cophase_session_options",
            capacity=capacity,
            precision=_PRECISIONS[precision],
            threads=threads,
            max_evaluations=max_evaluations,
            step_tolerance_nm=step_tolerance_nm,
        )
        opened = scalar("cophase_device *", lib.cophase_device_open, text("device", device or "cpu"))
        try:
            self._device = text_of(lib.cophase_device_name, opened).partition("\t")[0]
            create, destroy = lib.cophase_session_create, lib.cophase_session_destroy
            self._own("cophase_session", destroy, create, opened, model._handle, how)
        finally:
            lib.cophase_device_close(opened)
        self._model = model
        self._modes = model.modes
        self._capacity = capacity
        self._precision = precision

    def _says(self) -> str:
        return f"{self._modes} modes, up to {self._capacity} images, {self._precision} on {self._device}"

    @property
    def model(self) -> Model:
        """What is fitted."""
        return self._model

    @property
    def device(self) -> str:
        """Name of the device that it runs on, one of :func:`cophase.devices`."""
        return self._device

    @property
    def capacity(self) -> int:
        """Most images of a call."""
        return self._capacity

    def calibrate(
        self,
        dark: ArrayLike | None = None,
        flat: ArrayLike | None = None,
        bad: ArrayLike | None = None,
        gain_e: float = 1.0,
        saturation: float = math.inf,
    ) -> None:
        """Says what the raw values of coming frames mean: electrons are (raw - dark) * gain / flat.

        Without arguments frames are electrons, as they are until the first call. The maps are copied.

        Parameters
        ----------
        dark : (rows, cols) array, optional
            Signal without light, raw units.
        flat : (rows, cols) array, optional
            Relative response, about 1.
        bad : (rows, cols) array, optional
            Pixels that are not 0 take no part.
        gain_e : float
            Electrons per raw unit.
        saturation : float
            Pixels that read as much or more take no part, raw units.

        Raises
        ------
        BadValueError
            For bad pixels where the model reduces frames to its own sampling, which would smear them: a scene with
            ``estimate.sampling = "native"`` does not.
        """
        given = {"dark": dark, "flat": flat, "bad": bad}
        # Held until the library has copied what they show.
        arrays = {name: images(name, array) for name, array in given.items() if array is not None}
        views = {name: input_view(array)[0] for name, array in arrays.items()}
        camera = options("cophase_calibration", gain_e=gain_e, saturation=saturation, **views)
        check(lib.cophase_session_calibrate(self._handle, camera))

    def fit(
        self,
        frames: ArrayLike,
        deadline_s: float | None = None,
        read_noise_e: float | None = None,
        start_nm: ArrayLike | None = None,
    ) -> Fit:
        """Fits the model to a frame, or to each frame of a stack.

        Ctrl-C cancels it within an evaluation of the model. For that it runs in a thread of its own, which costs some
        tens of microseconds; not so with a deadline of up to 0.1 s, which Ctrl-C then waits for.

        Parameters
        ----------
        frames : (rows, cols) or (images, rows, cols) array
            Raw values, or electrons where nothing was calibrated; :attr:`cophase.Model.frame_shape`. Values that are not
            finite are bad pixels. The optical axis is in row ``rows // 2`` and column ``cols // 2``. Any strides;
            float32, float64, uint16, int32, uint8 and bool are read where they are, other types are copied where NumPy
            calls that safe.
        deadline_s : float, optional
            Time for the whole call, s; images that are not done by then have the status ``DEADLINE``.
        read_noise_e : float, optional
            Read noise of a pixel, RMS electrons; without it, what the scene says.
        start_nm : (modes,) or (images, modes) array, optional
            Where the fits begin, nm; without it, at a flat wavefront.

        Raises
        ------
        BadShapeError
            For frames of another shape, or more than the session has room for.
        Interrupted
            After :meth:`cancel`.
        """
        pixels = images("frames", frames)
        count = pixels.shape[:-2]
        how = options("cophase_fit_options", deadline_s=deadline_s, read_noise_e=read_noise_e)
        if start_nm is not None:
            start = values(numbers("start_nm", start_nm, *count, self._modes))
            how.start_nm = start
        coefficients_nm = np.empty((*count, self._modes))
        reports = np.recarray(count, _REPORT)
        view, into = input_view(pixels), values(coefficients_nm)
        written = ffi.cast("cophase_report *", reports.ctypes.data)

        def call() -> None:
            fit = lib.cophase_session_fit
            check(fit(self._handle, view, how, into, self._modes, written, _REPORT.itemsize))

        if deadline_s is not None and deadline_s <= _SOON_S:
            call()
        else:
            interruptible(call, self.cancel)
        return Fit(coefficients_nm, reports)

    def cancel(self) -> None:
        """Makes the fit that is running in another thread, or else the next one, raise :class:`cophase.Interrupted`.

        The one call that is meant to race: within an evaluation of the model it has its effect.
        """
        check(lib.cophase_session_cancel(self._handle))

    def message(self, image: int = 0) -> str:
        """Why an image of the last fit has the status that it has, in a sentence."""
        return text_of(lib.cophase_session_image_message, self._handle, image)

    @property
    def device_failure(self) -> str:
        """That the device which ``"auto"`` chose was lost, and that the CPU has taken its place; empty where it was not.

        A device that was named raises :class:`cophase.DeviceError` instead.
        """
        return text_of(lib.cophase_session_device_failure, self._handle)

    def covariance_nm2(self, image: int = 0) -> NDArray[np.float64]:
        """Covariance ``(modes, modes)`` of the coefficients of an image of the last fit, nm^2.

        It is as the noise makes it, scaled by the image's chi squared where the model misfits. Takes as long as some
        hundred evaluations.

        Raises
        ------
        BadValueError
            For an image that was not fitted.
        """
        out = np.empty((self._modes, self._modes))
        check(lib.cophase_session_covariance_nm2(self._handle, image, values(out), self._modes))
        return out

    def load(self, frames: ArrayLike, read_noise_e: float | None = None) -> None:
        """Loads frames for :meth:`evaluate`, with the weights that a fit begins with. Arguments as for :meth:`fit`.

        Raises
        ------
        BadImageError
            Where a frame holds nothing to fit.
        """
        pixels = images("frames", frames)
        how = options("cophase_fit_options", read_noise_e=read_noise_e)
        check(lib.cophase_session_load(self._handle, input_view(pixels), how))

    def evaluate(self, coefficients_nm: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The objective and its gradient, for an optimizer of the caller's.

        The objective is the sum of weight * (flux * PSF + background - data)^2 over the pixels of each image that was
        loaded, flux and background being those that minimise it.

        Parameters
        ----------
        coefficients_nm : (modes,) or (images, modes) array
            nm of wavefront; as many images as were loaded.

        Returns
        -------
        objectives : () or (images,) array
        gradients : array of the shape of the coefficients
            Per nm.

        Raises
        ------
        BadValueError
            Before :meth:`load`.
        """
        count = np.shape(coefficients_nm)[:-1][:1]
        at = numbers("coefficients_nm", coefficients_nm, *count, self._modes)
        objectives, gradients = np.empty(count), np.empty((*count, self._modes))
        check(
            lib.cophase_session_evaluate(
                self._handle, values(at), objectives.size, self._modes, values(objectives), values(gradients)
            )
        )
        return objectives, gradients
