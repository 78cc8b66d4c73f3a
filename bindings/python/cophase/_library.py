"""The C library: where it is, what its header declares, how it fails.

The declarations are read from ``cophase.h`` itself, so there is no second copy of them that could drift.
"""

import os
import re
import sys
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from numpy.typing import NDArray

_HERE = Path(__file__).resolve().parent
_ROOT = _HERE.parents[2]
_NAME = {"darwin": "libcophase.dylib", "win32": "cophase.dll"}.get(sys.platform, "libcophase.so")


class Error(RuntimeError):
    """A call that failed: the library's own sentence, and the name of its status, such as ``BAD_SCENE``."""

    def __init__(self, status: str, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status


def _find(variable: str, *places: Path) -> Path:
    """The file that the environment names, or the first of ``places`` that is there."""
    if variable in os.environ:
        return Path(os.environ[variable])
    for place in places:
        if place.exists():
            return place
    looked = ", ".join(map(str, places))
    raise ImportError(f"{places[0].name} is in none of {looked}: set {variable} to its path")


def _declarations(header: str) -> str:
    """What cffi reads of a header: without the preprocessor's lines and what is for C++, numbers kept."""
    header = re.sub(r"#ifdef __cplusplus.*?#endif[^\n]*", "", header, flags=re.DOTALL)
    return re.sub(r"^#(?!define \w+ \d+$).*$", "", header, flags=re.MULTILINE)


ffi = cffi.FFI()
ffi.cdef(_declarations(_find("COPHASE_HEADER", _HERE / "cophase.h", _ROOT / "include/cophase.h").read_text("utf-8")))
# Beside this file where a package was installed; in a source tree, what cargo built.
lib: Any = ffi.dlopen(
    str(_find("COPHASE_LIBRARY", _HERE / _NAME, _ROOT / "target/release" / _NAME, _ROOT / "target/debug" / _NAME))
)
if lib.cophase_abi_version() != lib.COPHASE_ABI_VERSION:
    raise ImportError(
        f"libcophase has C interface {lib.cophase_abi_version()}: {lib.COPHASE_ABI_VERSION} is what its header has"
    )


def version() -> str:
    """Version of the library."""
    return ffi.string(lib.cophase_version()).decode()


def check(status: int) -> None:
    """Raises :class:`Error` unless a call succeeded. To be called on the thread that made the call."""
    if status != lib.COPHASE_OK:
        length = lib.cophase_last_error(ffi.NULL, 0)
        sentence = ffi.new("char[]", length + 1)
        lib.cophase_last_error(sentence, length + 1)
        name = ffi.string(lib.cophase_status_name(status)).decode()
        raise Error(name, ffi.string(sentence).decode(errors="replace"))


def scalar(kind: str, call: Any, *inputs: Any) -> Any:
    """What ``call`` puts into its last argument, a pointer to ``kind``."""
    out = ffi.new(f"{kind} *")
    check(call(*inputs, out))
    return out[0]


def view(array: NDArray[np.float32]) -> Any:
    """A stack ``[count, y, x]``, as the library sees it: the same memory, whatever its strides."""
    out = ffi.new("cophase_array_f32 *")
    out.data = ffi.cast("float *", array.ctypes.data)
    out.count, out.rows, out.cols = array.shape
    out.count_stride, out.row_stride, out.col_stride = (stride // array.itemsize for stride in array.strides)
    return out
