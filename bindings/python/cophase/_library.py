"""C library: its file, the declarations of its headers, its failures, its texts and structs.

The declarations are read from ``cophase.h`` and ``cophase_simulator.h`` themselves: no copy can differ from them.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cffi

from .errors import BadFileError, Error

_HERE = Path(__file__).resolve().parent
_ROOT = _HERE.parents[2]
_NAME = {"darwin": "libcophase.dylib", "win32": "cophase.dll"}.get(sys.platform, "libcophase.so")


def _find(variable: str, *places: Path) -> Path:
    """The file that the environment variable names, or else the first of ``places`` that exists."""
    if variable in os.environ:
        return Path(os.environ[variable])
    for place in places:
        if place.exists():
            return place
    looked = ", ".join(map(str, places))
    raise ImportError(f"{places[0].name} is in none of {looked}: set {variable} to its path")


def _declarations(header: Path) -> str:
    """A header as cffi reads it: without directives and C++, with the numbers of its constants."""
    text = re.sub(r"#ifdef __cplusplus.*?#endif[^\n]*", "", header.read_text("utf-8"), flags=re.DOTALL)
    return re.sub(r"^#(?!define \w+ \d+$).*$", "", text, flags=re.MULTILINE)


_header = _find("COPHASE_HEADER", _HERE / "cophase.h", _ROOT / "include/cophase.h")
ffi: Any = cffi.FFI()
ffi.cdef(_declarations(_header) + _declarations(_header.with_name("cophase_simulator.h")))
# An installed package has the library in its own directory; a source tree has what cargo built.
lib: Any = ffi.dlopen(
    str(_find("COPHASE_LIBRARY", _HERE / _NAME, _ROOT / "target/release" / _NAME, _ROOT / "target/debug" / _NAME))
)
if lib.cophase_abi_version() != lib.COPHASE_ABI_VERSION:
    raise ImportError(
        f"libcophase has C interface {lib.cophase_abi_version()}: {lib.COPHASE_ABI_VERSION}, its header's, is accepted"
    )

_ERRORS = {kind.status: kind for kind in Error.__subclasses__()}


def words(text: Any) -> str:
    """A C string of the library."""
    return ffi.string(text).decode(errors="replace")


def version() -> str:
    """Version of the library."""
    return words(lib.cophase_version())


def check(status: int) -> None:
    """Raises the :class:`Error` of a status other than OK. It must run in the thread that made the call."""
    if status == lib.COPHASE_OK:
        return
    sentence = ffi.new("char[]", lib.cophase_last_error(ffi.NULL, 0) + 1)
    lib.cophase_last_error(sentence, len(sentence))
    name = words(lib.cophase_status_name(status))
    error = _ERRORS.get(name, Error)(words(sentence))
    error.status = name
    raise error


def result(kind: str, call: Any, *inputs: Any) -> Any:
    """The value that ``call`` writes through its last argument, a pointer to ``kind``."""
    out = ffi.new(f"{kind} *")
    check(call(*inputs, out))
    return out[0]


def library_text(call: Any, *inputs: Any) -> str:
    """The text that ``call`` writes; its last arguments are memory for it, the size of that memory, and its length."""
    length = ffi.new("size_t *")
    check(call(*inputs, ffi.NULL, 0, length))
    memory = ffi.new("char[]", length[0] + 1)
    check(call(*inputs, memory, len(memory), length))
    return words(memory)


def text(name: str, value: str | os.PathLike[str]) -> bytes:
    """A text of the caller as C reads it."""
    value = os.fspath(value)
    if not isinstance(value, str):
        raise TypeError(f"{name} is a {type(value).__name__}: a str is accepted")
    if "\0" in value:
        raise ValueError(f"{name} has a zero character at index {value.index(chr(0))}: text without is accepted")
    return value.encode()


def preset(name: str) -> str:
    """Text of a scene that comes with the library, such as ``keck-artificial``, ``keck-onsky`` or ``jwst-pair``; the error of another name
    lists all."""
    return words(result("const char *", lib.cophase_scene_preset, text("name", name)))


#: Longest scene that is read, in characters: as many bytes as the program reads of a file.
_LONGEST_SCENE = 1 << 20


def read_scene(
    scene: str | os.PathLike[str], directory: str | os.PathLike[str] | None = None
) -> tuple[str, str | os.PathLike[str] | None]:
    """Text of the scene that a caller means, and the directory of the files that it names.

    ``scene`` is a file, a preset where there is no file of its name, as for the program's ``--scene``, or the text
    itself. A ``str`` with a line break or an equals sign is a text, because every scene has one; a file with such a name
    is given as a path.
    """
    name = text("scene", scene).decode()
    if isinstance(scene, str) and ("\n" in name or "=" in name or not name.strip()):
        return name, directory
    if os.path.exists(name):
        try:
            with open(name, encoding="utf-8") as file:
                # A device may have no end. A pipe is read as far as a scene can be long.
                found = file.read(_LONGEST_SCENE + 1)
        except OSError as error:
            raise BadFileError(f"{name}: {error.strerror}, where the file of a scene is needed") from None
        except UnicodeDecodeError:
            raise BadFileError(f"{name}: is not a text in UTF-8, where the file of a scene is needed") from None
        if len(found) > _LONGEST_SCENE:
            raise BadFileError(f"{name}: has more than {_LONGEST_SCENE} characters, where the file of a scene is needed")
        return found, os.path.dirname(name) if directory is None else directory
    if not isinstance(scene, str) or "." in name or os.sep in name:
        accepted = "a file, the name of a preset such as keck-artificial, or the text of a scene is accepted"
        raise BadFileError(f"{name}: there is no such file of a scene: {accepted}")
    return preset(name), directory


def scene_set(scene: str | os.PathLike[str], **settings: Any) -> str:
    """Text of the scene with other values, its comments kept: ``scene_set("keck-artificial", image__peak_snr=50)``.

    ``scene`` is the name of a preset, a file, or a text. The name of a setting is section and key with two underscores
    between. A value is a number, a bool, a list, a text (words and file names need no quotes), or ``None`` for the
    key's default. They take effect one after the other, each in a valid scene. Names of files in the scene stay as they
    are: where they are relative to the directory of its file, give that as ``directory`` to what takes the text.
    """
    scene_text, _ = read_scene(scene)
    for name, value in settings.items():
        section, _, key = name.partition("__")
        scene_text = library_text(
            lib.cophase_scene_set,
            text("scene", scene_text),
            text(name, f"{section}.{key}"),
            text(name, _toml(value)),
        )
    return scene_text


def _toml(value: Any) -> str:
    """A value as the library reads it."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        # Words in a list need quotes.
        return f"[{', '.join(_quoted(item) if isinstance(item, str) else _toml(item) for item in value)}]"
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return str(value)


