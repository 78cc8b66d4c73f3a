"""Tutorials in other languages: a program in C or a script in MATLAB with what it prints, on the page of the tutorial in Python.

The program runs when the page is read, on the library of COPHASE_LIBRARY, and must find what the tutorial finds (`_disagreements`).
Where Octave is not installed the script is shown alone, unless COPHASE_REQUIRE_OCTAVE is 1.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from .program import ROOT

TUTORIALS = ROOT / "docs/tutorials"
LIBRARY = Path(os.environ.get("COPHASE_LIBRARY") or ROOT / "target/debug/deps/libcophase.so")
_FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]

# A result in what a tutorial prints, as in `phasing: 63.8 ± 0.5 nm`.
_RESULT = re.compile(r"^ *(\w.*): (-?[\d.]+) ± ([\d.]+) nm", re.MULTILINE)

# The images of two languages have the same truth and independent noise, so their difference has a standard deviation of sqrt(2)
# sigma; 4 of these are exceeded by 1 of 16,000. Error bars depend on the noise where channels are combined: they are scaled by the
# root of the reduced chi-square of 17 degrees of freedom where that is above 1, which exceeds 1.65 in 1 of 6,000.
_STANDARD_DEVIATIONS = 4.0
_ERROR_BAR_RATIO = 1.65


class TutorialForm(SphinxDirective):
    """`.. tutorial-form:: FILE [HEADER]`: a file of docs/tutorials, behind a header if one is named, and what it prints."""

    required_arguments = 1
    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        path = TUTORIALS / self.arguments[0]
        shown = [*(TUTORIALS / header for header in self.arguments[1:]), path]
        found = [self._code(file) for file in shown]
        printed = _printed(path)
        if printed is None:
            return [*found, nodes.paragraph("", "Octave was not installed where this page was made: the script was not run.")]
        page = Path(self.env.doc2path(self.env.docname)).read_text("utf-8")
        problems = _disagreements(page, printed)
        if problems:
            raise self.error(f"{path.name} and the tutorial in Python disagree: {'; '.join(problems)}")
        output = nodes.literal_block(printed, printed, language="none", classes=["sphx-glr-script-out"])
        return [*found, output]

    def _code(self, file: Path) -> nodes.Node:
        self.env.note_dependency(str(file))
        text = file.read_text("utf-8")
        block = nodes.literal_block(text, text, language="c" if file.suffix in {".c", ".h"} else "matlab")
        caption = nodes.caption("", file.name)
        return nodes.container("", caption, block, literal_block=True, classes=["literal-block-wrapper"])


def _printed(path: Path) -> str | None:
    """Standard output of a program; None of a script where Octave is not installed."""
    with tempfile.TemporaryDirectory() as folder:
        if path.suffix == ".c":
            program = Path(folder) / path.stem
            links = ["-L", LIBRARY.parent, "-lcophase", "-lm", f"-Wl,-rpath,{LIBRARY.parent}"]
            _run(["cc", *_FLAGS, "-I", ROOT / "include", path, *links, "-o", program], folder)
            return _run([program], folder)
        if not (shutil.which("octave-cli") and shutil.which("mkoctfile")):
            if os.environ.get("COPHASE_REQUIRE_OCTAVE") == "1":
                raise RuntimeError("octave-cli or mkoctfile is missing")
            return None
        # The same numbers in every build of the site.
        setup = f"addpath('{ROOT / 'bindings/matlab'}', '{_gateway().name}'); randn('state', 1);"
        return _run(["octave-cli", "--norc", "--quiet", "--eval", f"{setup} run('{path}')"], folder)


@cache
def _gateway() -> tempfile.TemporaryDirectory:
    """A folder with the gateway from Octave to the library, which is built once."""
    folder = tempfile.TemporaryDirectory()
    build = f"addpath('{ROOT / 'bindings/matlab'}'); build('{LIBRARY.parent}', '{folder.name}')"
    _run(["octave-cli", "--norc", "--quiet", "--eval", build], folder.name)
    return folder


def _run(words: list[str | Path], folder: str) -> str:
    environment = {**os.environ, "HOME": folder, "LD_LIBRARY_PATH": str(LIBRARY.parent)}
    done = subprocess.run(list(map(str, words)), cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(map(str, words))}: exit status {done.returncode}: {done.stderr}")
    return done.stdout


def _disagreements(page: str, printed: str) -> list[str]:
    """Results of a program that differ from those of the tutorial by more than their error bars explain."""
    results = lambda text: {name: (float(value), float(sigma)) for name, value, sigma in _RESULT.findall(text)}
    expected, found = results(page), results(printed)
    if not found or not set(found) <= set(expected):
        return [f"results {sorted(found)}, in Python {sorted(expected)}"]
    problems = []
    for name, (value, sigma) in found.items():
        python, python_sigma = expected[name]
        if abs(value - python) > _STANDARD_DEVIATIONS * math.hypot(sigma, python_sigma):
            problems.append(f"{name} {value} ± {sigma} nm, in Python {python} ± {python_sigma} nm")
        if abs(math.log(sigma / python_sigma)) > math.log(_ERROR_BAR_RATIO):
            problems.append(f"error bar of {name} {sigma} nm, in Python {python_sigma} nm")
    return problems


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("tutorial-form", TutorialForm)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
