"""Sessions: fits of single images with a deadline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arrays import calibration, doubles, images, input_view, numbers, structs
from ._handle import Handle
from ._interrupt import interruptible
from ._library import check, ffi, lib, library_text, named, options, text
from .model import Model

_REPORT = "cophase_image_report"
_PRECISIONS = {None: 0, "f32": lib.COPHASE_F32, "f64": lib.COPHASE_F64}

#: Calls with a deadline up to this, s, need no Ctrl-C.
_SHORT_S = 0.1


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit. Its arrays have an axis of images in front if the frames were a stack.

    Attributes
    ----------
    coefficients_nm : (modes,) or (images, modes) array
        nm of wavefront; NaN for an unusable image.
    reports : () or (images,) record array
        ``status``, a number (:attr:`status` has its name); ``bad_pixels``, those that were marked; ``policy``, a
        number; ``evaluations`` of objective and gradient; ``reduced_chi2``, 1 where the model is right; ``flux_e`` of
        the star, electrons; ``background_e``, electrons per pixel; ``tip_nm`` and ``tilt_nm`` of the fitted wavefront
        along x and y, nm RMS; ``seconds`` of the fit; ``rejected_pixels``, outliers; ``is_used``, ``is_clipped`` and
        ``channel``, which are 0 in a session. Read as ``reports.flux_e``.
    """

    coefficients_nm: NDArray[np.float64]
    reports: np.recarray[Any, np.dtype[Any]]

    @property
    def status(self) -> NDArray[np.str_]:
        """Status of each image: ``OK``, ``MISFIT`` (fitted, but the residual is larger or smaller than the noise),
        ``WRONG_MINIMUM``, ``NOT_CONVERGED``, ``DEADLINE`` (the best so far) or ``UNUSABLE``."""
        status = self.reports["status"]
        return np.array([named("status", int(number)) for number in status.flat], np.str_).reshape(status.shape)


