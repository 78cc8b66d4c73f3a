"""The simulator of adaptive optics."""

import math
import os
from types import TracebackType
from typing import Any, Optional, Union

import numpy as np
from numpy.typing import NDArray

from ._library import check, ffi, lib, scalar, view

#: Frames between two looks at Ctrl-C: some tens of milliseconds.
_FRAMES_AT_ONCE = 256


class Simulator:
    """A simulated AO system under a sky: turbulence, wavefront sensor, deformable mirror, control, science camera.

    What it shows is of the frame made last; :class:`cophase.Error` before the first. Every look returns a new array.
    One thread at a time; the same scene gives the same bits as in every other language.
    """

    def __init__(self, scene_text: str, directory: Union[str, "os.PathLike[str]", None] = None) -> None:
        """Builds the system of a scene (TOML), which takes about a second at the size of Keck.

        ``directory`` is where the files are looked for that the scene names; without it, the working directory.
        """
        # So that close() works on what was never made.
        self._handle: Any = ffi.NULL
        folder = ffi.NULL if directory is None else os.fspath(directory).encode()
        made = scalar("cophase_simulator *", lib.cophase_simulator_create, scene_text.encode(), folder)
        self._handle = ffi.gc(made, lib.cophase_simulator_destroy)

    def close(self) -> None:
        """Frees it now, and not when nobody refers to it any more. Every later use raises."""
        handle, self._handle = self._handle, ffi.NULL
        if handle != ffi.NULL:
            ffi.release(handle)

    def __enter__(self) -> "Simulator":
        return self

    def __exit__(
        self,
        kind: Optional[type[BaseException]],
        error: Optional[BaseException],
        traceback: Optional[TracebackType],
    ) -> None:
        self.close()

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
    def divergence_s(self) -> Optional[float]:
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
        return self._maps(1, lib.cophase_simulator_residual_samples, lib.cophase_simulator_residual_nm)[0]

    @property
    def residual_rms_nm(self) -> float:
        """Its RMS over the pupil (each sample weighed by its lit area, piston removed), nm."""
        return scalar("double", lib.cophase_simulator_residual_rms_nm, self._handle)

    @property
    def image_e(self) -> NDArray[np.float32]:
        """The camera's defocused image ``[y, x]``, electrons, with the noise that the scene names."""
        return self._maps(1, lib.cophase_simulator_image_pixels, lib.cophase_simulator_image_e)[0]

    @property
    def phasing_nm(self) -> NDArray[np.float32]:
        """The true phasing errors of the segments ``[y, x]``, nm; NaN outside the pupil."""
        return self._truth_nm()[0]

    @property
    def ncpa_nm(self) -> NDArray[np.float32]:
        """The true non-common path aberrations ``[y, x]``, nm; NaN outside the pupil."""
        return self._truth_nm()[1]

    def _truth_nm(self) -> NDArray[np.float32]:
        return self._maps(2, lib.cophase_simulator_truth_samples, lib.cophase_simulator_truth_nm)

    def _values(self, size: Any, call: Any) -> NDArray[np.float32]:
        values = np.empty(scalar("size_t", size, self._handle), np.float32)
        check(call(self._handle, ffi.from_buffer("float[]", values), values.size))
        return values

    def _maps(self, count: int, size: Any, call: Any) -> NDArray[np.float32]:
        side = scalar("size_t", size, self._handle)
        maps = np.empty((count, side, side), np.float32)
        check(call(self._handle, view(maps)))
        return maps
