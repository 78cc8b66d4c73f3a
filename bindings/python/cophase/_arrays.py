"""NumPy arrays as the library sees them: the same memory, whatever its strides."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._library import check, ffi, lib
from .errors import BadShapeError

#: The element types of the library, narrowest first, and their numbers in its header.
_ELEMENTS: dict[np.dtype[Any], int] = {
    np.dtype(np.uint8): lib.COPHASE_U8,
    np.dtype(np.uint16): lib.COPHASE_U16,
    np.dtype(np.int32): lib.COPHASE_I32,
    np.dtype(np.float32): lib.COPHASE_F32,
    np.dtype(np.float64): lib.COPHASE_F64,
}


def images(name: str, values: ArrayLike) -> NDArray[Any]:
    """A map ``[y, x]`` or a stack of them ``[image, y, x]``, in a type that the library reads.

    That is the caller's own memory for float32, float64, uint16, int32, uint8 and bool. Other types are copied to the
    first of these that NumPy calls safe, such as big-endian ones of FITS files, int16, int64; if there is none, refused.
    """
    if isinstance(values, np.ma.MaskedArray):
        raise TypeError(
            f"{name} is a masked array: one without a mask is accepted, with NaN for values that are unknown"
        )
    array = np.asarray(values)
    if array.ndim not in (2, 3):
        raise BadShapeError(f"{name} has the shape {array.shape}: [y, x] or [image, y, x] is accepted")
    if array.dtype == np.bool_:
        return array.view(np.uint8)
    # Strides that do not count elements come from fields of records.
    whole = array.flags.aligned and all(stride % array.itemsize == 0 for stride in array.strides)
    if array.dtype in _ELEMENTS and whole:
        return array
    for element in _ELEMENTS:
        if np.can_cast(array.dtype, element, "safe"):
            return array.astype(element)
    accepted = ", ".join(map(str, reversed(_ELEMENTS)))
    raise TypeError(f"{name} has the type {array.dtype}: {accepted}, bool and what NumPy casts safely are accepted")


def numbers(name: str, values: ArrayLike, *shape: int) -> NDArray[np.float64]:
    """Coefficients of the given shape in C order: the caller's own memory if it is that already, else a copy."""
    array = np.asarray(values)
    if not np.can_cast(array.dtype, np.float64, "safe"):
        raise TypeError(f"{name} has the type {array.dtype}: float64 and what NumPy casts to it safely are accepted")
    if array.shape != shape:
        raise BadShapeError(f"{name} has the shape {array.shape}: {shape} is accepted")
    return np.require(array, np.float64, ["C", "A"])


def _place(out: Any, array: NDArray[Any]) -> Any:
    stack = array if array.ndim == 3 else array[np.newaxis]
    out.data = ffi.cast("void *", stack.ctypes.data)
    out.count, out.rows, out.cols = stack.shape
    out.count_stride, out.row_stride, out.col_stride = (stride // stack.itemsize for stride in stack.strides)
    return out


def input_view(array: NDArray[Any]) -> Any:
    """What :func:`images` returned, to be read. The caller keeps it alive."""
    out = _place(ffi.new("cophase_input *"), array)
    out.element = _ELEMENTS[array.dtype]
    return out


def view(array: NDArray[np.float32]) -> Any:
    """A map or a stack of maps, to be written. The caller keeps it alive."""
    return _place(ffi.new("cophase_array_f32 *"), array)


def values(array: NDArray[np.float64]) -> Any:
    """Numbers in C order, as a pointer that keeps them alive."""
    return ffi.from_buffer("double[]", array)


def maps(shape: tuple[int, ...], call: Any, *inputs: Any) -> NDArray[np.float32]:
    """The map or stack of maps that ``call`` writes to its last argument."""
    out = np.empty(shape, np.float32)
    check(call(*inputs, view(out)))
    return out


def record(kind: str) -> np.dtype[np.void]:
    """A struct of the header, whose fields are numbers, as NumPy sees it."""
    fields = dict(ffi.typeof(kind).fields)
    return np.dtype(
        {
            "names": list(fields),
            "formats": [field.type.cname.replace("_t", "") for field in fields.values()],
            "offsets": [field.offset for field in fields.values()],
            "itemsize": ffi.sizeof(kind),
        }
    )
