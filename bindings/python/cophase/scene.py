"""Scenes."""

from ._library import ffi, lib, scalar


def preset(name: str) -> str:
    """The text of a scene that comes with the library: ``keck-artificial`` or ``keck-onsky``."""
    return ffi.string(scalar("const char *", lib.cophase_scene_preset, name.encode())).decode()
