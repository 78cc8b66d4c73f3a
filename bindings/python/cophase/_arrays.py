"""NumPy arrays in the library: inputs without a copy where possible, outputs in C order."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._library import check, ffi, lib, options
from .errors import BadShapeError

#: Element types of the library, narrowest first, and their numbers in the header.
_ELEMENTS: dict[np.dtype[Any], int] = {
    np.dtype(np.uint8): lib.COPHASE_U8,
    np.dtype(np.uint16): lib.COPHASE_U16,
    np.dtype(np.int32): lib.COPHASE_I32,
    np.dtype(np.float32): lib.COPHASE_F32,
    np.dtype(np.float64): lib.COPHASE_F64,
}

#: Units of arrays that may come with one, as Astropy and Pint write them: frames are electrons, unless they are named here.
_ELECTRONS = ("electron", "e", "electrons")
_UNITS: dict[str, tuple[str, ...]] = {
    "slopes_mas": ("mas",),
    "diversity_nm": ("nm",),
    "modes": (),
    "pupil": (),
    "segments": (),
    "flat": (),
    "mask": (),
    "bad": (),
}


def _plain(name: str, values: ArrayLike, units: tuple[str, ...]) -> NDArray[Any]:
    """``values`` without what NumPy would drop without a word: refuses a mask, an uncertainty and a unit but one of ``units``.

    Such are the masked arrays of NumPy, ``CCDData`` and ``Quantity`` of Astropy, and the quantities of Pint.
    """
    if isinstance(values, np.ma.MaskedArray):
        raise TypeError(f"{name} is a masked array: one without a mask is accepted, with NaN for unknown values")
    kind = type(values).__name__
    for attribute, instead in (("mask", "mask="), ("uncertainty", "read_noise_e=")):
        extra = getattr(values, attribute, None)
        # A mask that marks nothing says nothing; that of a table of pandas is a method.
        if extra is not None and not callable(extra) and np.any(extra if attribute == "mask" else True):
            raise TypeError(
                f"{name} is a {kind} with a {attribute}: a plain array is accepted, such as its data, and {instead} beside it"
            )
    named = (getattr(values, attribute, None) for attribute in ("unit", "units"))
    unit = next((unit for unit in named if unit is not None and not callable(unit)), None)
    if unit is not None and str(unit) not in (*units, "", "dimensionless"):
        accepted = " or ".join(units) if units else "no unit"
        raise TypeError(
            f"{name} is a {kind} in {unit}: {accepted} is accepted, or a plain array (of counts with gain_e=)"
        )
    # A pint quantity warns where NumPy strips its unit.
    return np.asarray(values.magnitude if hasattr(values, "magnitude") else values)


def images(name: str, values: ArrayLike) -> NDArray[Any]:
    """A map ``[y, x]`` or a stack of maps ``[image, y, x]``, of a type that the library reads.

    This is the caller's own memory for float32, float64, uint16, int32, uint8 and bool. Other types are copied to the
    first of these that NumPy calls safe (big-endian types of FITS files, int16, int64), and refused if there is none.
    """
    array = _plain(name, values, _UNITS.get(name, _ELECTRONS))
    if array.ndim not in (2, 3):
        raise BadShapeError(f"{name} has the shape {array.shape}: [y, x] or [image, y, x] is accepted")
    if array.dtype == np.bool_:
        return array.view(np.uint8)
    # Fields of records may have strides that are no multiple of the element's size.
    whole = array.flags.aligned and all(stride % array.itemsize == 0 for stride in array.strides)
    if array.dtype in _ELEMENTS and whole:
        return array
    for element in _ELEMENTS:
        if np.can_cast(array.dtype, element, "safe"):
            return array.astype(element)
    accepted = ", ".join(map(str, reversed(_ELEMENTS)))
    raise TypeError(
        f"{name} has the type {array.dtype}: {accepted}, bool and types that NumPy casts safely are accepted"
    )


def input_view(array: NDArray[Any]) -> Any:
    """The ``cophase_input`` of an array from :func:`images`. The caller keeps the array alive."""
    stack = array if array.ndim == 3 else array[np.newaxis]
    out = ffi.new("cophase_input *")
    out.data, out.element = ffi.cast("void *", stack.ctypes.data), _ELEMENTS[array.dtype]
    out.count, out.rows, out.cols = stack.shape
    out.count_stride, out.row_stride, out.col_stride = (stride // stack.itemsize for stride in stack.strides)
    return out


class Inputs:
    """A struct of options, some of whose fields are input arrays. It keeps the arrays alive."""

    def __init__(self, kind: str, arrays: dict[str, ArrayLike | None], **fields: Any) -> None:
        self._arrays = {name: images(name, array) for name, array in arrays.items() if array is not None}
        views = {name: input_view(array)[0] for name, array in self._arrays.items()}
        self.pointer = options(kind, **views, **fields)


def calibration(
    dark: ArrayLike | None,
    flat: ArrayLike | None,
    bad: ArrayLike | None,
    gain_e: float | None,
    saturation: float | None,
) -> Inputs:
    """A ``cophase_calibration``."""
    arrays = {"dark": dark, "flat": flat, "bad": bad}
    return Inputs("cophase_calibration", arrays, gain_e=gain_e, saturation=saturation)


def numbers(name: str, values: ArrayLike, *shape: int) -> NDArray[np.float64]:
    """Coefficients of the given shape in C order: the caller's own memory if it is that already, else a copy."""
    array = _plain(name, values, ("nm",))
    if not np.can_cast(array.dtype, np.float64, "safe"):
        raise TypeError(
            f"{name} has the type {array.dtype}: float64 and types that NumPy casts to it safely are accepted"
        )
    if array.shape != shape:
        raise BadShapeError(f"{name} has the shape {array.shape}: {shape} is accepted")
    return np.require(array, np.float64, ["C", "A"])


def doubles(array: NDArray[np.float64]) -> Any:
    """Numbers in C order, as a pointer that keeps them alive."""
    return ffi.from_buffer("double[]", array)


def output(shape: tuple[int, ...], call: Any, *inputs: Any) -> NDArray[np.float64]:
    """The array that ``call`` writes; its last arguments are memory for it and the number of its elements."""
    out = np.empty(shape)
    check(call(*inputs, doubles(out), math.prod(shape)))
    return out


def structs(kind: str, count: tuple[int, ...]) -> tuple[Any, Any]:
    """An array of structs whose fields are numbers: as NumPy records, and as a pointer for C."""
    fields = dict(ffi.typeof(kind).fields)
    record = np.dtype(
        {
            "names": list(fields),
            "formats": [field.type.cname.replace("_t", "") for field in fields.values()],
            "offsets": [field.offset for field in fields.values()],
            "itemsize": ffi.sizeof(kind),
        }
    )
    out = np.recarray(count, record)
    return out, ffi.cast(f"{kind} *", out.ctypes.data)
