"""Links of pages to files of the repository outside docs/.

A link to a file that is a page of the site, such as CHANGELOG.md, leads to that page; one to another file to a page with its
text; one to a folder is text.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from docutils import nodes
from pygments.lexers import get_lexer_for_filename
from pygments.util import ClassNotFound
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
PREFIX = "repository"

# Pages that include a file from outside docs/, with that file.
INCLUDED = {
    "project/architecture": "ARCHITECTURE.md",
    "project/bindings": "bindings/README.md",
    "project/changelog": "CHANGELOG.md",
    "project/peers": "benches/peers/README.md",
}


class RepositoryLinks(SphinxTransform):
    """Replaces links by path, before the builder takes them for downloads or for pages that do not exist."""

    default_priority = 400

    def apply(self, **kwargs: object) -> None:
        kinds = (addnodes.download_reference, addnodes.pending_xref)
        for node in list(self.document.findall(lambda node: isinstance(node, kinds))):
            if node.get("reftype") == "myst" and not node["reftarget"].startswith("#"):
                self._replace(node)

    def _replace(self, node: nodes.Element) -> None:
        page = self.env.docname
        target, _, anchor = node["reftarget"].partition("#")
        if node.get("refdomain") == "doc":  # a path that MyST has made one from docs/
            folder, anchor = DOCS, node.get("reftargetid") or ""
            target = target if Path(target).suffix == ".md" else f"{target}.md"
        else:
            folder = (ROOT / INCLUDED[page]).parent if page in INCLUDED else (DOCS / page).parent
        path = Path(os.path.normpath(folder / target))
        if not path.is_relative_to(ROOT) or not path.exists():
            return  # MyST knows it, or warns
        document = _page_of(path)
        if document:
            xref = addnodes.pending_xref(
                "", *node.children, refdomain="doc", reftype="myst", reftarget=document, reftargetid=anchor or None,
                refdoc=page, refexplicit=True,
            )  # fmt: skip
            node.replace_self(xref)
        elif path.is_dir():
            node.replace_self(list(node.children))
        elif path.suffix not in {".png", ".svg"}:
            name = path.relative_to(ROOT).as_posix()
            self.env.metadata[page].setdefault("repository", []).append(name)
            self.env.note_dependency(str(path))
            uri = self.app.builder.get_relative_uri(page, f"{PREFIX}/{name}")
            node.replace_self(nodes.reference("", "", *node.children, internal=True, refuri=uri))


def _page_of(path: Path) -> str | None:
    """The page of a file, if it is one."""
    name = path.relative_to(ROOT).as_posix()
    for page, included in INCLUDED.items():
        if included == name:
            return page
    if path.is_relative_to(DOCS) and path.suffix in {".md", ".rst"}:
        return path.relative_to(DOCS).with_suffix("").as_posix()
    return None


def _pages(app: Sphinx) -> Iterator[tuple[str, dict[str, object], str]]:
    """A page for each file that a link leads to."""
    names = {name for metadata in app.env.metadata.values() for name in metadata.get("repository", [])}
    for name in sorted(names):
        text = (ROOT / name).read_text("utf-8")
        try:
            language = get_lexer_for_filename(name, text).aliases[0]
        except ClassNotFound:
            language = "text"
        code = app.builder.highlighter.highlight_block(text, language, linenos=False)
        body = f"<h1>{name}</h1>\n{code}"
        yield f"{PREFIX}/{name}", {"parents": [], "title": name, "body": body}, "page.html"


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_transform(RepositoryLinks)
    app.connect("html-collect-pages", _pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