def _quoted(text: str) -> str:
    """A basic string of TOML."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def devices() -> dict[str, str]:
    """Devices of this machine: a description of each, by the name that :class:`cophase.Session` takes.

    The first is always the CPU, ``"cpu"``. OpenCL devices are ``"opencl:PLATFORM:DEVICE"``.
    """
    return dict(line.split("\t", 1) for line in library_text(lib.cophase_device_list).split("\n"))


def path_text(name: str, path: str | os.PathLike[str] | None) -> Any:
    """A path of the caller as C reads it; NULL for ``None``."""
    return ffi.NULL if path is None else text(name, path)


def absolute(directory: str | os.PathLike[str] | None) -> str:
    """The directory of the files of a scene for another process, which has another working directory."""
    return os.path.abspath("" if directory is None else os.fspath(directory))


def constants(prefix: str) -> dict[int, str]:
    """Names of the header's constants that begin with ``prefix``, in lower case, by their numbers."""
    names = (name for name in dir(lib) if name.startswith(prefix))
    return {getattr(lib, name): name[len(prefix) :].lower() for name in names}


#: Names of the numbers in a struct of the library, by field.
_WORDS: dict[str, dict[int, str]] = {
    "method": constants("COPHASE_METHOD_"),
    "policy": constants("COPHASE_POLICY_"),
    "ao_knowledge": constants("COPHASE_AO_KNOWLEDGE_"),
    "precision": {lib.COPHASE_F32: "f32", lib.COPHASE_F64: "f64"},
}


def named(field: str, value: Any) -> Any:
    """The value of a struct's field in Python: a bool, a name (``None`` for no name), or the number itself."""
    if field.startswith(("is_", "has_")):
        return value != 0
    if field == "status":
        return words(lib.cophase_status_name(value))
    return _WORDS[field].get(value) if field in _WORDS else value


def struct(kind: str, call: Any, *inputs: Any) -> SimpleNamespace:
    """The struct ``kind`` that ``call`` fills; its last arguments are the struct and its size."""
    out = ffi.new(f"{kind} *")
    check(call(*inputs, out, ffi.sizeof(kind)))
    return SimpleNamespace(**{name: named(name, getattr(out, name)) for name, _ in ffi.typeof(kind).fields})


def options(kind: str, **fields: Any) -> Any:
    """A struct of options. Fields that are ``None`` have the library's defaults, for which C has 0; so 0 is refused.

    A read noise of 0 electrons is no default: C has a field of its own that says so.
    """
    out = ffi.new(f"{kind} *")
    out.struct_size = ffi.sizeof(kind)
    for name, value in fields.items():
        if value is None:
            continue
        if name == "read_noise_e":
            out.has_read_noise = 1
        elif isinstance(value, (int, float)) and value == 0:
            raise ValueError(f"{name} is 0: another number is accepted, or None for the default")
        try:
            setattr(out, name, value)
        except (OverflowError, TypeError) as error:
            raise type(error)(f"{name} is {value!r}: {error}") from None
    return out
