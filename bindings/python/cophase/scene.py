"""Scenes."""

from ._library import lib, result, text, words


def preset(name: str) -> str:
    """Text of a scene that comes with the library: ``keck-artificial`` or ``keck-onsky``."""
    return words(result("const char *", lib.cophase_scene_preset, text("name", name)))
