"""Check of the built site: everything that has a name is found by its search, no link is broken, no other host is asked.

Run by scripts/docs: python -m _site.check SITE
"""

from __future__ import annotations

import inspect
import json
import re
import sys
from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

from sphinx.search.en import SearchEnglish

from . import program, references

MATLAB = program.ROOT / "bindings/matlab/+cophase"


# Types of the objects that the search must find for a kind of name; other kinds are words of a page.
TYPES = {"scene key": "std:scene-key", "option": "std:cmdoption", "HDU": "std:hdu", "C": "c:", "Python": "py:", "MATLAB": "mat:"}


class Search:
    """Index of the site's search, asked as its script (searchtools.js) does."""

    def __init__(self, site: Path) -> None:
        text = (site / "searchindex.js").read_text("utf-8")
        self.index = json.loads(text.removeprefix("Search.setIndex(").rstrip(")"))
        self.stem = SearchEnglish({}).stem
        self.objects: list[tuple[str, str, str]] = []  # type, name, and the words about it
        for prefix, entries in self.index["objects"].items():
            for page, kind, _, _, name in entries:
                full = f"{prefix}.{name}" if prefix else name
                about = f"{full} {self.index['objnames'][str(kind)][2]} {self.index['titles'][page]}"
                self.objects.append((self.index["objtypes"][str(kind)], full.lower(), about.lower()))

    def finds(self, kind: str, name: str) -> bool:
        """Whether the query `name` finds an object of this kind, or a page for a kind without objects."""
        words = [word.lower() for word in re.findall(r"\w+", name)]
        if kind in TYPES:
            objects = (found for found in self.objects if found[0].startswith(TYPES[kind]))
            return any(words[-1] in full and all(word in about for word in words) for _, full, about in objects)
        pages = [self._pages(word) for word in words]
        return bool(set.intersection(*pages))

    def _pages(self, word: str) -> set[int]:
        found: set[int] = set()
        for table in (self.index["terms"], self.index["titleterms"]):
            pages = table.get(self.stem(word), table.get(word, []))
            found |= set(pages if isinstance(pages, list) else [pages])
        return found


def names() -> Iterator[tuple[str, str]]:
    """Kind and name of everything that must be found, from the program, the headers, the packages and the files."""
    for section in program.scene_reference()[1]:
        yield from (("scene key", key.name) for key in section.keys)
    for verb in program.command_line()["verbs"]:
        yield "verb", f"cophase {verb['name']}"
        flags = (argument["long"] for argument in verb["arguments"] if argument["long"] and argument["id"] != "help")
        yield from (("option", f"cophase {verb['name']} {flag}") for flag in flags if flag != "--quiet")
    for header in references._headers().values():
        yield from (("C", item.name) for item in header.items())
    yield from (("Python", name) for name in _python())
    yield from (("MATLAB", name) for name in _matlab())
    for _, _, hdus in references.written_files():
        yield from (("HDU", hdu.name) for hdu in hdus)
    yield from (("status", status) for status in _statuses())


def _python() -> Iterator[str]:
    """Public functions, classes and methods of the Python package."""
    import cophase

    for name in cophase.__all__:
        yield f"cophase.{name}"
        one = getattr(cophase, name)
        if inspect.isclass(one) and not issubclass(one, (tuple, BaseException)):
            members = [key for kind in one.__mro__[:-1] for key in vars(kind) if not key.startswith("_")]
            yield from (f"cophase.{name}.{member}" for member in members if callable(getattr(one, member)))


def _matlab() -> Iterator[str]:
    """Functions, classes and public methods of the MATLAB package."""
    for path in sorted(MATLAB.glob("*.m")):
        yield f"cophase.{path.stem}"
        text = path.read_text("utf-8")
        for block in re.findall(r"^    methods\n(.*?)^    end$", text, re.DOTALL | re.MULTILINE):
            methods = re.findall(r"^        function (?:.*? = )?(\w+)\(", block, re.MULTILINE)
            yield from (f"cophase.{path.stem}.{method}" for method in methods if method != path.stem)


def _statuses() -> Iterator[str]:
    import cophase

    yield from (kind.status for kind in cophase.Error.__subclasses__())


class Links(HTMLParser):
    """Links and anchors of a page, and what it loads."""

    LOADS = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src", "video": "src"}

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.anchors: set[str] = set()
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        values = dict(attributes)
        self.anchors |= {value for key in ("id", "name") if (value := values.get(key))}
        if tag == "a" and values.get("href"):
            self.links.append(str(values["href"]))
        loaded = values.get(self.LOADS.get(tag, ""))
        if loaded and values.get("rel") not in {"canonical", "next", "prev"}:
            self.loads.append(loaded)


def broken(site: Path) -> Iterator[str]:
    """Links within the site without a target, and loads from other hosts."""
    parsed = cache(Links)
    # rustdoc checks its own links.
    for path in sorted(page for page in site.rglob("*.html") if page.relative_to(site).parts[0] != "rust"):
        page = parsed(path)
        name = path.relative_to(site)
        for load in page.loads:
            if re.match(r"(?:\w+:)?//", load):
                yield f"{name} loads {load}"
        for link in {*page.links, *page.loads}:
            target, anchor = urldefrag(link)
            if re.match(r"\w+:|//", link):
                continue
            file = (path.parent / unquote(target.partition("?")[0])).resolve() if target else path
            if file.is_dir():
                file = file / "index.html"
            if not file.exists():
                yield f"{name} links to {link}, which does not exist"
            elif anchor and file.suffix == ".html" and unquote(anchor) not in parsed(file).anchors:
                yield f"{name} links to {link}, which has no such anchor"
    for path in site.rglob("_static/**/*.css"):
        for url in re.findall(r"(?:url\(|@import)\s*[\"']?(https?:[^\"')]+)", path.read_text("utf-8")):
            yield f"{path.relative_to(site)} loads {url}"


def main(site: Path) -> int:
    search = Search(site)
    wanted = sorted(set(names()))
    kinds = sorted({kind for kind, _ in wanted})
    missing = [f"the search does not find the {kind} {name}" for kind, name in wanted if not search.finds(kind, name)]
    problems = missing + list(broken(site))
    for problem in problems:
        print(problem, file=sys.stderr)
    counts = ", ".join(f"{sum(kind == one for kind, _ in wanted)} ({one})" for one in kinds)
    print(f"names looked up in the search: {counts}; {len(problems)} problems")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
