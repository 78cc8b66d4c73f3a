"""Descriptions that the program prints: keys of a scene, verbs and options; files that it writes."""

from __future__ import annotations

import json
import os
import re
import subprocess
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

# Seven hexagons and few modes, on few samples: each file of the reference is written within a second.
SCENE = ROOT / "tests/c_api/tiny.toml"


def run(*words: str | Path, folder: Path | None = None) -> str:
    """Standard output of the program, which scripts/docs names in COPHASE_PROGRAM."""
    program = os.environ.get("COPHASE_PROGRAM") or str(ROOT / "target/debug/cophase")
    done = subprocess.run([program, *map(str, words)], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"cophase {' '.join(map(str, words))}: exit status {done.returncode}: {done.stderr}")
    return done.stdout


@dataclass
class Key:
    """A key of a scene."""

    name: str  # section and key, as in image.pixels
    unit: str
    meaning: str
    facts: list[tuple[str, str]]  # accepted, default, read by


@dataclass
class SceneSection:
    name: str
    meaning: str
    keys: list[Key] = field(default_factory=list)


@cache
def scene_reference() -> tuple[str, list[SceneSection]]:
    """Introduction and sections of `cophase scene --reference`."""
    introduction: list[str] = []
    sections: list[SceneSection] = []
    for line in run("scene", "--reference").splitlines():
        section = re.fullmatch(r"\[+([\w.-]+)\]+ ?(.*)", line)
        key = re.fullmatch(r"  (\w+)(?: \((.+?)\))?: (.*)", line)
        if section:
            sections.append(SceneSection(section[1], section[2]))
        elif not sections:
            introduction.append(line)
        elif key:
            sections[-1].keys.append(Key(f"{sections[-1].name}.{key[1]}", key[2] or "", key[3], []))
        elif line.startswith("      accepted: "):
            facts = re.fullmatch(r"accepted: (.*); default: (.*); read by: (.*)", line.strip())
            if not facts:
                raise ValueError(f"a line of the scene reference of an unknown form: {line}")
            sections[-1].keys[-1].facts = list(zip(("Accepted", "Default", "Read by"), facts.groups()))
        elif line.startswith("  ") and line.strip():  # a remark on the section
            sections[-1].meaning += f" {line.strip()}"
        elif line.strip():
            raise ValueError(f"a line of the scene reference of an unknown form: {line}")
    return " ".join(introduction).strip(), sections


@cache
def command_line() -> dict:
    """Verbs and options, as `cophase manual --json` prints them."""
    return json.loads(run("manual", "--json"))
