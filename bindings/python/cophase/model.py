"""Models."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arrays import Inputs, doubles, numbers, output
from ._handle import Handle
from ._library import absolute, check, ffi, lib, path_text, read_scene, result, struct, text, words


class Model(Handle):
    """Model of the images of a wavefront: telescope, modes, and of each channel diversity and camera. Immutable: any number of threads
    may use it.

    Building it takes about half a second for each channel at the size of Keck. Its sessions and sequences stay usable when it is closed. It
    pickles as its scene, and is built again where it is unpickled; a model from arrays does not.

    Parameters
    ----------
    scene : str or path
        Scene: a TOML file, the name of a preset (:func:`cophase.preset`), or TOML text.
        ``cophase scene --reference`` lists the keys.
    directory : path, optional
        Directory of the files that the scene names; that of the scene's file, or else the working directory, by default.

    Attributes
    ----------
    modes : int
        Number of modes, which is the number of coefficients of an image.
    segment_modes : int
        Number of modes that move segments; they come first, the others are NCPA modes.
    mode_names : list of str
        Names of the modes.
    channels : list of str
        Names of the channels (``[[image.channel]]``), in the order of the scene; one empty name for a scene that lists none.
    frame_shape : (int, int)
        Rows and columns of a frame; of several channels, those of the first.
    samples : int
        Rows, and columns, of a wavefront map.
    pixels : int
        Rows, and columns, of a PSF: the pixels that are compared, after a frame is cut and reduced to the model's
        sampling; of several channels, those of the first.

    Raises
    ------
    BadSceneError
        With line, key, value and what is accepted.
    BadFileError
        For a file of the scene.
    """

    _instead = "send the arrays, or the scene of the session, and build it there"

    def __init__(self, scene: str | os.PathLike[str], directory: str | os.PathLike[str] | None = None) -> None:
        scene_text, directory = read_scene(scene, directory)
        self._create(scene_text, directory)
        self._recipe = (type(self), (scene_text, absolute(directory)))

    @classmethod
    def from_arrays(
        cls,
        scene: str | os.PathLike[str],
        *,
        pupil: ArrayLike,
        segments: ArrayLike | None = None,
        modes: ArrayLike | None = None,
        diversity_nm: ArrayLike | None = None,
        directory: str | os.PathLike[str] | None = None,
    ) -> Model:
        """Model with pupil, modes and diversity of the caller's instead of the scene's. The arrays are copied.

        They have the effect of the same maps in files (``pupil.file``, ``modes.file``, ``image.diversity_file``); the rest is
        the scene's. Pistons of the segments (``modes.segment``) come before the caller's modes, and Zernike polynomials to
        Noll 21 follow them, as far as they are not among them, unless ``modes.exact_zernikes`` says otherwise.

        Parameters
        ----------
        pupil : (n, n) array
            Amplitude, 0 to 1, over the scene's ``pupil.grid_m``; n even. One of at least twice ``pupil.samples`` is averaged
            onto that grid.
        segments : (n, n) array of whole numbers, optional
            Label of each sample's segment, from 0 or 1, with gaps or without; negative, or 0 where they begin at 1, outside
            all segments. Segments are counted by ascending label. Not segmented by default.
        modes : (modes, n, n) array, optional
            Wavefront of each mode, nm per nm of its coefficient, on the grid of the model; the scene's modes by default.
        diversity_nm : (n, n) array, optional
            Diversity, nm of wavefront; the scene's by default.

        Raises
        ------
        BadShapeError
            For maps that do not fit one another.
        BadValueError
            For an array that is no pupil or no modes.
        """
        given = {"pupil": pupil, "segments": segments, "modes": modes, "diversity_nm": diversity_nm}
        self = cls.__new__(cls)
        self._create(*read_scene(scene, directory), Inputs("cophase_model_arrays", given))
        return self

    def _create(self, scene_text: str, directory: str | os.PathLike[str] | None, arrays: Inputs | None = None) -> None:
        pointer = ffi.NULL if arrays is None else arrays.pointer
        inputs = (text("scene", scene_text), path_text("directory", directory), pointer)
        self._read(lib.cophase_model_create, *inputs)

    def channel(self, channel: str | int) -> Model:
        """Model of one of the channels, by its name or number: the size of its frames, its PSF. All have the same modes."""
        model = Model.__new__(Model)
        model._read(lib.cophase_model_channel, self._handle, self._number(channel), ffi.NULL)
        return model

    def _number(self, channel: str | int) -> int:
        """The number of a channel."""
        if not isinstance(channel, str):
            return channel
        if channel not in self.channels:
            raise ValueError(f"the channel is {channel!r}: one of {self.channels} is accepted")
        return self.channels.index(channel)

    def _read(self, create: Any, *inputs: Any) -> None:
        """Owns the model that ``create`` makes, and reads its sizes."""
        self._own("cophase_model", create, *inputs)
        info = struct("cophase_model_info", lib.cophase_model_get_info, self._handle)
        self.modes: int = info.modes
        self.segment_modes: int = info.segment_modes
        self.frame_shape: tuple[int, int] = (info.rows, info.cols)
        self.samples: int = info.samples
        self.pixels: int = info.pixels
        name = lib.cophase_model_mode_name
        self.mode_names: list[str] = [words(result("char *", name, self._handle, k)) for k in range(self.modes)]
        self.channels: list[str] = [self._channel_name(channel) for channel in range(info.channels)]

    def _channel_name(self, channel: int) -> str:
        name = ffi.new("char **")
        check(lib.cophase_model_channel(self._handle, channel, name, ffi.NULL))
        return words(name[0])

    def _summary(self) -> str:
        rows, cols = self.frame_shape
        channels = "" if len(self.channels) == 1 else f", channels {', '.join(self.channels)}"
        return f"{self.modes} modes, {self.segment_modes} of segments; frames of {rows} x {cols}{channels}"

    def wavefront_nm(self, coefficients_nm: ArrayLike) -> NDArray[np.float64]:
        """Wavefront of some coefficients.

        Parameters
        ----------
        coefficients_nm : (modes,) array
            nm of wavefront.

        Returns
        -------
        (2, samples, samples) array
            Maps ``[y, x]``, nm: the segments, and the non-common path aberrations. NaN outside the pupil.
        """
        given = numbers("coefficients_nm", coefficients_nm, self.modes)
        shape = (2, self.samples, self.samples)
        return output(shape, lib.cophase_model_wavefront_nm, self._handle, doubles(given), given.size)

    def psf(self, coefficients_nm: ArrayLike) -> NDArray[np.float64]:
        """PSF of some coefficients, with the diversity; of several channels, :meth:`channel` gives the model of one.

        Parameters
        ----------
        coefficients_nm : (modes,) array
            nm of wavefront.

        Returns
        -------
        (pixels, pixels) array
            Intensity ``[y, x]``. Its sum over an unbounded detector would be 1. The optical axis is on row and column
            ``pixels // 2``.
        """
        given = numbers("coefficients_nm", coefficients_nm, self.modes)
        shape = (self.pixels, self.pixels)
        return output(shape, lib.cophase_model_psf, self._handle, doubles(given), given.size)
