"""The program of ours, as the scripts that make images run it."""

import json
import subprocess


def report(command):
    """What the program prints as JSON."""
    done = subprocess.run(command + ["--json"], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout)
