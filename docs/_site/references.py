"""Directives of the reference pages. Each makes its page from the program, the header or the files that the program writes."""

from __future__ import annotations

import shlex
import tempfile
from functools import cache
from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from . import fits, header, program
from .text import blocks, escaped, heading, indented, inline, notes, table

ROOT = program.ROOT
HEADERS = {name: ROOT / "include" / name for name in ("cophase.h", "cophase_simulator.h")}


class Reference(SphinxDirective):
    """A directive without arguments whose content is reStructuredText that `text` returns."""

    def run(self) -> list[nodes.Node]:
        for path in HEADERS.values():
            self.env.note_dependency(str(path))
        return self.parse_text_to_nodes(self.text(), allow_section_headings=True)

    def text(self) -> str:
        raise NotImplementedError


class SceneReference(Reference):
    """Every key of a scene."""

    def text(self) -> str:
        introduction, sections = program.scene_reference()
        return "\n\n".join([escaped(introduction), *map(self._section, sections)])

    @staticmethod
    def _section(section: program.SceneSection) -> str:
        parts = [heading(f"[{section.name}]", "-"), escaped(section.meaning)]
        for key in section.keys:
            unit = f" ({key.unit})" if key.unit else ""
            facts = "\n".join(f":{name}: {escaped(value)}" for name, value in key.facts)
            parts.append(f".. scene-key:: {key.name}{unit}\n\n{indented(escaped(key.meaning))}\n\n{indented(facts)}")
        return "\n\n".join(parts)


class CommandLineReference(Reference):
    """Every verb and option of the program."""

    def text(self) -> str:
        description = program.command_line()
        common = [argument for argument in description["arguments"] if argument["id"] != "version"]
        parts = [
            escaped(description["about"]),
            notes(description["notes"], "text"),
            heading("Options of every verb", "-"),
            ".. program:: cophase",
            *map(self._argument, common),
        ]
        for verb in description["verbs"]:
            parts += self._verb(verb)
        return "\n\n".join(parts)

    def _verb(self, verb: dict) -> list[str]:
        own = [argument for argument in verb["arguments"] if not argument["global"] and argument["id"] != "help"]
        return [
            heading(f"cophase {verb['name']}", "-"),
            escaped(verb["about"]),
            f".. code-block:: text\n\n{indented(verb['usage'])}",
            f".. program:: cophase {verb['name']}",
            *map(self._argument, own),
            notes(verb["notes"], "text"),
        ]

    @staticmethod
    def _argument(argument: dict) -> str:
        values = " ".join(f"<{value}>" for value in argument["values"])
        words = [word for word in (argument["short"], argument["long"]) if word]
        signature = ", ".join(f"{word} {values}".strip() for word in words) or argument["values"][0]
        facts = []
        if argument["required"]:
            facts.append("Required.")
        if argument["default"]:
            facts.append(f"Default: ``{' '.join(argument['default'])}``.")
        if argument["accepted"]:
            facts.append(f"Accepted: {', '.join(f'``{value}``' for value in argument['accepted'])}.")
        meaning = argument["help"].rstrip(".") + "."
        return f".. option:: {signature}\n\n{indented(escaped(meaning))} {' '.join(facts)}"


@cache
def _headers() -> dict[str, header.Header]:
    return {name: header.read(path) for name, path in HEADERS.items()}


@cache
def _roles() -> dict[str, str]:
    """Role of each identifier of the headers."""
    roles = {"macro": "c:macro", "function": "c:func", "type": "c:type", "struct": "c:struct"}
    return {item.name: roles[item.kind] for one in _headers().values() for item in one.items()}


