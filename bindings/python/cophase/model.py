"""The model that is fitted."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arrays import images, input_view, maps, numbers, values
from ._handle import Handle
from ._library import extents, folder, lib, options, scalar, text, words


class Model(Handle):
    """Telescope, modes, diversity and camera: how coefficients become an image. Immutable; any thread may use it.

    Building it takes about half a second at the size of Keck. Sessions and sequences live on when it is closed.

    Parameters
    ----------
    scene : str
        A scene as TOML. :func:`cophase.preset` has some, ``cophase scene --reference`` lists the keys.
    directory : path, optional
        Where the files are looked for that the scene names; without it, the working directory.

    Raises
    ------
    BadSceneError
        With the line, the key, its value and what is accepted.
    BadFileError
        For a file of the scene's.
    """

    def __init__(self, scene: str, directory: str | os.PathLike[str] | None = None) -> None:
        self._create(lib.cophase_model_create, text("scene", scene), folder(directory))

    @classmethod
    def from_arrays(
        cls,
        scene: str,
        *,
        pupil: ArrayLike,
        segments: ArrayLike | None = None,
        modes: ArrayLike | None = None,
        diversity_nm: ArrayLike | None = None,
        directory: str | os.PathLike[str] | None = None,
    ) -> Model:
        """A model with pupil, modes and diversity of the caller's in place of the scene's. The arrays are copied.

        Of the scene this leaves the camera (``[image]``), how the fit is done (``[estimate]``), and whether the pistons
        of the segments are estimated (``modes.segment``); they come before the caller's modes.

        Parameters
        ----------
        pupil : (n, n) array
            Amplitude, 0 to 1, on the grid of the scene's ``pupil.grid_m``; n even.
        segments : (n, n) array of whole numbers, optional
            The segment that each sample belongs to, from 0; negative where there is no glass. Without it, the mirror is
            not segmented.
        modes : (modes, n, n) array, optional
            Wavefront of each mode, nm per nm of its coefficient. Without it, those of the scene.
        diversity_nm : (n, n) array, optional
            The diversity, nm of wavefront. Without it, that of the scene.

        Raises
        ------
        BadShapeError
            For maps that do not fit one another.
        BadValueError
            For what cannot be a pupil or a mode.
        """
        given = {"pupil": pupil, "segments": segments, "modes": modes, "diversity_nm": diversity_nm}
        # Held until the library has copied what they show.
        arrays = {name: images(name, array) for name, array in given.items() if array is not None}
        views = {name: input_view(array)[0] for name, array in arrays.items()}
        self = cls.__new__(cls)
        create = lib.cophase_model_create_from_arrays
        self._create(create, text("scene", scene), folder(directory), options("cophase_model_arrays", **views))
        return self

    def _create(self, create: Any, *inputs: Any) -> None:
        self._own("cophase_model", lib.cophase_model_destroy, create, *inputs)

    def _says(self) -> str:
        rows, cols = self.frame_shape
        return f"{self.modes} modes, {self.segment_modes} of segments; frames of {rows} x {cols}"

    @property
    def modes(self) -> int:
        """Number of modes that are estimated: the coefficients of an image."""
        return scalar("size_t", lib.cophase_model_mode_count, self._handle)

    @property
    def segment_modes(self) -> int:
        """Number of those that move segments; they come first."""
        return scalar("size_t", lib.cophase_model_segment_mode_count, self._handle)

    @property
    def mode_names(self) -> list[str]:
        """Names of the modes."""
        call = lib.cophase_model_mode_name
        return [words(scalar("const char *", call, self._handle, mode)) for mode in range(self.modes)]

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows and columns of a detector frame."""
        return extents(lib.cophase_model_frame_shape, self._handle)

    @property
    def samples(self) -> int:
        """Rows, and columns, of a wavefront map."""
        return scalar("size_t", lib.cophase_model_samples, self._handle)

    @property
    def pixels(self) -> int:
        """Rows, and columns, of a PSF: the pixels that are compared, after the reduction of a frame to the model's
        sampling and to what carries signal."""
        return scalar("size_t", lib.cophase_model_pixels, self._handle)

    def wavefront_nm(self, coefficients_nm: ArrayLike) -> NDArray[np.float32]:
        """Wavefront of some coefficients.

        Parameters
        ----------
        coefficients_nm : (modes,) array
            nm of wavefront.

        Returns
        -------
        (2, samples, samples) array
            Maps ``[y, x]``, nm: that of the segments, and the non-common path aberrations. NaN outside the pupil.
        """
        return self._maps((2, self.samples, self.samples), lib.cophase_model_wavefront_nm, coefficients_nm)

    def psf(self, coefficients_nm: ArrayLike) -> NDArray[np.float32]:
        """PSF of some coefficients, with the diversity.

        Parameters
        ----------
        coefficients_nm : (modes,) array
            nm of wavefront.

        Returns
        -------
        (pixels, pixels) array
            Intensity ``[y, x]``, whose sum over an unbounded detector would be 1. The optical axis is in row and column
            ``pixels // 2``.
        """
        return self._maps((self.pixels, self.pixels), lib.cophase_model_psf, coefficients_nm)

    def _maps(self, shape: tuple[int, ...], call: Any, coefficients_nm: ArrayLike) -> NDArray[np.float32]:
        given = numbers("coefficients_nm", coefficients_nm, self.modes)
        return maps(shape, call, self._handle, values(given), given.size)
