"""Rust interface: links to the pages of rustdoc, which scripts/docs puts into the site's folder `rust`."""

from __future__ import annotations

import html
import os
import re
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from .repository import ROOT

FOLDER = "rust"
_ITEM = re.compile(r'<a href="([\w/.-]+)">([\w:]+)</a>')


def items() -> list[tuple[str, str]]:
    """Path and page of every public item, from rustdoc's list of all."""
    folder = Path(os.environ.get("COPHASE_RUSTDOC") or ROOT / "target/doc")
    return [(name, page) for page, name in _ITEM.findall((folder / "cophase/all.html").read_text("utf-8"))]


class RustReference(SphinxDirective):
    """Links to every public item, module by module."""

    def run(self) -> list[nodes.Node]:
        modules: dict[str, list[tuple[str, str]]] = {}
        for name, page in items():
            module = name.rpartition("::")[0]
            modules.setdefault(module, []).append((name.rpartition("::")[2], page))
        found: list[nodes.Node] = [self._link("The pages of rustdoc, with the conventions first", "index.html")]
        for module, names in sorted(modules.items()):
            title = f"cophase::{module}" if module else "cophase"
            section = nodes.section("", nodes.title("", title), ids=[nodes.make_id(title)])
            line = nodes.paragraph()
            for name, page in sorted(names):
                line += [*self._link(name, page).children, nodes.Text(" ")]
            section += line
            found.append(section)
        return found

    def _link(self, text: str, page: str) -> nodes.paragraph:
        root = "../" * self.env.docname.count("/")
        reference = nodes.reference("", html.unescape(text), refuri=f"{root}{FOLDER}/cophase/{page}", internal=True)
        return nodes.paragraph("", "", reference)


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("rust-reference", RustReference)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
