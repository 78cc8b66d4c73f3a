"""Plain text of the sources as reStructuredText."""

from __future__ import annotations

import re
import textwrap

_IDENTIFIER = re.compile(r"\b(?:cophase|COPHASE)_\w+")


def escaped(text: str) -> str:
    """Text without markup."""
    return re.sub(r"([\\*`|_])", r"\\\1", text)


def inline(text: str, roles: dict[str, str] | None = None) -> str:
    """A line: `code` in backticks as a literal, and identifiers of the C interface, whose role is in `roles`, as links."""
    parts = re.split(r"(`[^`]+`|\b(?:cophase|COPHASE)_\w+)", text)
    return "".join(_part(part, roles or {}) for part in parts)


def _part(part: str, roles: dict[str, str]) -> str:
    if re.fullmatch(r"`[^`]+`", part):
        return f"\\ ``{part[1:-1]}``\\ "
    if part in roles:
        return f"\\ :{roles[part]}:`{part}`\\ "
    return escaped(part)


def indented(text: str, by: int = 3) -> str:
    return textwrap.indent(text, " " * by)


def blocks(text: str) -> list[str]:
    """Paragraphs, which empty lines separate."""
    return [block for block in re.split(r"\n\s*\n", textwrap.dedent(text).strip("\n")) if block.strip()]


def notes(text: str, language: str) -> str:
    """Notes with indented examples: lines that are indented are code, others are text."""
    parts = []
    for block in blocks(text):
        groups: list[tuple[bool, list[str]]] = []
        for line in block.splitlines():
            is_code = line.startswith("  ")
            if not groups or groups[-1][0] != is_code:
                groups.append((is_code, []))
            groups[-1][1].append(line)
        for is_code, lines in groups:
            if is_code:
                code = indented(textwrap.dedent("\n".join(lines)))
                parts.append(f".. code-block:: {language}\n\n{code}")
            else:
                parts.append("\n".join(escaped(line) for line in lines))
    return "\n\n".join(parts)


def table(header: list[str], rows: list[list[str]]) -> str:
    """A table with one line of header; the cells are reStructuredText."""
    lines = [".. list-table::", "   :header-rows: 1", "   :widths: auto", ""]
    for row in [header, *rows]:
        for column, cell in enumerate(row):
            first, *rest = cell.splitlines() or [""]
            lines.append(f"   {'*' if column == 0 else ' '} - {first}")
            lines.extend(f"       {line}" for line in rest)
    return "\n".join(lines)


def heading(title: str, underline: str) -> str:
    return f"{title}\n{underline * len(title)}"
