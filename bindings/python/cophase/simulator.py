"""Simulator of adaptive optics."""

from __future__ import annotations

import os
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from ._arrays import output
from ._handle import Handle
from ._library import check, lib, library_text, path_text, read_scene, struct, text

#: Frames between two checks of Ctrl-C: some tens of milliseconds.
_FRAMES_AT_ONCE = 256


class Simulator(Handle):
    """Simulator of an AO system: turbulence, wavefront sensor, deformable mirror, control, science camera.

    Its arrays are those of the last frame; :class:`cophase.BadValueError` before the first. One thread at a time. The
    same scene gives the same bits in every language.

    Parameters
    ----------
    scene : str or path
        Scene: a TOML file, the name of a preset (:func:`cophase.preset`), or TOML text. Building the
        system takes about a second at the size of Keck.
    directory : path, optional
        Directory of the files that the scene names; that of the scene's file, or else the working directory, by default.
    """

    def __init__(self, scene: str | os.PathLike[str], directory: str | os.PathLike[str] | None = None) -> None:
        scene_text, directory = read_scene(scene, directory)
        inputs = (text("scene", scene_text), path_text("directory", directory))
        self._own("cophase_simulator", lib.cophase_simulator_create, *inputs)

    def _summary(self) -> str:
        return f"{self.info.frames} frames of {self.info.frame_s * 1e3:.3g} ms"

    def step(self, frames: int = 1) -> None:
        """Advances the loop by ``frames`` frames. A loop that diverges goes on: see ``info.divergence_s``.

        Ctrl-C stops between frames; those made until then remain.
        """
        if frames < 0:
            raise ValueError(f"frames is {frames}: a number from 0 on is accepted")
        while frames > 0:
            some = min(frames, _FRAMES_AT_ONCE)
            check(lib.cophase_simulator_step(self._handle, some))
            frames -= some

    @property
    def info(self) -> SimpleNamespace:
        """Sizes ``slopes``, ``actuators``, ``residual_samples``, ``truth_samples``, ``rows``, ``cols``; ``frames``
        since the loop was closed, ``frame_s`` of each, ``divergence_s`` (time at which the loop diverged, NaN while it
        has not), ``residual_rms_nm`` over the pupil, piston removed."""
        return struct("cophase_simulator_info", lib.cophase_simulator_get_info, self._handle)

    @property
    def warnings(self) -> list[str]:
        """What to know before using the images: a sentence where the simulator's grid is too coarse for them."""
        return library_text(lib.cophase_simulator_text, self._handle, lib.COPHASE_TEXT_WARNINGS).splitlines()

    @property
    def slopes_mas(self) -> NDArray[np.float64]:
        """Measured slopes, mas, along x for every subaperture, then along y."""
        return self._array("SLOPES_MAS", self.info.slopes)

    @property
    def commands_nm(self) -> NDArray[np.float64]:
        """Commands on the mirror, nm of wavefront."""
        return self._array("COMMANDS_NM", self.info.actuators)

    @property
    def residual_nm(self) -> NDArray[np.float64]:
        """Residual wavefront ``[y, x]``, nm; NaN where the pupil has no light."""
        return self._array("RESIDUAL_NM", self.info.residual_samples, self.info.residual_samples)

    @property
    def image_e(self) -> NDArray[np.float64]:
        """The camera's defocused image ``[y, x]``, electrons, with the noise that the scene names."""
        return self._array("IMAGE_E", self.info.rows, self.info.cols)

    @property
    def phasing_nm(self) -> NDArray[np.float64]:
        """True phasing errors of the segments ``[y, x]``, nm; NaN outside the pupil."""
        return self._truth_nm()[0]

    @property
    def ncpa_nm(self) -> NDArray[np.float64]:
        """True non-common path aberrations ``[y, x]``, nm; NaN outside the pupil."""
        return self._truth_nm()[1]

    def _truth_nm(self) -> NDArray[np.float64]:
        return self._array("TRUTH_NM", 2, self.info.truth_samples, self.info.truth_samples)

    def _array(self, what: str, *shape: int) -> NDArray[np.float64]:
        return output(shape, lib.cophase_simulator_array, self._handle, getattr(lib, f"COPHASE_ARRAY_{what}"))