class HeaderReference(Reference):
    """Every declaration of the C headers, with its comment."""

    def text(self) -> str:
        parts = []
        for name, one in _headers().items():
            parts.append(heading(name, "="))
            contract = one.introduction.partition("CONTRACT\n")[2]
            if contract:
                parts += [heading("Contract", "-"), "\n".join(inline(line, _roles()) for line in contract.splitlines())]
            for section in one.sections:
                parts.append(heading(section.title or "Simulator", "-"))
                parts += map(self._item, section.items)
        return "\n\n".join(parts)

    def _item(self, item: header.Item) -> str:
        comment = indented(self._comment(item))
        if item.kind == "macro":
            return f".. c:macro:: {item.name}\n\n{comment}\n\n   :Value: {item.value}"
        if item.kind == "struct":
            members = "\n\n".join(
                f".. c:member:: {member.declaration}\n\n{indented(self._comment(member))}" for member in item.members
            )
            return f".. c:struct:: {item.name}\n\n{comment}\n\n{indented(members)}"
        return f".. c:{item.kind}:: {item.declaration}\n\n{comment}"

    @staticmethod
    def _comment(item: header.Item) -> str:
        """Paragraphs; lines `name: meaning` of a function's arguments are a list of definitions."""
        parts = []
        for block in blocks(item.comment):
            name = block.partition(":")[0]
            if item.kind == "function" and name.isidentifier() and name in item.declaration:
                parts.append(_definitions(block))
            else:
                parts.append("\n".join(inline(line, _roles()) for line in block.splitlines()))
        return "\n\n".join(parts)


def _definitions(block: str) -> str:
    """Lines `name: meaning`, where lines that go on are indented."""
    lines = []
    for line in block.splitlines():
        name, colon, meaning = line.partition(": ")
        if colon and not line.startswith(" "):
            names = ", ".join(f"``{word}``" for word in name.split(", "))
            lines += [names, f"   {inline(meaning, _roles())}"]
        else:
            lines.append(f"   {inline(line.strip(), _roles())}")
    return "\n".join(lines)


class StatusReference(Reference):
    """Status of a call and of an image, in C, Python and MATLAB."""

    def text(self) -> str:
        import cophase  # the package on the library that scripts/docs names

        exceptions = {kind.status: kind.__name__ for kind in cophase.Error.__subclasses__()}
        items = [item for item in _headers()["cophase.h"].items() if item.kind == "macro"]
        first = next(index for index, item in enumerate(items) if item.name == "COPHASE_OK")
        statuses = [item for item in items[first:] if item.value is not None]
        last = next(index for index, item in enumerate(statuses) if item.name == "COPHASE_IMAGE_DEADLINE")
        calls, images = [], []
        for item in statuses[: last + 1]:
            if item.name.startswith("COPHASE_IMAGE_"):
                word = item.name.removeprefix("COPHASE_IMAGE_")
                meaning = item.comment.removeprefix("Image status: ")
                in_files = word.lower().replace("_", "-")
                images.append(
                    [str(item.value), f":c:macro:`{item.name}`", f"``{word}``", f"``{in_files}``", inline(meaning)]
                )
                continue
            word = item.name.removeprefix("COPHASE_")
            python = f":py:exc:`cophase.{exceptions[word]}`" if word in exceptions else ""
            matlab = f"``cophase:{word}``" if python else ""
            calls.append([str(item.value), f":c:macro:`{item.name}`", python, matlab, inline(item.comment)])
        return "\n\n".join(
            [
                heading("Calls", "-"),
                table(["Number", "C", "Python", "MATLAB and Octave", "Meaning"], calls),
                heading("Images", "-"),
                table(["Number", "C", "Python, MATLAB", "Program, files", "Meaning"], images),
            ]
        )


class FileReference(Reference):
    """HDUs of the files that the program writes, from files that it writes for small scenes."""

    def text(self) -> str:
        parts = []
        for title, command, hdus in written_files():
            parts += [heading(title, "-"), f".. code-block:: sh\n\n   {command}"]
            parts += [self._hdu(title, hdu) for hdu in hdus]
        return "\n\n".join(parts)

    @staticmethod
    def _hdu(title: str, hdu: fits.Hdu) -> str:
        shape = " × ".join(map(str, hdu.axes))
        sizes = {"table": f"table of {shape} rows", "image": f"image, {shape}", "cards": "cards"}
        unit = f", in {hdu.unit}" if hdu.unit else ""
        parts = [f".. hdu:: {hdu.name} ({title})\n\n   {sizes[hdu.kind].capitalize()}{unit}."]
        if hdu.columns:
            columns = (f"``{name}``" + (f" ({escaped(unit)})" if unit else "") for name, unit in hdu.columns)
            parts.append(f"   :Columns: {', '.join(columns)}")
        if hdu.cards:
            cards = (f"``{keyword}``" + (f" {escaped(comment)}" if comment else "") for keyword, comment in hdu.cards)
            parts.append(f"   :Cards: {'; '.join(cards)}")
        return "\n\n".join(parts)


