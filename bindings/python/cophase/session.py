"""Sessions: fits of images with a deadline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arrays import calibration, doubles, images, input_view, numbers, structs
from ._handle import Handle
from ._interrupt import interruptible
from ._library import check, ffi, lib, library_text, named, options, struct, text
from .errors import BadShapeError
from .model import Model

_IMAGE, _GROUP = "cophase_image_report", "cophase_group_report"
_PRECISIONS = {None: 0, "f32": lib.COPHASE_F32, "f64": lib.COPHASE_F64}

#: Calls with a deadline up to this, s, need no Ctrl-C.
_SHORT_S = 0.1


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit of groups: a group is one frame of each channel of the model, which is an image of a model with one channel.

    Its arrays have an axis of groups in front if the frames were stacks.

    Attributes
    ----------
    coefficients_nm : (modes,) or (groups, modes) array
        nm of wavefront; NaN for an unusable image. Of several channels the modes that they have in common; NaN unless all frames can
        be used and the fit converged.
    sigma_nm : array of the shape of the coefficients, or None
        Error bars (1 sigma) of the common modes of several channels, from the information at a flat wavefront with the flux and
        the noise of the frames. None with one channel: :meth:`Session.refine` has its covariance.
    reports : () or (groups,), with several channels (channels,) or (groups, channels) record array
        Of each image: ``status``, a number (:attr:`image_status` has its name); ``bad_pixels``, those that were marked; ``policy``, a
        number; ``evaluations`` of objective and gradient; ``reduced_chi2``, 1 where the model is right; ``flux_e`` of
        the star, electrons; ``background_e``, electrons per pixel; ``tip_nm`` and ``tilt_nm`` of the fitted wavefront
        along x and y, nm RMS; ``seconds`` of the fit; ``rejected_pixels``, outliers; ``is_used`` in the result of several channels;
        ``is_clipped``, 0; the number of its ``channel``. Read as ``reports.flux_e``.
    groups : () or (groups,) record array
        Of each group: ``status``, the number of the worst of its images (:attr:`status` has its name); ``is_contradictory``, whether
        the channels differ by more than their noise; ``reduced_chi2`` of their differences, 1 where they agree, and ``freedom``, its
        degrees of freedom; ``seconds`` of the fits.
    """

    coefficients_nm: NDArray[np.float64]
    sigma_nm: NDArray[np.float64] | None
    reports: np.recarray[Any, np.dtype[Any]]
    groups: np.recarray[Any, np.dtype[Any]]

    @property
    def status(self) -> NDArray[np.str_]:
        """Status of each group, the worst of its images: ``OK``, ``MISFIT`` (fitted, but the residual is larger or smaller than the
        noise), ``WRONG_MINIMUM``, ``NOT_CONVERGED``, ``DEADLINE`` (the best so far) or ``UNUSABLE``."""
        return _status(self.groups)

    @property
    def image_status(self) -> NDArray[np.str_]:
        """Status of each image."""
        return _status(self.reports)


def _status(reports: np.recarray[Any, np.dtype[Any]]) -> NDArray[np.str_]:
    """Names of the statuses of some reports."""
    status = reports["status"]
    return np.array([named("status", int(number)) for number in status.flat], np.str_).reshape(status.shape)


@dataclass(frozen=True, eq=False)
class RefinedFit:
    """Result of a group with its covariance.

    Attributes
    ----------
    coefficients_nm : (modes,) array
        nm of wavefront.
    covariance_nm2 : (modes, modes) array
        Its covariance.
    status : str
        The worst status of the images of the group, as :attr:`Fit.status` has them.
    is_contradictory : bool
        Whether the channels differ by more than their noise.
    reduced_chi2, freedom : float
        Chi-square per degree of freedom of the differences of the channels, 1 where they agree, and its degrees of freedom; NaN and 0
        with one channel.
    piston_probability : float
        The smallest probability of the whole wavelengths of a piston; NaN where they were not sought.
    """

    coefficients_nm: NDArray[np.float64]
    covariance_nm2: NDArray[np.float64]
    status: str
    is_contradictory: bool
    reduced_chi2: float
    freedom: float
    piston_probability: float

    @property
    def sigma_nm(self) -> NDArray[np.float64]:
        """Error bars (1 sigma) of the coefficients."""
        return np.sqrt(np.maximum(self.covariance_nm2.diagonal(), 0.0))


