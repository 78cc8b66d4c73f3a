"""The C library: where it is, what its header declares, how it fails.

The declarations are read from ``cophase.h`` itself, so there is no second copy of them that could drift.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

import cffi

from .errors import Error

_HERE = Path(__file__).resolve().parent
_ROOT = _HERE.parents[2]
_NAME = {"darwin": "libcophase.dylib", "win32": "cophase.dll"}.get(sys.platform, "libcophase.so")


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


ffi: Any = cffi.FFI()
ffi.cdef(_declarations(_find("COPHASE_HEADER", _HERE / "cophase.h", _ROOT / "include/cophase.h").read_text("utf-8")))
# Beside this file where a package was installed; in a source tree, what cargo built.
lib: Any = ffi.dlopen(
    str(_find("COPHASE_LIBRARY", _HERE / _NAME, _ROOT / "target/release" / _NAME, _ROOT / "target/debug" / _NAME))
)
if lib.cophase_abi_version() != lib.COPHASE_ABI_VERSION:
    raise ImportError(
        f"libcophase has C interface {lib.cophase_abi_version()}: {lib.COPHASE_ABI_VERSION} is what its header has"
    )

_ERRORS = {kind.status: kind for kind in Error.__subclasses__()}


def words(text: Any) -> str:
    """A string of the library's."""
    return ffi.string(text).decode(errors="replace")


def version() -> str:
    """Version of the library."""
    return words(lib.cophase_version())


def check(status: int) -> None:
    """Raises the :class:`Error` of a status, unless a call succeeded. To be called on the thread that made the call."""
    if status == lib.COPHASE_OK:
        return
    length = lib.cophase_last_error(ffi.NULL, 0)
    sentence = ffi.new("char[]", length + 1)
    lib.cophase_last_error(sentence, length + 1)
    name = words(lib.cophase_status_name(status))
    error = _ERRORS.get(name, Error)(words(sentence))
    error.status = name
    raise error


def scalar(kind: str, call: Any, *inputs: Any) -> Any:
    """What ``call`` puts into its last argument, a pointer to ``kind``."""
    out = ffi.new(f"{kind} *")
    check(call(*inputs, out))
    return out[0]


def extents(call: Any, *inputs: Any) -> tuple[int, int]:
    """The rows and columns that ``call`` puts into its last two arguments."""
    rows, cols = ffi.new("size_t *"), ffi.new("size_t *")
    check(call(*inputs, rows, cols))
    return rows[0], cols[0]


def text_of(call: Any, *inputs: Any) -> str:
    """What ``call`` writes as a text: its last arguments are room for it, the size of that room, and its length."""
    length = ffi.new("size_t *")
    check(call(*inputs, ffi.NULL, 0, length))
    room = ffi.new("char[]", length[0] + 1)
    check(call(*inputs, room, len(room), length))
    return words(room)


def text(name: str, value: str | os.PathLike[str]) -> bytes:
    """A text of the caller's as C has it."""
    value = os.fspath(value)
    if not isinstance(value, str):
        raise TypeError(f"{name} is a {type(value).__name__}: a str is accepted")
    if "\0" in value:
        raise ValueError(f"{name} has a zero character in place {value.index(chr(0))}: text without is accepted")
    return value.encode()


def folder(directory: str | os.PathLike[str] | None) -> Any:
    """A folder of the caller's; NULL is the working directory."""
    return ffi.NULL if directory is None else text("directory", directory)


def options(kind: str, **fields: Any) -> Any:
    """A struct of options with the library's own defaults, but for the fields that are not ``None``."""
    out = ffi.new(f"{kind} *")
    check(getattr(lib, f"{kind}_init")(out, ffi.sizeof(kind)))
    for name, value in fields.items():
        if value is not None:
            try:
                setattr(out, name, value)
            except (OverflowError, TypeError) as error:
                raise type(error)(f"{name} is {value!r}: {error}") from None
    return out
