"""Headers of FITS files: the HDUs of a file, with their cards, shapes, units and columns."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

_BLOCK = 2880
_CARD = 80
# Cards of the format, of checksums, and of the columns and axes, which the tables of the reference show in another form.
_FORMAL = re.compile(
    r"SIMPLE|BITPIX|NAXIS\d*|EXTEND|XTENSION|PCOUNT|GCOUNT|TFIELDS|TTYPE\d+|TFORM\d+|TUNIT\d+|EXTNAME|EXTVER|BUNIT|"
    r"CHECKSUM|DATASUM|ORIGIN|DATE|COMMENT|HISTORY|END|TDIM\d+|TNULL\d+|BSCALE|BZERO|INHERIT|"
)


@dataclass
class Hdu:
    """An HDU. Axes are in C order: the last varies fastest."""

    name: str
    version: int
    kind: str  # "cards", "image" or "table"
    axes: list[int]
    unit: str
    columns: list[tuple[str, str]] = field(default_factory=list)  # name and unit
    cards: list[tuple[str, str]] = field(default_factory=list)  # keyword and comment


def read(path: Path) -> list[Hdu]:
    """The HDUs of a file without compression."""
    data = path.read_bytes()
    hdus: list[Hdu] = []
    at = 0
    while at < len(data):
        cards: dict[str, tuple[str, str]] = {}
        while "END" not in cards:
            block = data[at : at + _BLOCK].decode("ascii")
            at += _BLOCK
            for start in range(0, _BLOCK, _CARD):
                keyword, value, comment = _card(block[start : start + _CARD])
                cards.setdefault(keyword, (value, comment))
        hdu, size = _hdu(cards)
        hdus.append(hdu)
        at += math.ceil(size / _BLOCK) * _BLOCK
    return hdus


def _card(text: str) -> tuple[str, str, str]:
    """Keyword, value and comment."""
    keyword, rest = text[:8].strip(), text[8:]
    if not rest.startswith("= "):
        return keyword, "", ""
    match = re.match(r"= \s*('(?:[^']|'')*'|[^/]*)\s*(?:/\s*(.*))?", rest)
    value = match[1].strip() if match else ""
    return keyword, value.strip("'").strip(), (match[2] or "").strip() if match else ""


def _hdu(cards: dict[str, tuple[str, str]]) -> tuple[Hdu, int]:
    """The HDU of these cards, and the bytes of its data."""
    number = lambda keyword, default=0: int(cards.get(keyword, (str(default), ""))[0])
    value = lambda keyword: cards.get(keyword, ("", ""))[0]
    axes = [number(f"NAXIS{axis}") for axis in range(number("NAXIS"), 0, -1)]
    size = abs(number("BITPIX")) // 8 * math.prod(axes) + number("PCOUNT") if axes else 0
    is_table = value("XTENSION") == "BINTABLE"
    fields = range(1, number("TFIELDS") + 1)
    shown = [(keyword, comment) for keyword, (_, comment) in cards.items() if not _FORMAL.fullmatch(keyword)]
    hdu = Hdu(
        name=value("EXTNAME") or "PRIMARY",
        version=number("EXTVER", 1),
        kind="table" if is_table else "image" if axes else "cards",
        axes=axes[:1] if is_table else axes,
        unit=value("BUNIT"),
        columns=[(value(f"TTYPE{k}"), value(f"TUNIT{k}")) for k in fields],
        cards=shown,
    )
    return hdu, size
