"""Puts the C library into the wheel, with the headers that it was built from.

cargo builds it, or COPHASE_LIBRARY (and COPHASE_HEADER, outside of the source tree) name files that exist already.
"""

import json
import os
import shutil
import subprocess
import sysconfig
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parents[2]
# The profile of what `make install` installs. Only the library alone gets its optimisation across crates.
CARGO = "cargo rustc --locked --profile release-lto --lib --crate-type cdylib --message-format json-render-diagnostics"


def built() -> Path:
    """The shared library, made by cargo."""
    messages = subprocess.run(CARGO.split(), cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout.splitlines()
    artifacts = (message for message in map(json.loads, messages) if message["reason"] == "compiler-artifact")
    *_, library = (artifact for artifact in artifacts if artifact["target"]["name"] == "cophase")
    return next(file for file in map(Path, library["filenames"]) if file.suffix in (".so", ".dylib", ".dll"))


class BuildWithLibrary(build_py):
    def run(self) -> None:
        super().run()
        # An editable package uses those of the source tree.
        if not self.editable_mode:
            header = Path(os.environ.get("COPHASE_HEADER", ROOT / "include/cophase.h"))
            library = Path(os.environ["COPHASE_LIBRARY"]) if "COPHASE_LIBRARY" in os.environ else built()
            for file in (header, header.with_name("cophase_simulator.h"), library):
                shutil.copy2(file, Path(self.build_lib, "cophase", file.name))


# No part of CPython is linked, so that the wheel is for any Python 3 of this platform.
platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
setup(cmdclass={"build_py": BuildWithLibrary}, options={"bdist_wheel": {"plat_name": platform}})
