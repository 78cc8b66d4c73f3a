"""The simulator of adaptive optics."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._arrays import maps
from ._handle import Handle
from ._library import check, extents, ffi, folder, lib, scalar, text

#: Frames between two looks at Ctrl-C: some tens of milliseconds.
_FRAMES_AT_ONCE = 256


class Simulator(Handle):
    """A simulated AO system under a sky: turbulence, wavefront sensor, deformable mirror, control, science camera.

    What it shows is of the frame made last; :class:`cophase.Error` before the first. Every look returns a new array.
    One thread at a time; the same scene gives the same bits as in every other language.
    """

    def __init__(self, scene_text: str, directory: str | os.PathLike[str] | None = None) -> None:
        """Builds the system of a scene (TOML), which takes about a second at the size of Keck.

        ``directory`` is where the files are looked for that the scene names; without it, the working directory.
        """
        create, destroy = lib.cophase_simulator_create, lib.cophase_simulator_destroy
        self._own("cophase_simulator", destroy, create, text("scene_text", scene_text), folder(directory))

    def _says(self) -> str:
        return f"{self.frames} frames of {self.frame_s * 1e3:.3g} ms"

    def step(self, frames: int = 1) -> None:
        """Advances the loop by ``frames`` frames. One that diverges goes on: see :attr:`divergence_s`.

        Ctrl-C stops between frames; what was made until then is there.
        """
        if frames < 0:
            raise ValueError(f"frames is {frames}: a number from 0 on is accepted")
        while frames > 0:
            some = min(frames, _FRAMES_AT_ONCE)
            check(lib.cophase_simulator_step(self._handle, some))
            frames -= some

    @property
    def frames(self) -> int:
        """Frames since the loop was closed."""
        return scalar("uint64_t", lib.cophase_simulator_frames, self._handle)

    @property
    def frame_s(self) -> float:
        """Duration of a frame, s."""
        return scalar("double", lib.cophase_simulator_frame_s, self._handle)

    @property
    def divergence_s(self) -> float | None:
        """Time at which the loop was seen to diverge, s since it was closed; ``None`` while it has not."""
        seen_s = scalar("double", lib.cophase_simulator_divergence_s, self._handle)
        return None if math.isnan(seen_s) else seen_s

    @property
    def slopes_mas(self) -> NDArray[np.float32]:
        """The slopes that were measured, mas: along x for every subaperture, then along y."""
        return self._values(lib.cophase_simulator_slope_count, lib.cophase_simulator_slopes_mas)

    @property
    def commands_nm(self) -> NDArray[np.float32]:
        """The commands that were on the mirror, nm of wavefront."""
        return self._values(lib.cophase_simulator_actuator_count, lib.cophase_simulator_commands_nm)

    @property
    def residual_nm(self) -> NDArray[np.float32]:
        """The residual wavefront ``[y, x]``, nm; NaN where the pupil has no light."""
        side = scalar("size_t", lib.cophase_simulator_residual_samples, self._handle)
        return maps((side, side), lib.cophase_simulator_residual_nm, self._handle)

    @property
    def residual_rms_nm(self) -> float:
        """Its RMS over the pupil (each sample weighed by its lit area, piston removed), nm."""
        return scalar("double", lib.cophase_simulator_residual_rms_nm, self._handle)

    @property
    def image_e(self) -> NDArray[np.float32]:
        """The camera's defocused image ``[y, x]``, electrons, with the noise that the scene names."""
        shape = extents(lib.cophase_simulator_image_shape, self._handle)
        return maps(shape, lib.cophase_simulator_image_e, self._handle)

    @property
    def phasing_nm(self) -> NDArray[np.float32]:
        """The true phasing errors of the segments ``[y, x]``, nm; NaN outside the pupil."""
        return self._truth_nm()[0]

    @property
    def ncpa_nm(self) -> NDArray[np.float32]:
        """The true non-common path aberrations ``[y, x]``, nm; NaN outside the pupil."""
        return self._truth_nm()[1]

    def _truth_nm(self) -> NDArray[np.float32]:
        side = scalar("size_t", lib.cophase_simulator_truth_samples, self._handle)
        return maps((2, side, side), lib.cophase_simulator_truth_nm, self._handle)

    def _values(self, size: Any, call: Any) -> NDArray[np.float32]:
        values = np.empty(scalar("size_t", size, self._handle), np.float32)
        check(call(self._handle, ffi.from_buffer("float[]", values), values.size))
        return values
