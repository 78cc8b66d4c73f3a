"""The wheel of the Python package, built and used where no source tree is; run by tests/c_api/main.rs, see there:

    python3 wheel.py PACKAGE SCRATCH SCENE.toml

COPHASE_LIBRARY and COPHASE_HEADER name what goes into it.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

#: What somebody does who has only the wheel.
USE = """
import cophase, pathlib, sys
from cophase import _library
model = cophase.Model(pathlib.Path(sys.argv[1]).read_text())
assert model.modes > 0 and cophase.Session(model).capacity == 1
assert _library._HERE == pathlib.Path("installed/cophase").resolve(), _library._HERE
assert not (_library._ROOT / "include").exists()
"""


def pip(*arguments, folder):
    command = [sys.executable, "-m", "pip", *arguments, "--quiet", "--no-index", "--no-deps"]
    subprocess.run(command, cwd=folder, check=True)


def main(package, scratch, scene):
    scratch = Path(scratch)
    # What setuptools leaves behind stays in the copy.
    shutil.copytree(package, scratch / "package", ignore=shutil.ignore_patterns("build", "*.egg-info", "__pycache__"))
    pip("wheel", "--no-build-isolation", "./package", folder=scratch)
    (wheel,) = scratch.glob("cophase-*-py3-none-*.whl")
    assert "-any" not in wheel.name, wheel
    # As on a machine that has never seen the sources, where nothing names a library.
    for name in ("COPHASE_LIBRARY", "COPHASE_HEADER", "PYTHONPATH", "LD_LIBRARY_PATH"):
        os.environ.pop(name, None)
    pip("install", "--target", "installed", f"./{wheel.name}", folder=scratch)
    environment = {**os.environ, "PYTHONPATH": "installed"}
    subprocess.run([sys.executable, "-c", USE, scene], cwd=scratch, check=True, env=environment)


main(*sys.argv[1:])
