"""Estimators: the full pipeline, from the images of one scene to one estimate."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arrays import Inputs, calibration, images, input_view
from ._handle import Handle
from ._interrupt import interruptible
from ._library import absolute, check, constants, ffi, lib, options, path_text, read_scene, text
from .errors import BadShapeError
from .estimate import Estimate

_POLICIES = {name: number for number, name in constants("COPHASE_POLICY_").items()}
_STAGES = constants("COPHASE_STAGE_")


class _Options:
    """Options of the images of one channel, with the arrays that they point to."""

    def __init__(self, camera: Inputs, read_noise_e: float | None) -> None:
        self._camera = camera
        self.pointer = options("cophase_estimate_options", calibration=camera.pointer, read_noise_e=read_noise_e)


def _slopes(slopes_mas: ArrayLike | None) -> Any:
    """Telemetry as an array of the library; None without."""
    if slopes_mas is None:
        return None
    slopes = images("slopes_mas", slopes_mas)
    if slopes.ndim != 2:
        raise BadShapeError(f"slopes_mas has the shape {slopes.shape}: [image, slope] is accepted")
    return slopes


def _images(
    frames: ArrayLike, mask: ArrayLike | None, read_noise_e: float | None, gain_e: float | None, **calibrations: Any
) -> tuple[NDArray[Any], _Options]:
    """Frames as the library reads them, and the options of an estimate from them."""
    pixels = images("frames", frames)
    if mask is not None:
        mask = images("mask", mask)
        if mask.ndim == 3:
            # C has one map of bad pixels for all images; in single images, values that are not finite are bad.
            if mask.shape != pixels.shape:
                raise BadShapeError(f"mask has the shape {mask.shape}: {pixels.shape}, that of frames, is accepted")
            if len(mask) > 0 and np.array_equal(mask != 0, np.broadcast_to(mask[0] != 0, mask.shape)):
                mask = mask[0]
            else:
                pixels, mask = np.where(mask != 0, np.nan, pixels), None
    return pixels, _Options(calibration(bad=mask, gain_e=gain_e, **calibrations), read_noise_e)


class Progress(NamedTuple):
    """Progress of an estimate.

    Attributes
    ----------
    stage : str
        ``"idle"`` (no estimate is running), ``"planning"``, ``"preparing"``, ``"fitting"``, ``"combining"``, or, in a
        MAP estimate, ``"retrieving"``, ``"separating"``.
    done, total : int
        Steps (images) of this stage that are done, and their number, 0 if it is unknown.
    """

    stage: str
    done: int
    total: int


class Estimator(Handle):
    """The full pipeline for images of one scene, the same as ``cophase estimate``; the results are the same to the bit.

    The scene's ``estimate.method`` says whether the estimate is modal or maximum a posteriori (MAP, ``"full-phase"``:
    the wavefront behind each exposure, static errors separated from the turbulence). An estimator can be used again and
    again, and keeps its model, unless a file that the scene names changes. One call at a time
    (:class:`cophase.BusyError` otherwise), except :meth:`cancel` and :attr:`progress`; other Python threads run during
    a call. It pickles as these parameters, and is built again where it is unpickled.

    Parameters
    ----------
    scene : str or path
        Scene: a TOML file, the name of a preset (:func:`cophase.preset`), or TOML text. With
        ``estimate.budget_nm`` the model is planned here, which takes some seconds.
    policy : {"full", "realtime"}
        ``"full"``: modes with a prior, a search for outlier pixels, restarts, optics fitted if the scene asks for it, a
        larger model where the scene does not explain the images (``estimate.model``).
        ``"realtime"``: one fit of the scene's modes, no retries, as a :class:`cophase.Session` does.
    threads : int, optional
        Number of threads, at most 64 or four for each processor; one per processor by default. Results do not depend on it.
    directory : path, optional
        Directory of the files that the scene names; that of the scene's file, or else the working directory, by default.

    Raises
    ------
    BadSceneError
        With line, key, value and what is accepted: also for keys that the policy does not honour.

    Examples
    --------
    >>> estimator = cophase.Estimator("scene.toml")
    >>> estimate = estimator.estimate(frames)
    >>> print(estimate.report())

    Progress of an estimate that runs in another thread:

    >>> with concurrent.futures.ThreadPoolExecutor() as pool:
    ...     future = pool.submit(estimator.estimate, frames)
    ...     while not future.done():
    ...         print(estimator.progress)
    ...         time.sleep(1)
    """

    def __init__(
        self,
        scene: str | os.PathLike[str],
        policy: str = "full",
        threads: int | None = None,
        directory: str | os.PathLike[str] | None = None,
    ) -> None:
        if policy not in _POLICIES:
            raise ValueError(f"policy is {policy!r}: {' or '.join(map(repr, _POLICIES))} is accepted")
        chosen = options("cophase_estimator_options", threads=threads)
        chosen.policy = _POLICIES[policy]
        scene_text, directory = read_scene(scene, directory)
        inputs = (text("scene", scene_text), path_text("directory", directory), chosen)
        self._own("cophase_estimator", lib.cophase_estimator_create, *inputs)
        self._policy = policy
        self._recipe = (type(self), (scene_text, policy, threads, absolute(directory)))

    def _summary(self) -> str:
        return f"policy {self._policy}, {self.progress.stage}"

    def estimate(
        self,
        frames: ArrayLike | Mapping[str, ArrayLike] | Sequence[ArrayLike],
        mask: Any = None,
        slopes_mas: Any = None,
        read_noise_e: Any = None,
        *,
        dark: Any = None,
        flat: Any = None,
        gain_e: Any = None,
        saturation: Any = None,
    ) -> Estimate:
        """Estimates the static wavefront behind images: of one channel, or of several (defocuses, wavelengths).

        Ctrl-C cancels it, within a second or two at the size of Keck.

        electrons = (raw - dark) * gain / flat; without dark, flat and gain, frames are electrons.

        The images of several channels (``[[image.channel]]``) are a mapping by the names of the channels, or a list in the
        order of the scene. An option is then that of all, or a mapping by the names (by the positions in a list) of those
        channels that have one.

        Parameters
        ----------
        frames : (rows, cols) or (images, rows, cols) array, or a mapping or list of such arrays
            Images of the same static errors, two or more for a MAP estimate, of the size that the scene says; of those
            with one row or column more the last is left out. Values that are not finite are bad pixels. The optical
            axis is on row ``rows // 2`` and column ``cols // 2``. Any strides; float32, float64, uint16, int32, uint8
            and bool are read in place, other types are copied if NumPy casts them safely.
        mask : (rows, cols) or (images, rows, cols) array, optional
            Bad pixels, which take no part, are not 0: of all images, or of each.
        slopes_mas : (images, slopes) array, optional
            Telemetry of a MAP estimate: slopes of the wavefront sensor, mean over each exposure, mas, along x for every
            subaperture, then along y; NaN for all of an image without telemetry. Used where every channel has them.
        read_noise_e : float, optional
            Read noise of a pixel, electrons RMS, 0 for none; the scene's by default.
        dark : (rows, cols) array, optional
            Signal without light, raw units.
        flat : (rows, cols) array, optional
            Relative response, about 1.
        gain_e : float, optional
            Electrons per raw unit; ``image.gain_e_per_adu`` of the scene by default, or 1.
        saturation : float, optional
            Raw value from which on a pixel is saturated, and bad.

        Raises
        ------
        BadShapeError
            For images of other channels than the scene has, and for frames, slopes or maps of another shape.
        BadImageError
            If no image can be used (fewer than two in a MAP estimate).
        BadSceneError, BadFileError
            If the telescope cannot be built.
        DeviceError
            If the device that the scene names is absent or fails.
        Interrupted
            After :meth:`cancel`.

        Examples
        --------
        >>> estimator = cophase.Estimator(cophase.preset("keck-pair"))
        >>> estimate = estimator.estimate({"plus": plus_e, "minus": minus_e})
        """
        given = {
            "mask": mask,
            "slopes_mas": slopes_mas,
            "read_noise_e": read_noise_e,
            "dark": dark,
            "flat": flat,
            "gain_e": gain_e,
            "saturation": saturation,
        }
        is_named = isinstance(frames, Mapping)
        each: Any = frames if isinstance(frames, (Mapping, list, tuple)) else [frames]
        keys: list[Any] = list(each) if is_named else list(range(len(each)))
        for name, value in given.items():
            if isinstance(value, Mapping) and not set(value) <= set(keys):
                odd = sorted(set(value) - set(keys), key=str)
                raise ValueError(f"{name} has the channels {odd}: {keys}, those of frames, are accepted")
        channels, kept = ffi.new("cophase_channel_images[]", len(keys)), []
        for channel, key in zip(channels, keys):
            own = {name: value.get(key) if isinstance(value, Mapping) else value for name, value in given.items()}
            slopes = _slopes(own.pop("slopes_mas"))
            pixels, chosen = _images(each[key], **own)
            view, slope_view = input_view(pixels), ffi.NULL if slopes is None else input_view(slopes)
            channel.frames, channel.options, channel.slopes_mas = view, chosen.pointer, slope_view
            kept += [pixels, chosen, view, slopes, slope_view]
            if is_named:
                kept.append(ffi.new("char[]", text("the name of a channel", key)))
                channel.channel = kept[-1]
        out = ffi.new("cophase_estimate **")

        def call() -> None:
            check(lib.cophase_estimator_estimate(self._handle, channels, len(keys), out))

        interruptible(call, self.cancel)
        del kept  # which must live as long as the call
        return Estimate(ffi.gc(out[0], lib.cophase_estimate_destroy))

    @property
    def progress(self) -> Progress:
        """Progress of the estimate that is running in another thread."""
        stage, done, total = ffi.new("int32_t *"), ffi.new("uint64_t *"), ffi.new("uint64_t *")
        check(lib.cophase_estimator_progress(self._handle, stage, done, total))
        return Progress(_STAGES.get(stage[0], "unknown"), done[0], total[0])

    def cancel(self) -> None:
        """Makes the estimate that is running in another thread, or else the next one, raise
        :class:`cophase.Interrupted` within a second or two at the size of Keck."""
        check(lib.cophase_estimator_cancel(self._handle))
