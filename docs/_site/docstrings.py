"""Docstrings of Python in NumPy's style, before napoleon reads them.

Types are text: words in them, as in `(modes,) array`, are no names of Python. Attributes that share a line, as in
`phasing_nm, ncpa_nm : array`, get an entry each.
"""

from __future__ import annotations

from sphinx.application import Sphinx

from .text import escaped

# Before napoleon, which has the default priority of 500.
_PRIORITY = 400


def _rewrite(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    out: list[str] = []
    section = ""
    for line, following in zip(lines, [*lines[1:], ""]):
        if following and set(following) == {"-"}:
            section = line
            out.append(line)
        elif section == "Attributes" and line and line[0] not in " -":
            names, _, kind = line.partition(" : ")
            rest = _indented_below(lines, line)
            for one in names.split(", "):
                out += [one, f"    *{escaped(kind)}*", *([""] if rest else []), *rest]
        elif section == "Attributes" and line.startswith(" "):
            continue  # with its entry
        elif section == "Parameters" and " : " in line and not line.startswith(" "):
            names, _, kind = line.partition(" : ")
            out.append(f"{names} : *{escaped(kind)}*")
        elif section == "Returns" and line and line[0] not in " -":
            out.append(f"*{escaped(line)}*")
        else:
            out.append(line)
    lines[:] = out


def _indented_below(lines: list[str], line: str) -> list[str]:
    """The indented lines below `line`."""
    rest = []
    for below in lines[lines.index(line) + 1 :]:
        if not below.startswith(" "):
            break
        rest.append(below)
    return rest


def _skip(app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object) -> bool | None:
    """Fields of a named tuple are in its docstring."""
    return True if type(obj).__name__ == "_tuplegetter" else None


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("autodoc-skip-member", _skip)
    app.connect("autodoc-process-docstring", _rewrite, priority=_PRIORITY)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
