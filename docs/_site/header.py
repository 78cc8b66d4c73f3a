"""C headers of the library as data: sections of documented functions, types and constants.

The headers are made by cbindgen (tests/header.rs) and have one form: a comment, then a declaration that ends with a
semicolon, or a line `#define NAME NUMBER`. A line of dashes around a title begins a section.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

_COMMENT = re.compile(r"^/\*(?P<comment>.*?)\*/\n(?P<rest>[^\n]*)", re.DOTALL | re.MULTILINE)
_TITLE = re.compile(r"\s*-{5,} (?P<title>.+?) -{5,}\s*")
_DEFINE = re.compile(r"#define (?P<name>\w+) (?P<value>-?\d+)")
_FUNCTION = re.compile(r"(?P<result>.+?[ *])(?P<name>cophase_\w+)\((?P<arguments>.*)\)", re.DOTALL)


@dataclass
class Item:
    """A documented declaration."""

    kind: str  # "macro", "function", "type" or "struct"
    name: str
    declaration: str
    comment: str
    value: int | None = None
    members: list["Item"] = field(default_factory=list)


@dataclass
class Section:
    title: str
    items: list[Item] = field(default_factory=list)


@dataclass
class Header:
    """The comment at the top of a header, and its sections."""

    introduction: str
    sections: list[Section]

    def items(self) -> list[Item]:
        return [item for section in self.sections for item in section.items]


def read(path: Path) -> Header:
    """Reads a header; a declaration of a form that is not known is an error."""
    text = path.read_text("utf-8")
    comments = list(_COMMENT.finditer(text))
    header = Header(_plain(comments[0]["comment"]), [Section("")])
    end = 0
    for match in comments[1:]:
        if match.start() < end:  # a member of the struct before
            continue
        title = _TITLE.fullmatch(match["comment"])
        if title:
            header.sections.append(Section(title["title"]))
            continue
        item, end = _item(_plain(match["comment"]), text, match.start("rest"))
        header.sections[-1].items.append(item)
    header.sections = [section for section in header.sections if section.items]
    return header


def _plain(comment: str) -> str:
    """Text of a comment, without the stars at the beginning of its lines."""
    return re.sub(r"^ ?\* ?", "", comment.strip(), flags=re.MULTILINE).strip()


def _item(comment: str, text: str, start: int) -> tuple[Item, int]:
    """The declaration that begins at `start`, and its end."""
    define = _DEFINE.match(text, start)
    if define:
        return Item("macro", define["name"], define["name"], comment, int(define["value"])), define.end()
    if text.startswith("typedef struct {", start):
        return _struct(comment, text, start)
    end = text.index(";", start)
    declaration = " ".join(text[start:end].split())
    function = _FUNCTION.fullmatch(declaration)
    if function:
        return Item("function", function["name"], declaration, comment), end
    if declaration.startswith("typedef "):
        return Item("type", declaration.split()[-1], declaration.removeprefix("typedef "), comment), end
    raise ValueError(f"a declaration of an unknown form: {declaration}")


def _struct(comment: str, text: str, start: int) -> tuple[Item, int]:
    close = re.compile(r"^\} (?P<name>\w+);", re.MULTILINE).search(text, start)
    if not close:
        raise ValueError(f"a struct without an end: {text[start : start + 80]}")
    members = []
    for match in re.finditer(r"/\*(.*?)\*/\s*([^;]+);", text[start : close.start()], re.DOTALL):
        declaration = " ".join(match[2].split())
        name = re.findall(r"\w+", declaration.split("[")[0])[-1]
        members.append(Item("member", name, declaration, _plain(re.sub(r"^\s+", " ", match[1], flags=re.MULTILINE))))
    return Item("struct", close["name"], close["name"], comment, members=members), close.end()
