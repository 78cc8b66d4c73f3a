"""Estimates: the result of the pipeline."""

from __future__ import annotations

import os
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._arrays import output, structs
from ._handle import Handle
from ._library import check, ffi, lib, library_text, named, path_text, struct, text

_IMAGE = "cophase_image_report"


@dataclass(frozen=True, eq=False)
class Correction:
    """What to add to segments, mirror and reference slopes to correct the estimated errors.

    Gain, deadband and convention are those of the scene's section ``[commands]``; errors whose correction is not expected to
    lower them are held.

    Attributes
    ----------
    pistons_nm : (segments,) array
        What to add to the piston of each segment, nm of wavefront, which a positive piston raises.
    tilts_nm : (2, segments) array
        What to add to the tip of each segment, and to the tilt of each, nm of wavefront RMS over the segment; of shape (2, 0)
        if the estimate has no tilts of segments.
    actuators_nm : (actuators,) array
        What to add to the command of each actuator, nm of wavefront, from which the mirror is subtracted; empty where
        the scene names no mirror.
    actuators_m : (actuators, 2) array
        Position of each actuator, x and y, m.
    slopes_mas : (slopes,) array
        What to add to the sensor's reference slopes, mas, along x for every subaperture, then along y: the loop then puts the
        correction on the mirror. Empty where no slopes were measured, and for a modal estimate.
    segment_commands, actuator_commands : dict of str to float
        What to add to each channel of the controllers of the segments and of the mirror, by its name, in its unit;
        empty where the scene describes no controller (``[commands]``).
    corrected_modes : int
        NCPA modes that are corrected.
    limited : int
        Commands that were cut at a limit.
    segments_held, ncpa_held : tuple of str
        Why each piston, then each tip, then each tilt, and each NCPA mode is held: ``"deadband"``, ``"no-benefit"`` or
        ``"never-corrected"``; ``""`` for one that is corrected.
    segments_drop_nm2, ncpa_drop_nm2 : float
        Expected drop of the sum of squares of the segment modes (of the steps at edges by the convention edge-minimising),
        and of the NCPA modes, nm².
    warnings : list of str
        What to know before anything is moved.
    """

    pistons_nm: NDArray[np.float64]
    tilts_nm: NDArray[np.float64]
    actuators_nm: NDArray[np.float64]
    actuators_m: NDArray[np.float64]
    slopes_mas: NDArray[np.float64]
    corrected_modes: int
    limited: int
    segment_commands: dict[str, float]
    actuator_commands: dict[str, float]
    segments_held: tuple[str, ...]
    ncpa_held: tuple[str, ...]
    segments_drop_nm2: float
    ncpa_drop_nm2: float
    warnings: list[str]


class ModelError(NamedTuple):
    """An error of the optics or the camera that the scene takes to have none, within the scene's ``[tolerance]``.

    Attributes
    ----------
    name : str
        What is wrong, with the unit of the numbers where they are not relative.
    value, sigma : float
        Posterior mean and standard deviation.
    tolerance : float
        Standard deviation before the images.
    significance : float
        The value by the images alone, over its error bar.
    """

    name: str
    value: float
    sigma: float
    tolerance: float
    significance: float


@dataclass(frozen=True, eq=False)
class WithoutStaircases:
    """An estimate without focus and astigmatisms of the whole pupil, which a tolerance alone divides between segments and NCPA.

    Attributes
    ----------
    phasing_nm, ncpa_nm : (samples, samples) array
        Maps ``[y, x]``, nm; NaN outside the pupil.
    phasing_sigma_nm, ncpa_sigma_nm : (samples, samples) array
        Standard deviation of each sample of these maps, nm.
    info : namespace
        ``phasing_rms_nm``, ``ncpa_rms_nm``, ``wavefront_rms_nm`` and their expected errors ``phasing_sigma_nm``,
        ``ncpa_sigma_nm``, ``wavefront_sigma_nm``, as in :attr:`Estimate.info`.
    """

    phasing_nm: NDArray[np.float64]
    ncpa_nm: NDArray[np.float64]
    phasing_sigma_nm: NDArray[np.float64]
    ncpa_sigma_nm: NDArray[np.float64]
    info: SimpleNamespace