class Session(Handle):
    """Fits of images with a model, in memory that is allocated when the session is created.

    A frame of each channel of the model is a group, which sees one wavefront: its frames are fitted together, with the modes in
    common and each its own tip, tilt, flux and background.

    It follows the policy ``"realtime"``: no modes with a prior, but for channels none of which determines the wavefront by itself,
    no restarts; :class:`cophase.Estimator` is the full pipeline. One call at a time (:class:`cophase.BusyError` otherwise), except
    :meth:`cancel`; other Python threads run during a call. The same group gives the same bits, with any other groups
    in the call, in every language.

    Parameters
    ----------
    model : Model
        Model that is fitted.
    device : str, optional
        Name of a device, see :func:`cophase.devices`, or ``"auto"``; the scene's ``estimate.device`` by default.
    capacity : int
        Largest number of groups of a call, which are images with one channel.
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
    channels : list of str
        Names of its channels, in order; one empty name for a scene that lists none.
    device, policy : str
        Device that the session runs on, and its policy.
    capacity : int
        Largest number of groups of a call.

    Raises
    ------
    DeviceError
        If the device is absent or cannot run the model.
    BadValueError
        For an option out of range, and for a scene with ``estimate.optimizer = "bfgs"``.
    BadSceneError
        For several channels of which one is in focus, which :class:`cophase.Estimator` takes.
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
        self.channels = model.channels
        self.capacity = capacity
        self.device = self._text("DEVICE")
        self.policy = self._text("POLICY")

    def _summary(self) -> str:
        images = "images" if len(self.channels) == 1 else f"groups of {', '.join(self.channels)}"
        return f"{self.model.modes} modes, up to {self.capacity} {images}, on {self.device}"

    def _text(self, what: str, index: int = 0) -> str:
        return library_text(lib.cophase_session_text, self._handle, getattr(lib, f"COPHASE_TEXT_{what}"), index)

    def calibrate(
        self,
        dark: ArrayLike | None = None,
        flat: ArrayLike | None = None,
        bad: ArrayLike | None = None,
        gain_e: float | None = None,
        saturation: float | None = None,
        channel: str | int = 0,
    ) -> None:
        """Sets the calibration of later frames of a channel: electrons = (raw - dark) * gain / flat.

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
        channel : str or int
            Name or number of the channel.

        Raises
        ------
        BadValueError
            For bad pixels if the model reduces the sampling of frames, which would smear them: such a camera needs
            ``estimate.sampling = "native"`` in its scene.
        """
        camera = calibration(dark, flat, bad, gain_e, saturation)
        check(lib.cophase_session_calibrate(self._handle, self.model._number(channel), camera.pointer))

    def fit(
        self,
        frames: ArrayLike | Mapping[str, ArrayLike] | Sequence[ArrayLike],
        deadline_s: float | None = None,
        read_noise_e: float | None = None,
        start_nm: ArrayLike | None = None,
    ) -> Fit:
        """Fits the model to a frame, or to each frame of a stack; with several channels, to one of each together.

        Ctrl-C cancels it within an evaluation. For that the fit runs in a thread of its own, which costs some tens of
        microseconds; not with a deadline of up to 0.1 s, after which Ctrl-C takes effect.

        Parameters
        ----------
        frames : (rows, cols) or (groups, rows, cols) array; with several channels a mapping or a sequence of such arrays
            Raw values, or electrons without a calibration; :attr:`cophase.Model.frame_shape`. Values that are not
            finite are bad pixels. The optical axis is on row ``rows // 2`` and column ``cols // 2``. Any strides;
            float32, float64, uint16, int32, uint8 and bool are read in place, other types are copied if NumPy casts
            them safely. A mapping has the frames of each channel by its name, a sequence in the order of :attr:`channels`.
        deadline_s : float, optional
            Time for the whole call, s; images that are not done by then have the status ``DEADLINE``.
        read_noise_e : float, optional
            Read noise of a pixel, electrons RMS, 0 for none; each channel's own by default.
        start_nm : (modes,) or (groups, modes) array, optional
            Starts of the fits, nm, each for all channels; a flat wavefront by default.

        Raises
        ------
        BadShapeError
            For frames of another shape, of other channels, or more than the capacity.
        Interrupted
            After :meth:`cancel`.
        """
        pixels = [images("frames", frame) for frame in self._by_channel(frames)]
        count, modes, channels = pixels[0].shape[:-2], self.model.modes, len(pixels)
        start = None if start_nm is None else doubles(numbers("start_nm", start_nm, *count, modes))
        chosen = options("cophase_fit_options", deadline_s=deadline_s, read_noise_e=read_noise_e, start_nm=start)
        coefficients_nm = np.empty((*count, modes))
        sigma_nm = None if channels == 1 else np.empty_like(coefficients_nm)
        reports, images_pointer = structs(_IMAGE, count if channels == 1 else (*count, channels))
        groups, groups_pointer = structs(_GROUP, count)
        views = ffi.new("cophase_input[]", [input_view(one)[0] for one in pixels])
        modes_out = (doubles(coefficients_nm), ffi.NULL if sigma_nm is None else doubles(sigma_nm), modes)
        reports_out = (images_pointer, ffi.sizeof(_IMAGE), groups_pointer, ffi.sizeof(_GROUP))

        def call() -> None:
            check(lib.cophase_session_fit(self._handle, views, channels, chosen, *modes_out, *reports_out))

        if deadline_s is not None and deadline_s <= _SHORT_S:
            call()
        else:
            interruptible(call, self.cancel)
        return Fit(coefficients_nm, sigma_nm, reports, groups)

    def _by_channel(self, frames: Any) -> list[Any]:
        """The frames of each channel, in order."""
        if isinstance(frames, Mapping):
            if set(frames) != set(self.channels):
                raise BadShapeError(f"frames has the channels {sorted(frames)}: those of the model, {self.channels}, are accepted")
            return [frames[name] for name in self.channels]
        if len(self.channels) == 1:
            return [frames]
        if len(frames) != len(self.channels):
            raise BadShapeError(f"frames has {len(frames)} channels: {len(self.channels)} are accepted, {self.channels}")
        return list(frames)

    def cancel(self) -> None:
        """Makes the fit that is running in another thread, or else the next one, raise :class:`cophase.Interrupted`
        within one evaluation. Any thread may call it at any time."""
        check(lib.cophase_session_cancel(self._handle))

    def message(self, group: int = 0, channel: str | int = 0) -> str:
        """Reason of the status of an image of the last fit, a sentence: that of a group, which is an image with one channel, in a
        channel."""
        return self._text("IMAGE_MESSAGE", group * len(self.channels) + self.model._number(channel))

    @property
    def warnings(self) -> list[str]:
        """What to know before using the numbers, such as the loss of the device that ``"auto"`` chose, after which the
        CPU does the work (a device that was named raises :class:`cophase.DeviceError` instead), and channels that contradict each
        other in the last fit."""
        return self._text("WARNINGS").splitlines()

    def refine(self, group: int = 0) -> RefinedFit:
        """Result of a group of the last fit, which is an image with one channel, with its covariance.

        It takes as long as some hundred evaluations of each channel. With one channel the covariance is the noise's, scaled by the
        image's chi-square where the model misfits. Of several channels it is from the information at the fitted wavefront, with the
        whole wavelengths of pistons found: the estimate of :class:`cophase.Estimator` with the policy ``"realtime"``.
        :class:`cophase.BadValueError` for a group that was not fitted, and unless the fit of several channels converged.
        """
        modes = self.model.modes
        coefficients_nm, covariance_nm2 = np.empty(modes), np.empty((modes, modes))
        inputs = (self._handle, group, doubles(coefficients_nm), doubles(covariance_nm2), modes)
        report = vars(struct(_GROUP, lib.cophase_session_refine, *inputs))
        del report["seconds"]
        return RefinedFit(coefficients_nm, covariance_nm2, **report)

    def evaluate(
        self,
        coefficients_nm: ArrayLike,
        frames: ArrayLike | None = None,
        read_noise_e: float | None = None,
        channel: str | int = 0,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Objective and gradient, for an optimizer of the caller's.

        The objective is the sum of weight * (flux * PSF + background - data)^2 over the pixels of each image, with the
        flux and background that minimize it and the weights that a fit begins with.

        Parameters
        ----------
        coefficients_nm : (modes,) or (images, modes) array
            nm of wavefront.
        frames : (rows, cols) or (images, rows, cols) array, optional
            Of the channel; those of its last evaluation by default, if no fit came since.
        read_noise_e : float, optional
            Read noise of a pixel, electrons RMS, 0 for none, with frames only; the scene's by default.
        channel : str or int
            Name or number of the channel.

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
        inputs = (self.model._number(channel), view, chosen, doubles(given), objectives.size, modes)
        check(lib.cophase_session_evaluate(self._handle, *inputs, *outputs))
        return objectives, gradients
