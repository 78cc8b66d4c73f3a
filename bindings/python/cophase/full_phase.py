"""The whole wavefront behind each exposure of a sequence."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any, Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arrays import images, input_view, maps, record, values
from ._handle import Handle
from ._interrupt import interruptible
from ._library import check, extents, ffi, folder, lib, options, scalar, text, text_of, words
from .errors import BadShapeError

_REPORT = record("cophase_full_phase_report")
_IMAGE = record("cophase_full_phase_image")
_CORRECTIONS = record("cophase_correction_report")

#: What an estimate may assume of the adaptive optics, each level with all before it.
_KNOWS = {
    "nothing": lib.COPHASE_KNOWS_NOTHING,
    "spectrum": lib.COPHASE_KNOWS_SPECTRUM,
    "loop": lib.COPHASE_KNOWS_LOOP,
    "telemetry": lib.COPHASE_KNOWS_TELEMETRY,
}


@dataclass(frozen=True, eq=False)
class FullPhaseEstimate:
    """What a full-phase estimate found.

    Attributes
    ----------
    mode_names : list of str
        The static modes: pistons of the segments, then NCPA.
    segment_modes : int
        How many of them are pistons.
    coefficients_nm : (modes,) array
        nm of wavefront.
    sigma_nm : (modes,) array
        Their error bars, 1 sigma.
    covariance_nm2 : (modes, modes) array
        Their covariance, nm^2.
    phasing_nm, ncpa_nm : (samples, samples) array
        The static errors as maps ``[y, x]``, nm; NaN outside the pupil.
    phasing_sigma_nm, ncpa_sigma_nm : (samples, samples) array
        Their error bars, 1 sigma.
    report : record
        ``images`` that were read and ``used``; ``passes`` that were made, and whether they ``settled`` (1) or ran out
        (0); ``phasing_rms_nm`` and its error bar ``phasing_sigma_nm``, ``ncpa_rms_nm`` and its ``ncpa_sigma_nm`` (RMS
        over the pupil, tip and tilt removed); ``phasing_change_nm`` and ``ncpa_change_nm`` of the last pass;
        ``reduced_chi2``, the median of the images used; ``seconds`` that it took. Read as ``report.used``.
    knows : str
        What was assumed of the adaptive optics.
    reports : (images,) record array
        ``status``, a number (:attr:`status` has its name); whether it was ``used`` (1, else 0); ``evaluations`` of the
        model; ``reduced_chi2``; ``flux_e``; ``background_e``.
    messages : list of str
        What became of each image, in a sentence.
    warnings : list of str
        What somebody should know before using the estimate.
    """

    mode_names: list[str]
    segment_modes: int
    coefficients_nm: NDArray[np.float64]
    sigma_nm: NDArray[np.float64]
    covariance_nm2: NDArray[np.float64]
    phasing_nm: NDArray[np.float32]
    ncpa_nm: NDArray[np.float32]
    phasing_sigma_nm: NDArray[np.float32]
    ncpa_sigma_nm: NDArray[np.float32]
    report: np.record
    knows: str
    reports: np.recarray[Any, np.dtype[Any]]
    messages: list[str]
    warnings: list[str]

    @property
    def status(self) -> NDArray[np.str_]:
        """What became of each image: ``OK``, ``NOT_CONVERGED`` or ``UNUSABLE``."""
        return np.array([words(lib.cophase_image_status_name(int(number))) for number in self.reports["status"]])


@dataclass(frozen=True, eq=False)
class Corrections:
    """What to add to segments, mirror and reference slopes, in the library's order.

    A positive command raises the wavefront.

    Attributes
    ----------
    pistons_nm : (segments,) array
        To add to each segment's piston, nm of wavefront; 0 where its estimate is under its error bar.
    actuators_nm : (actuators,) array
        To add to each command of the mirror, nm of wavefront; empty without a loop in the scene.
    actuators_m : (actuators, 2) array
        Where each actuator is, x and y, m.
    slopes_mas : (slopes,) array
        To add to the sensor's reference, along x for every subaperture, then along y.
    corrected_modes : int
        NCPA modes that are corrected.
    limited : int
        Commands that were cut at the limit.
    """

    pistons_nm: NDArray[np.float64]
    actuators_nm: NDArray[np.float64]
    actuators_m: NDArray[np.float64]
    slopes_mas: NDArray[np.float64]
    corrected_modes: int
    limited: int


class FullPhase(Handle):
    """Static errors from a sequence of exposures behind adaptive optics, by the whole wavefront behind each.

    The estimator of ``cophase estimate --method full-phase``: pistons of the segments and non-common path aberrations
    (NCPA) from all exposures together. One call at a time (:class:`cophase.BusyError` otherwise), but for :meth:`cancel`
    and :attr:`retrieved`; other Python threads run on during a call.

    Parameters
    ----------
    scene : str
        A scene as TOML, which need not name the method. With ``[wavefront_sensor]`` and ``[control]`` it describes the
        loop in front of the camera.
    directory : path, optional
        Where the files are looked for that the scene names; without it, the working directory.

    Raises
    ------
    BadSceneError
        With the line, the key, its value and what is accepted: also for keys that are for static modes alone, such as
        ``estimate.optimizer``.

    Examples
    --------
    >>> with cophase.FullPhase(cophase.preset("keck-onsky")) as full_phase:
    ...     estimate = full_phase.estimate(frames, slopes_mas)
    ...     corrections = full_phase.corrections()
    """

    def __init__(self, scene: str, directory: str | os.PathLike[str] | None = None) -> None:
        create, destroy = lib.cophase_full_phase_create, lib.cophase_full_phase_destroy
        self._own("cophase_full_phase", destroy, create, text("scene", scene), folder(directory))

    def _says(self) -> str:
        rows, cols = self.frame_shape
        return f"frames of {rows} x {cols}"

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows and columns of a detector frame."""
        return extents(lib.cophase_full_phase_frame_shape, self._handle)

    def calibrate(
        self,
        dark: ArrayLike | None = None,
        flat: ArrayLike | None = None,
        bad: ArrayLike | None = None,
        gain_e: float = 1.0,
        saturation: float = math.inf,
    ) -> None:
        """Says what the raw values of coming frames mean, as :meth:`cophase.Session.calibrate` does."""
        given = {"dark": dark, "flat": flat, "bad": bad}
        # Held until the library has copied what they show.
        arrays = {name: images(name, array) for name, array in given.items() if array is not None}
        views = {name: input_view(array)[0] for name, array in arrays.items()}
        camera = options("cophase_calibration", gain_e=gain_e, saturation=saturation, **views)
        check(lib.cophase_full_phase_calibrate(self._handle, camera))

    def estimate(
        self,
        frames: ArrayLike,
        slopes_mas: ArrayLike | None = None,
        knows: str | None = None,
        read_noise_e: float | None = None,
        threads: int = 0,
        progress: Callable[[int], None] | None = None,
    ) -> FullPhaseEstimate:
        """Reads a sequence. 75 exposures of Keck take some ten seconds on two processors.

        Ctrl-C cancels it, before the next image or the next pass.

        Parameters
        ----------
        frames : (images, rows, cols) array
            Two or more exposures of the same static errors, raw values or electrons; :attr:`frame_shape`. Values that are
            not finite are bad pixels. Types and strides as for :meth:`cophase.Session.fit`.
        slopes_mas : (images, slopes) array, optional
            Telemetry: what the wavefront sensor measured meanwhile, mean over each exposure, along x for every
            subaperture, then along y.
        knows : {"nothing", "spectrum", "loop", "telemetry"}, optional
            What is assumed of the adaptive optics, each with all before it; without it, what the scene says, or else
            the most that there is.
        read_noise_e : float, optional
            Read noise of a pixel, RMS electrons; without it, what the scene says.
        threads : int
            0 for as many as the machine has processors.
        progress : callable, optional
            Called now and then with the number of wavefronts retrieved so far, in all passes together. What it raises
            cancels the estimate.

        Raises
        ------
        BadSceneError
            Where more is to be known than there is, such as the loop in a scene without one.
        BadShapeError
            For frames or slopes of another shape.
        BadImageError
            Where fewer than two images can be used.
        Interrupted
            After :meth:`cancel`.
        """
        if knows is not None and knows not in _KNOWS:
            raise ValueError(f"knows is {knows!r}: {', '.join(_KNOWS)} is accepted")
        pixels = images("frames", frames)
        if slopes_mas is not None:
            slopes = images("slopes_mas", slopes_mas)
            if slopes.ndim != 2:
                raise BadShapeError(f"slopes_mas has the shape {slopes.shape}: [image, slope] is accepted")
            slopes_view = input_view(slopes)
        else:
            slopes_view = ffi.NULL
        level = None if knows is None else _KNOWS[knows]
        how = options("cophase_full_phase_options", knows=level, read_noise_e=read_noise_e, threads=threads)
        report = np.recarray(1, _REPORT)
        view, into = input_view(pixels), ffi.cast("cophase_full_phase_report *", report.ctypes.data)

        def call() -> None:
            read = lib.cophase_full_phase_estimate
            check(read(self._handle, view, slopes_view, how, into, _REPORT.itemsize))

        watch = None if progress is None else lambda: progress(self.retrieved)
        interruptible(call, self.cancel, watch)
        return self._found(report[0])

    def _found(self, report: np.record) -> FullPhaseEstimate:
        handle = self._handle
        modes = scalar("size_t", lib.cophase_full_phase_mode_count, handle)
        side = scalar("size_t", lib.cophase_full_phase_samples, handle)
        coefficients_nm, sigma_nm, covariance_nm2 = np.empty(modes), np.empty(modes), np.empty((modes, modes))
        check(lib.cophase_full_phase_coefficients_nm(handle, values(coefficients_nm), values(sigma_nm), modes))
        check(lib.cophase_full_phase_covariance_nm2(handle, values(covariance_nm2), modes))
        reports = np.recarray(int(report.images), _IMAGE)
        into = ffi.cast("cophase_full_phase_image *", reports.ctypes.data)
        check(lib.cophase_full_phase_images(handle, into, _IMAGE.itemsize, reports.size))
        name = lib.cophase_full_phase_mode_name
        return FullPhaseEstimate(
            [words(scalar("const char *", name, handle, mode)) for mode in range(modes)],
            scalar("size_t", lib.cophase_full_phase_segment_mode_count, handle),
            coefficients_nm,
            sigma_nm,
            covariance_nm2,
            *maps((4, side, side), lib.cophase_full_phase_maps_nm, handle),
            report,
            next(word for word, number in _KNOWS.items() if number == report.knows),
            reports,
            [text_of(lib.cophase_full_phase_image_message, handle, image) for image in range(reports.size)],
            text_of(lib.cophase_full_phase_warnings, handle).splitlines(),
        )

    @property
    def retrieved(self) -> int:
        """Wavefronts that the estimate in another thread, or else the last one, has retrieved, in all passes."""
        return scalar("uint64_t", lib.cophase_full_phase_progress, self._handle)

    def cancel(self) -> None:
        """Makes the estimate that is running in another thread, or else the next one, raise
        :class:`cophase.Interrupted`."""
        check(lib.cophase_full_phase_cancel(self._handle))

    def images_needed(self, phasing_nm: float = math.inf, ncpa_nm: float = math.inf) -> int:
        """How many further images like those of the last estimate bring both error bars down to these.

        nm RMS over the pupil. 0 where they are there. Infinity asks nothing.

        Raises
        ------
        BadValueError
            Where what all images share (an error of the diversity, NCPA finer than the modes) alone makes more.
        """
        return scalar("uint64_t", lib.cophase_full_phase_images_needed, self._handle, phasing_nm, ncpa_nm)

    def corrections(self, limit_nm: float = math.nan) -> Corrections:
        """What to add to segments, mirror and reference slopes, from the last estimate.

        Do no harm: a mode whose estimate is under its error bar is left alone. Where the scene has a loop this takes about
        a second at the size of Keck.

        Parameters
        ----------
        limit_nm : float
            No command is larger; NaN for the mirror's stroke and, for segments, a quarter of the wavelength.

        Raises
        ------
        BadValueError
            Before the first estimate.
        """
        report = np.recarray(1, _CORRECTIONS)
        into = ffi.cast("cophase_correction_report *", report.ctypes.data)
        check(lib.cophase_full_phase_correct(self._handle, limit_nm, into, _CORRECTIONS.itemsize))
        counts = [int(report[0][name]) for name in ("segments", "actuators", "slopes")]
        segments, actuators, slopes = counts
        pistons_nm, actuators_nm, slopes_mas = map(np.empty, counts)
        actuators_m = np.empty((actuators, 2))
        outputs = (values(pistons_nm), segments, values(actuators_nm), values(actuators_m), actuators)
        check(lib.cophase_full_phase_corrections(self._handle, *outputs, values(slopes_mas), slopes))
        corrected, limited = int(report[0].corrected_modes), int(report[0].limited)
        return Corrections(pistons_nm, actuators_nm, actuators_m, slopes_mas, corrected, limited)