class Estimate(Handle):
    """Estimate of the static wavefront: modes, maps, error bars, reports on the images.

    :meth:`cophase.Estimator.estimate` makes it. ``print(estimate.report())`` shows it as the program does.

    Attributes
    ----------
    info : namespace
        Sizes, status and figures: ``images``, ``used`` (images that were combined), ``clipped`` (left out as outliers),
        ``modes``, ``segment_modes`` (they come first), ``samples``, ``error_terms``, ``warnings``; ``method``
        (``"modal"`` or ``"map"``), ``policy``, ``status`` (the worst of an image that counts for the whole, or ``CONTRADICTORY``),
        ``is_sequence`` (error bars are from the scatter between images); of a MAP estimate ``iterations``,
        ``has_settled``, ``ao_knowledge`` (of the adaptive optics: ``"nothing"``, ``"spectrum"``, ``"loop"``,
        ``"telemetry"``); ``precision``; ``evaluations``; ``phasing_rms_nm``, ``ncpa_rms_nm``, ``wavefront_rms_nm``
        (both together) and their expected errors ``phasing_sigma_nm``, ``ncpa_sigma_nm``, ``wavefront_sigma_nm`` (RMS
        over the pupil, piston, tip and tilt removed; the last of a MAP estimate is an upper limit); ``reduced_chi2`` (median of the images used);
        ``images_to_halve`` (further images that halve both error bars); ``map_width_m``; ``seconds``,
        ``model_seconds``; ``telemetry_gain`` and ``telemetry_correlation`` of the measured slopes with those of the
        retrieved wavefronts, about 1 where they belong together (NaN without telemetry); ``channels``, ``integers``,
        ``model_errors`` (their numbers); ``has_maps_without_staircases`` (1 or 0).
    policy, method, device : str
        Policy, method and device of the estimate.
    model : str
        Modes that were added to the scene's.
    scene : str
        Scene that was used (TOML), with the choices of a plan and the optics that were fitted.
    warnings, remarks : list of str
        What to know before using the numbers; remarks that hold for every image of the scene.
    mode_names : list of str
        Names of the modes.
    coefficients_nm : (modes,) array
        Coefficients, nm.
    sigma_nm : (modes,) array
        Standard deviation of each coefficient, nm.
    covariance_nm2 : (modes, modes) array
        Covariance of the coefficients, nm^2.
    image_coefficients_nm : (images, modes) array, or None
        Coefficients of each image, nm, NaN for unusable images; ``None`` in a MAP estimate.
    phasing_nm, ncpa_nm : (samples, samples) array
        Maps ``[y, x]`` of phasing errors and NCPA, nm; NaN outside the pupil.
    phasing_sigma_nm, ncpa_sigma_nm : (samples, samples) array
        Standard deviation of each sample of these maps, nm.
    images : (images,) record array
        Report on each image: ``status`` (``"OK"``, ``"MISFIT"``, ``"WRONG_MINIMUM"``, ``"NOT_CONVERGED"`` or
        ``"UNUSABLE"``), ``message`` (the reason, a sentence), ``is_used``, ``is_clipped``, ``bad_pixels``,
        ``rejected_pixels``, ``policy``, ``evaluations``, ``reduced_chi2`` (1 where the model is right), ``flux_e``,
        ``background_e``, ``tip_nm``, ``tilt_nm``, ``seconds``, ``channel`` (its index in ``channels``). Read as ``images.flux_e`` or ``images[0].message``.
    channels : list of str
        Names of the channels; empty for a scene without.
    integers : (segments, 3) array
        For channels of several wavelengths: whole wavelengths of the first channel that were added to the piston of each
        segment, their probability, and the piston of the second most probable number relative to this one, nm; else empty.
    error_budget : list of (str, float, float)
        Terms of the error budget: name, and contribution to the error bars of phasing and NCPA, nm RMS over the pupil.
        Their squares add up to the squares of ``info.phasing_sigma_nm`` and ``info.ncpa_sigma_nm``.
    model_errors : list of ModelError
        Errors of the optics and the camera that the error bars hold; empty where these hold the noise alone.
    without_staircases : WithoutStaircases, or None
        Maps and figures without the shapes that a tolerance alone divides between segments and NCPA, where there are such.
    """

    def __init__(self, handle: Any) -> None:
        self._handle = handle
        self.info: SimpleNamespace = struct("cophase_estimate_info", lib.cophase_estimate_get_info, handle)
        info, modes, samples = self.info, self.info.modes, self.info.samples
        self.method: str = info.method
        self.policy = self._text("POLICY")
        self.device = self._text("DEVICE")
        self.model = self._text("MODEL")
        self.scene = self._text("SCENE")
        self.warnings = self._text("WARNINGS").splitlines()
        self.remarks = self._text("REMARKS").splitlines()
        self.mode_names = [self._text("MODE_NAME", mode) for mode in range(modes)]
        self.coefficients_nm = self._array("COEFFICIENTS_NM", modes)
        self.sigma_nm = self._array("SIGMA_NM", modes)
        self.covariance_nm2 = self._array("COVARIANCE_NM2", modes, modes)
        modal = info.method == "modal"
        self.image_coefficients_nm = self._array("IMAGE_COEFFICIENTS_NM", info.images, modes) if modal else None
        maps_nm = self._array("MAPS_NM", 4, samples, samples)
        self.phasing_nm, self.ncpa_nm, self.phasing_sigma_nm, self.ncpa_sigma_nm = maps_nm
        self.images = self._images()
        self.channels = [self._text("CHANNEL_NAME", channel) for channel in range(info.channels)]
        self.integers = self._array("PISTON_INTEGERS", info.integers, 3)
        budget_nm = self._array("ERROR_BUDGET_NM", info.error_terms, 2).tolist()
        self.error_budget = [(self._text("ERROR_TERM_NAME", k), *term) for k, term in enumerate(budget_nm)]
        errors = self._array("MODEL_ERRORS", info.model_errors, 4).tolist()
        self.model_errors = [ModelError(self._text("MODEL_ERROR_NAME", k), *error) for k, error in enumerate(errors)]
        self.without_staircases = self._without_staircases() if info.has_maps_without_staircases else None

    def _without_staircases(self) -> WithoutStaircases:
        samples = self.info.samples
        maps_nm = self._array("MAPS_WITHOUT_STAIRCASES_NM", 4, samples, samples)
        names = [f"{part}_{what}_nm" for part in ("phasing", "ncpa", "wavefront") for what in ("rms", "sigma")]
        figures_nm = self._array("FIGURES_WITHOUT_STAIRCASES_NM", 3, 2).ravel().tolist()
        return WithoutStaircases(*maps_nm, SimpleNamespace(**dict(zip(names, figures_nm))))

    def _text(self, what: str, index: int = 0) -> str:
        return library_text(lib.cophase_estimate_text, self._handle, getattr(lib, f"COPHASE_TEXT_{what}"), index)

    def _array(self, what: str, *shape: int) -> NDArray[np.float64]:
        return output(shape, lib.cophase_estimate_array, self._handle, getattr(lib, f"COPHASE_ARRAY_{what}"))

    def _images(self) -> np.recarray[Any, np.dtype[Any]]:
        count = self.info.images
        numbers, pointer = structs(_IMAGE, (count,))
        check(lib.cophase_estimate_images(self._handle, pointer, ffi.sizeof(_IMAGE), count))
        fields = {name: [named(name, value) for value in numbers[name].tolist()] for name in numbers.dtype.names}
        status = fields.pop("status")
        messages = [self._text("IMAGE_MESSAGE", image) for image in range(count)]
        columns = [np.array(status), np.array(messages, object), *map(np.array, fields.values())]
        return np.rec.fromarrays(columns, names=",".join(["status", "message", *fields]))  # type: ignore[call-overload]

    def _summary(self) -> str:
        info = self.info
        return (
            f"{info.used} of {info.images} images, phasing {info.phasing_rms_nm:.1f} +- {info.phasing_sigma_nm:.1f} nm,"
            f" NCPA {info.ncpa_rms_nm:.1f} +- {info.ncpa_sigma_nm:.1f} nm"
        )

    def report(self) -> str:
        """The report, as the program prints it, warnings included."""
        return self._text("REPORT")

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes the estimate as FITS, whole or not at all. :class:`cophase.BadFileError` if it cannot be written."""
        check(lib.cophase_estimate_write(self._handle, text("path", path)))

    def correct(self, limit_nm: float | None = None, path: str | os.PathLike[str] | None = None) -> Correction:
        """Computes what to add to segments, mirror and (of a MAP estimate) reference slopes.

        Of a modal estimate tips and tilts of segments are not corrected. It takes about a second at the size of Keck if the scene has a loop.

        Parameters
        ----------
        limit_nm : float, optional
            Largest command, nm; by default the mirror's stroke and, for segments, a quarter of the wavelength (no limit
            where the whole wavelengths are known), or ``commands.max_step_nm`` of the scene. The limits of the controllers' channels hold in addition.
        path : path, optional
            FITS file to write; text for a name that ends in ``.txt``.

        Raises
        ------
        BadValueError
            For a negative limit, for segment modes that are not pistons, and for a piston that would move by more than
            ``commands.max_step_nm`` (unset and with one wavelength: half of it).
        BadFileError
            For a controller's table or matrix that cannot be read or does not fit.
        BusyError
            While other threads read the estimate.
        """
        inputs = (self._handle, limit_nm or 0.0, path_text("path", path))
        found = struct("cophase_correction_report", lib.cophase_estimate_correct, *inputs)
        return Correction(
            self._array("CORRECTION_PISTONS_NM", found.segments),
            self._array("CORRECTION_TILTS_NM", 2, found.tilts // 2),
            self._array("CORRECTION_ACTUATORS_NM", found.actuators),
            self._array("CORRECTION_ACTUATORS_M", found.actuators, 2),
            self._array("CORRECTION_SLOPES_MAS", found.slopes),
            found.corrected_modes,
            found.limited,
            self._commands("SEGMENT", found.segment_commands),
            self._commands("ACTUATOR", found.actuator_commands),
            tuple(self._text("SEGMENT_HELD", index) for index in range(found.segments + found.tilts)),
            tuple(self._text("NCPA_HELD", index) for index in range(found.ncpa_modes)),
            found.segments_drop_nm2,
            found.ncpa_drop_nm2,
            self._text("CORRECTION_WARNINGS").splitlines(),
        )

    def _commands(self, what: str, count: int) -> dict[str, float]:
        names = (self._text(f"{what}_COMMAND_NAME", index) for index in range(count))
        return dict(zip(names, self._array(f"CORRECTION_{what}_COMMANDS", count).tolist()))
