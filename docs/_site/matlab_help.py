"""Help texts of MATLAB as reStructuredText: their indentation is layout, which markup takes for quotations."""

from __future__ import annotations

import re
import textwrap

from sphinx.application import Sphinx
from sphinxcontrib.mat_types import MatObject

from .text import indented, inline


def _as_markup(lines: list[str]) -> None:
    """Text stays text; lines that are farther in are code."""
    text = textwrap.dedent("\n".join(lines)).strip("\n")
    if not text.strip():
        return
    first, _, rest = text.partition("\n")
    # The name of the function in capitals begins a help text.
    first = re.sub(r"^[A-Z_0-9]+ {2,}", "", first)
    groups: list[tuple[bool, list[str]]] = [(False, [first, ""])]
    for line in textwrap.dedent(rest).splitlines():
        if not line.strip():
            groups[-1][1].append("")
            continue
        is_code = line.startswith("   ")
        if groups[-1][0] != is_code:
            groups.append((is_code, []))
        groups[-1][1].append(line)
    out: list[str] = []
    for is_code, group in groups:
        body = "\n".join(group).rstrip("\n")
        if is_code:
            language = "matlab" if out and out[-2:-1] == ["Example:"] else "text"
            out += [f".. code-block:: {language}", "", *indented(textwrap.dedent(body)).splitlines(), ""]
        else:
            out += [*inline(body).splitlines(), ""]
    lines[:] = out


def _matlab_only(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    if isinstance(obj, MatObject):
        _as_markup(lines)


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("autodoc-process-docstring", _matlab_only)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
