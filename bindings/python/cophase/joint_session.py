"""Sessions of several channels: fits of one frame of each, and what they have in common."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arrays import calibration, doubles, images, input_view, numbers, structs
from ._handle import Handle
from ._interrupt import interruptible
from ._library import check, ffi, lib, library_text, named, options, path_text, read_scene, result, text
from .model import Model
from .session import _PRECISIONS, _SHORT_S

_REPORT, _IMAGE_REPORT = "cophase_joint_report", "cophase_image_report"


@dataclass(frozen=True, eq=False)
class JointFit:
    """Joint result of one frame of each channel.

    Attributes
    ----------
    coefficients_nm, sigma_nm : (modes,) array
        Common modes, nm of wavefront, and their error bars (1 sigma); NaN unless the fits of all channels converged. From
        :meth:`JointSession.refine` ``sigma_nm`` is the root of the diagonal of ``covariance_nm2``.
    status : str
        The worst status of the channels, as :attr:`cophase.Fit.status` has them.
    is_contradictory : bool
        Whether the channels differ by more than their noise.
    reduced_chi2, freedom : float
        Chi-square per degree of freedom of the differences of the channels, 1 where they agree, and its degrees of freedom.
    piston_probability : float
        The smallest probability of the whole wavelengths of a piston; NaN where they were not sought.
    seconds : float
        Duration of the fit; NaN of a refinement.
    reports : (channels,) record array
        Report on each channel's own fit, as :attr:`cophase.Fit.reports`.
    covariance_nm2 : (modes, modes) array or None
        Of a refinement.
    """

    coefficients_nm: NDArray[np.float64]
    sigma_nm: NDArray[np.float64]
    status: str
    is_contradictory: bool
    reduced_chi2: float
    freedom: float
    piston_probability: float
    seconds: float
    reports: np.recarray[Any, np.dtype[Any]] | None = None
    covariance_nm2: NDArray[np.float64] | None = None


class JointSession(Handle):
    """Fits of one frame of each channel of a scene, and their combination, in memory that is allocated beforehand.

    Each channel (``[[image.channel]]`` in the scene) is fitted as a :class:`cophase.Session` fits a frame, to the same bits,
    by the policy ``"realtime"``. One call at a time (:class:`cophase.BusyError` otherwise), except :meth:`cancel`.

    Parameters
    ----------
    scene : str or path
        Scene with channels: a TOML file, the name of a preset such as ``"keck-pair"``, or TOML text.
    device, precision, threads, max_evaluations, step_tolerance_nm : optional
        As for :class:`cophase.Session`.
    directory : path, optional
        Directory of the files that the scene names; that of the scene's file, or else the working directory, by default.

    Attributes
    ----------
    channels : list of str
        Names of the channels, in the order of the scene.
    models : list of Model
        Model of each channel: the size of its frames, and the modes, which all have in common.
    modes : int
        Number of modes.
    device, policy : str
        Device that the session runs on, and its policy.

    Raises
    ------
    BadSceneError
        For a scene without channels, or with a channel in focus, which :class:`cophase.Estimator` takes.
    """

    def __init__(
        self,
        scene: str | os.PathLike[str],
        device: str | None = None,
        precision: str | None = None,
        threads: int = 1,
        max_evaluations: int | None = None,
        step_tolerance_nm: float | None = None,
        directory: str | os.PathLike[str] | None = None,
    ) -> None:
        if precision not in _PRECISIONS:
            raise ValueError(f"precision is {precision!r}: 'f32', 'f64' or None is accepted")
        name = None if device is None else ffi.new("char[]", text("device", device))
        chosen = options(
            "cophase_session_options",
            device=name,
            precision=_PRECISIONS[precision] or None,
            threads=threads,
            max_evaluations=max_evaluations,
            step_tolerance_nm=step_tolerance_nm,
        )
        scene_text, directory = read_scene(scene, directory)
        inputs = (text("scene", scene_text), path_text("directory", directory), chosen)
        self._own("cophase_joint_session", lib.cophase_joint_session_create, *inputs)
        count: int = result("size_t", lib.cophase_joint_session_channels, self._handle)
        self.channels = [self._text("CHANNEL_NAME", channel) for channel in range(count)]
        self.models = [
            Model._of(lib.cophase_joint_session_model, self._handle, channel) for channel in range(count)
        ]
        self.modes = self.models[0].modes
        self.device = self._text("DEVICE")
        self.policy = self._text("POLICY")

    def _summary(self) -> str:
        return f"{self.modes} modes, channels {', '.join(self.channels)}, on {self.device}"

    def _text(self, what: str, index: int = 0) -> str:
        return library_text(lib.cophase_joint_session_text, self._handle, getattr(lib, f"COPHASE_TEXT_{what}"), index)

    def _number(self, channel: str | int) -> int:
        """The number of a channel."""
        if not isinstance(channel, str):
            return channel
        if channel not in self.channels:
            raise ValueError(f"the channel is {channel!r}: one of {self.channels} is accepted")
        return self.channels.index(channel)

    def calibrate(
        self,
        channel: str | int,
        dark: ArrayLike | None = None,
        flat: ArrayLike | None = None,
        bad: ArrayLike | None = None,
        gain_e: float | None = None,
        saturation: float | None = None,
    ) -> None:
        """Sets the calibration of later frames of a channel, by its name or number; as :meth:`cophase.Session.calibrate`."""
        camera = calibration(dark, flat, bad, gain_e, saturation)
        check(lib.cophase_joint_session_calibrate(self._handle, self._number(channel), camera.pointer))

    def fit(
        self,
        frames: Mapping[str, ArrayLike] | Sequence[ArrayLike],
        deadline_s: float | None = None,
        read_noise_e: float | None = None,
        start_nm: ArrayLike | None = None,
    ) -> JointFit:
        """Fits one frame of each channel, and combines the fits.

        Parameters
        ----------
        frames : mapping or sequence of (rows, cols) arrays
            The frame of each channel, by its name; or a list in the order of the scene. Each as for
            :meth:`cophase.Session.fit`.
        deadline_s : float, optional
            Time for all channels together, s.
        read_noise_e : float, optional
            Read noise of a pixel, electrons RMS, 0 for none; each channel's own by default.
        start_nm : (modes,) array, optional
            Start of the fits, nm; a flat wavefront by default.

        Raises
        ------
        BadShapeError
            For frames of other channels than the scene has, or of another shape.
        Interrupted
            After :meth:`cancel`.
        """
        if isinstance(frames, Mapping):
            if set(frames) != set(self.channels):
                raise ValueError(f"frames has the channels {sorted(frames)}: those of the scene, {self.channels}, are accepted")
            frames = [frames[name] for name in self.channels]
        pixels = [images("frames", frame) for frame in frames]
        views = ffi.new("cophase_input[]", [input_view(one)[0] for one in pixels])
        start = None if start_nm is None else doubles(numbers("start_nm", start_nm, self.modes))
        chosen = options("cophase_fit_options", deadline_s=deadline_s, read_noise_e=read_noise_e, start_nm=start)
        coefficients_nm, sigma_nm = np.empty(self.modes), np.empty(self.modes)
        reports, pointer = structs(_IMAGE_REPORT, (len(self.channels),))
        report = ffi.new(f"{_REPORT} *")
        outputs = (doubles(coefficients_nm), doubles(sigma_nm), self.modes, report, ffi.sizeof(_REPORT))

        def call() -> None:
            inputs = (self._handle, views, len(pixels), chosen)
            check(lib.cophase_joint_session_fit(*inputs, *outputs, pointer, ffi.sizeof(_IMAGE_REPORT)))

        if deadline_s is not None and deadline_s <= _SHORT_S:
            call()
        else:
            interruptible(call, self.cancel)
        return JointFit(coefficients_nm, sigma_nm, **_fields(report), reports=reports)

    def refine(self) -> JointFit:
        """Combines the last fits by their information at the fitted wavefronts, with the covariance of the modes, and finds the
        whole wavelengths of pistons: the estimate of :class:`cophase.Estimator` with the policy ``"realtime"``.

        It takes as long as some hundred evaluations of each channel. :class:`cophase.BadValueError` unless the last fits of all
        channels converged.
        """
        coefficients_nm, covariance_nm2 = np.empty(self.modes), np.empty((self.modes, self.modes))
        report = ffi.new(f"{_REPORT} *")
        outputs = (doubles(coefficients_nm), doubles(covariance_nm2), self.modes, report, ffi.sizeof(_REPORT))
        check(lib.cophase_joint_session_refine(self._handle, *outputs))
        sigma_nm = np.sqrt(np.maximum(covariance_nm2.diagonal(), 0.0))
        return JointFit(coefficients_nm, sigma_nm, **_fields(report), covariance_nm2=covariance_nm2)

    def cancel(self) -> None:
        """Makes the fit that is running in another thread, or else the next one, raise :class:`cophase.Interrupted`
        within one evaluation. Any thread may call it at any time."""
        check(lib.cophase_joint_session_cancel(self._handle))

    def message(self, channel: str | int = 0) -> str:
        """Reason of the status of a channel's last fit, a sentence."""
        return self._text("IMAGE_MESSAGE", self._number(channel))

    @property
    def warnings(self) -> list[str]:
        """What to know before using the numbers: on devices and models, and on channels that contradict each other in the last
        fit."""
        return self._text("WARNINGS").splitlines()


def _fields(report: Any) -> dict[str, Any]:
    """The fields of a report in Python."""
    return {name: named(name, getattr(report, name)) for name, _ in ffi.typeof(_REPORT).fields}