@cache
def written_files() -> list[tuple[str, str, list[fits.Hdu]]]:
    """Title, command and HDUs of each kind of file. The scenes of the tests are small: all takes 10 s."""
    tests = ROOT / "tests/c_api"
    tiny = tests / "tiny.toml"
    artificial = ["--set", "aberrations.segment_piston_rms_nm=30", "--set", "image.peak_snr=100"]
    watch = ["watch", "frames", "--scene", tiny, "--state", "night.db", "--once", "--no-page", "--corrections", "watched.fits"]
    # Segments whose reflectivities the images show to differ, and controllers, so that their HDUs are written.
    uneven = [*("--set", "image.count=3"), *("--set", "image.peak_snr=300"), *("--set", "faults.segment_reflectivity_rms=0.3")]
    tables = {"segments.txt": 36, "actuators.txt": 79}
    channels = ["--set", "commands.segment_file=segments.txt", "--set", "commands.actuator_file=actuators.txt"]
    commands: list[tuple[str, list[str | Path], dict[str, str]]] = [
        ("Simulated images", ["image", tiny, "-o", "images.fits", *artificial], {"images.fits": ""}),
        (
            "Estimate",
            ["estimate", "images.fits", "-o", "est.fits", "--opd", "opd.fits", "--set", 'estimate.fit_optics=["plate-scale"]'],
            {"est.fits": "", "opd.fits": "OPD map"},
        ),
        ("Part of an estimate", ["estimate", "images.fits", "-o", "part.fits", "--part", "1/1"], {"part.fits": ""}),
        ("Reduced images", ["reduce", "images.fits", "--scene", tiny, "-o", "frames/reduced.fits"], {"frames/reduced.fits": ""}),
        ("Watch", watch, {}),
        ("Night", ["watch", "--export", "night.fits", "--state", "night.db"], {"night.fits": ""}),
        (
            "Simulated exposures behind adaptive optics",
            ["simulate", tests / "small.toml", "-o", "onsky.fits", "--aot", "aot.fits", *uneven],
            {"onsky.fits": "", "aot.fits": "Exposures behind adaptive optics in the format AOT"},
        ),
        (
            "MAP estimate",
            ["estimate", "onsky.fits", "-o", "deep.fits", "--method", "full-phase", "--commands", "corrections.fits", *channels],
            {"deep.fits": "", "corrections.fits": "Corrections"},
        ),
    ]
    found = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "frames").mkdir()
        for file, count in tables.items():
            (folder / file).write_text("".join(f"{number} channel-{number} 0.001\n" for number in range(count)), "utf-8")
        for title, words, files in commands:
            program.run(*words, folder=folder)
            command = shlex.join(["cophase", *(word.name if isinstance(word, Path) else word for word in words)])
            for file, other in files.items():
                found.append((other or title, command, fits.read(folder / file)))
    return found


def _scene_key(env, signature: str, node: addnodes.desc_signature) -> str:
    """Signature of a key: its name, and its unit in parentheses."""
    name, _, unit = signature.partition(" ")
    section, _, key = name.rpartition(".")
    node += addnodes.desc_addname(f"{section}.", f"{section}.")
    node += addnodes.desc_name(key, key)
    if unit:
        node += addnodes.desc_annotation(f" {unit}", f" {unit}")
    return name


def _hdu(env, signature: str, node: addnodes.desc_signature) -> str:
    """Signature of an HDU: its name; the file in parentheses tells those of one name apart."""
    node += addnodes.desc_name(signature.partition(" ")[0], signature.partition(" ")[0])
    return signature


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_object_type("scene-key", "scene-key", "%s (scene key)", _scene_key, objname="scene key")
    app.add_object_type("hdu", "hdu", "%s (HDU)", _hdu, objname="HDU")
    app.add_directive("scene-reference", SceneReference)
    app.add_directive("command-line-reference", CommandLineReference)
    app.add_directive("header-reference", HeaderReference)
    app.add_directive("status-reference", StatusReference)
    app.add_directive("file-reference", FileReference)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
