"""Scenes."""

from ._library import lib, scalar, text, words


def preset(name: str) -> str:
    """The text of a scene that comes with the library: ``keck-artificial`` or ``keck-onsky``."""
    return words(scalar("const char *", lib.cophase_scene_preset, text("name", name)))