class Session(Handle):
    """Fits of single images with a model, in memory that is allocated when the session is created.

    It follows the policy ``"realtime"``: no modes with a prior, no restarts;
    :class:`cophase.Estimator` is the full pipeline. One call at a time (:class:`cophase.BusyError` otherwise), except
    :meth:`cancel`; other Python threads run during a call. The same frame gives the same bits, with any other frames
    in the call, in every language.

    Parameters
    ----------
    model : Model
        Model that is fitted.
    device : str, optional
        Name of a device, see :func:`cophase.devices`, or ``"auto"``; the scene's ``estimate.device`` by default.
    capacity : int
        Largest number of images of a call.
    precision : {"f64", "f32"}, optional
        ``"f32"`` takes half the memory and a third to half of the time, with errors of 0.02 nm; the scene's
        ``estimate.precision`` by default.
    threads : int
        Threads of the CPU: 1 for the caller's own, -1 for one per processor.
    max_evaluations : int, optional
        Largest number of evaluations for one image; the scene's by default.
    step_tolerance_nm : float, optional
        A fit stops where neither a coefficient nor the RMS of the wavefront would change by more than this; the scene's
        by default.

    Attributes
    ----------
    model : Model
        Model that is fitted.
    device, policy : str
        Device that the session runs on, and its policy.
    capacity : int
        Largest number of images of a call.

    Raises
    ------
    DeviceError
        If the device is absent or cannot run the model.
    BadValueError
        For an option out of range, and for a scene with ``estimate.optimizer = "bfgs"``.
    """

    _instead = "its memory is that of one process; a cophase.SessionFactory makes sessions in any"

    def __init__(
        self,
        model: Model,
        device: str | None = None,
        capacity: int = 1,
        precision: str | None = None,
        threads: int = 1,
        max_evaluations: int | None = None,
        step_tolerance_nm: float | None = None,
    ) -> None:
        if precision not in _PRECISIONS:
            raise ValueError(f"precision is {precision!r}: 'f32', 'f64' or None is accepted")
        name = None if device is None else ffi.new("char[]", text("device", device))
        chosen = options(
            "cophase_session_options",
            device=name,
            capacity=capacity,
            precision=_PRECISIONS[precision] or None,
            threads=threads,
            max_evaluations=max_evaluations,
            step_tolerance_nm=step_tolerance_nm,
        )
        self._own("cophase_session", lib.cophase_session_create, model._handle, chosen)
        self.model = model
        self.capacity = capacity
        self.device = self._text("DEVICE")
        self.policy = self._text("POLICY")

    def _summary(self) -> str:
        return f"{self.model.modes} modes, up to {self.capacity} images, on {self.device}"

    def _text(self, what: str, index: int = 0) -> str:
        return library_text(lib.cophase_session_text, self._handle, getattr(lib, f"COPHASE_TEXT_{what}"), index)

    def calibrate(
        self,
        dark: ArrayLike | None = None,
        flat: ArrayLike | None = None,
        bad: ArrayLike | None = None,
        gain_e: float | None = None,
        saturation: float | None = None,
    ) -> None:
        """Sets the calibration of the frames of later calls: electrons = (raw - dark) * gain / flat.

        Without arguments frames are electrons, as before the first call. The maps are copied.

        Parameters
        ----------
        dark : (rows, cols) array, optional
            Signal without light, raw units.
        flat : (rows, cols) array, optional
            Relative response, about 1.
        bad : (rows, cols) array, optional
            Bad pixels, which take no part, are not 0.
        gain_e : float, optional
            Electrons per raw unit; ``image.gain_e_per_adu`` of the scene by default, or 1.
        saturation : float, optional
            Raw value from which on a pixel is saturated, and bad.

        Raises
        ------
        BadValueError
            For bad pixels if the model reduces the sampling of frames, which would smear them: such a camera needs
            ``estimate.sampling = "native"`` in its scene.
        """
        camera = calibration(dark, flat, bad, gain_e, saturation)
        check(lib.cophase_session_calibrate(self._handle, camera.pointer))

    def fit(
        self,
        frames: ArrayLike,
        deadline_s: float | None = None,
        read_noise_e: float | None = None,
        start_nm: ArrayLike | None = None,
    ) -> Fit:
        """Fits the model to a frame, or to each frame of a stack.

        Ctrl-C cancels it within an evaluation. For that the fit runs in a thread of its own, which costs some tens of
        microseconds; not with a deadline of up to 0.1 s, after which Ctrl-C takes effect.

        Parameters
        ----------
        frames : (rows, cols) or (images, rows, cols) array
            Raw values, or electrons without a calibration; :attr:`cophase.Model.frame_shape`. Values that are not
            finite are bad pixels. The optical axis is on row ``rows // 2`` and column ``cols // 2``. Any strides;
            float32, float64, uint16, int32, uint8 and bool are read in place, other types are copied if NumPy casts
            them safely.
        deadline_s : float, optional
            Time for the whole call, s; images that are not done by then have the status ``DEADLINE``.
        read_noise_e : float, optional
            Read noise of a pixel, electrons RMS, 0 for none; the scene's by default.
        start_nm : (modes,) or (images, modes) array, optional
            Starts of the fits, nm; a flat wavefront by default.

        Raises
        ------
        BadShapeError
            For frames of another shape, or more than the capacity.
        Interrupted
            After :meth:`cancel`.
        """
        pixels = images("frames", frames)
        count, modes = pixels.shape[:-2], self.model.modes
        start = None if start_nm is None else doubles(numbers("start_nm", start_nm, *count, modes))
        chosen = options("cophase_fit_options", deadline_s=deadline_s, read_noise_e=read_noise_e, start_nm=start)
        coefficients_nm = np.empty((*count, modes))
        reports, pointer = structs(_REPORT, count)
        view, out, size = input_view(pixels), doubles(coefficients_nm), ffi.sizeof(_REPORT)

        def call() -> None:
            check(lib.cophase_session_fit(self._handle, view, chosen, out, modes, pointer, size))

        if deadline_s is not None and deadline_s <= _SHORT_S:
            call()
        else:
            interruptible(call, self.cancel)
        return Fit(coefficients_nm, reports)

    def cancel(self) -> None:
        """Makes the fit that is running in another thread, or else the next one, raise :class:`cophase.Interrupted`
        within one evaluation. Any thread may call it at any time."""
        check(lib.cophase_session_cancel(self._handle))

    def message(self, image: int = 0) -> str:
        """Reason of the status of an image of the last fit, a sentence."""
        return self._text("IMAGE_MESSAGE", image)

    @property
    def warnings(self) -> list[str]:
        """What to know before using the numbers, such as the loss of the device that ``"auto"`` chose, after which the
        CPU does the work. (A device that was named raises :class:`cophase.DeviceError` instead.)"""
        return self._text("WARNINGS").splitlines()

    def covariance_nm2(self, image: int = 0) -> NDArray[np.float64]:
        """Covariance ``(modes, modes)`` of the coefficients of an image of the last fit, nm^2.

        It is the noise's, scaled by the image's chi-square where the model misfits. It takes as long as some hundred
        evaluations. :class:`cophase.BadValueError` for an image that was not fitted.
        """
        modes = self.model.modes
        out = np.empty((modes, modes))
        check(lib.cophase_session_covariance_nm2(self._handle, image, doubles(out), modes))
        return out

    def evaluate(
        self, coefficients_nm: ArrayLike, frames: ArrayLike | None = None, read_noise_e: float | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Objective and gradient, for an optimizer of the caller's.

        The objective is the sum of weight * (flux * PSF + background - data)^2 over the pixels of each image, with the
        flux and background that minimize it and the weights that a fit begins with.

        Parameters
        ----------
        coefficients_nm : (modes,) or (images, modes) array
            nm of wavefront.
        frames : (rows, cols) or (images, rows, cols) array, optional
            As for :meth:`fit`; those of the last evaluation by default, if no fit came since.
        read_noise_e : float, optional
            Read noise of a pixel, electrons RMS, 0 for none, with frames only; the scene's by default.

        Returns
        -------
        objectives : () or (images,) array
        gradients : array of the shape of the coefficients
            Per nm.

        Raises
        ------
        BadImageError
            For a frame that cannot be used.
        BadValueError
            Without frames, if none are loaded.
        """
        modes = self.model.modes
        count = np.shape(coefficients_nm)[:-1][:1]
        given = numbers("coefficients_nm", coefficients_nm, *count, modes)
        pixels = None if frames is None else images("frames", frames)
        view = ffi.NULL if pixels is None else input_view(pixels)
        chosen = options("cophase_fit_options", read_noise_e=read_noise_e)
        objectives, gradients = np.empty(count), np.empty((*count, modes))
        outputs = (doubles(objectives), doubles(gradients))
        inputs = (view, chosen, doubles(given), objectives.size, modes)
        check(lib.cophase_session_evaluate(self._handle, *inputs, *outputs))
        return objectives, gradients
