"""Attributes in docstrings of Python classes: those that share a line, `phasing_nm, ncpa_nm : array`, get an entry each."""

from __future__ import annotations

import re

from sphinx.application import Sphinx

from .text import escaped

# Before napoleon, which has the default priority of 500.
_PRIORITY = 400


def _split(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    if "Attributes" not in lines:
        return
    start = lines.index("Attributes") + 2
    entries: list[list[str]] = []
    end = start
    for end, line in enumerate(lines[start:] + ["Section", "---"], start):
        if line and not line.startswith(" "):
            if end + 1 >= len(lines) or lines[end + 1].startswith("---"):
                break
            entries.append([])
        entries[-1].append(line)
    out: list[str] = []
    for first, *rest in entries:
        names, _, kind = first.partition(" : ")
        text = "\n".join(rest).strip()
        # The type is text: words in it, as in `(modes,) array`, are no names of Python.
        described = f"*{escaped(kind)}*: {text}" if kind else text
        for one in re.split(r", ", names):
            out += [one, *f"    {described}".splitlines()]
    lines[start:end] = out


def _skip(app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object) -> bool | None:
    """Fields of a named tuple are in its docstring."""
    return True if type(obj).__name__ == "_tuplegetter" else None


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("autodoc-skip-member", _skip)
    app.connect("autodoc-process-docstring", _split, priority=_PRIORITY)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
