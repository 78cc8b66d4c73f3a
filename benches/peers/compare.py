"""Everybody on the same images: an evaluation of objective and gradient, and a whole estimate, with its error.

`benches/peers/run` installs what this needs and starts it.
"""

import argparse
import json
import os
import platform
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

import cophase_model
import jax_model
import numpy as np
import numpy_model
import prysm_model
import solvephase_model
from images import PIXELS, Images, make, pooled
from telescope import Telescope

#: Grid of the model that everybody has.
SAMPLES = 120
#: Our own models, samples and pixels: small ones that err less than the grey pupil, and one at the bound.
OWN = [(72, 64), (80, 64), (108, 88)]
#: Errors this much larger still count as equal: what the draw of the noise alone does is larger.
EQUAL = 1.02
#: Largest deviation of a gradient, as a fraction of its largest element. An f32 sum over 57,600 pixels of both signs keeps
#: six digits; a convention that is not shared shows in the first.
AGREEMENT = {"f64": 1e-12, "f32": 1e-5}
#: A timed round lasts at least this long, s, so that the clock does not matter.
ROUND_S = 0.02


class Clock:
    """Times rounds of calls: wall-clock and CPU time of all threads, per image."""

    def __init__(self) -> None:
        self.wall_s: list[float] = []
        self.cpu_s: list[float] = []

    def round(self, call, images: int, least_s: float = 0.0):
        """Calls for `least_s` at least; returns what the last call did."""
        calls, wall, cpu = 0, time.perf_counter(), time.process_time()
        while calls == 0 or time.perf_counter() - wall < least_s:
            answer = call()
            calls += 1
        self.wall_s.append((time.perf_counter() - wall) / (calls * images))
        self.cpu_s.append((time.process_time() - cpu) / (calls * images))
        return answer

    def figures(self) -> dict:
        quartiles = 1e6 * np.quantile(self.wall_s, [0.25, 0.5, 0.75])
        names = ("quartile_1_us", "us", "quartile_3_us")
        return dict(zip(names, quartiles.tolist())) | {"cpu_us": 1e6 * float(np.median(self.cpu_s))}


class Contender:
    """A way to evaluate or to estimate, with one image or several at a time."""

    def __init__(self, who, precision, batch, model, telescope, route="") -> None:
        self.row = {"who": who, "route": route, "precision": precision, "batch": batch}
        self.model, self.telescope, self.batch = model, telescope, batch
        self.ours = who == cophase_model.NAME
        self.clock = Clock()

    def load(self, images: Images, first: int = 0) -> None:
        chosen = first if self.batch == 1 else slice(self.batch)
        self.model.load(images.electrons[chosen], images.weights[chosen])

    def says(self) -> str:
        return " ".join(str(word) for word in (self.row["who"], self.row["route"], self.row["precision"]) if word)


def contenders(telescope: Telescope, batch: int) -> list[Contender]:
    """Everybody, with the same model."""
    same = cophase_model.same_arrays(telescope)
    numpy = [("f64", numpy_model.Model(telescope, PIXELS, "f64")), ("f32", numpy_model.Model(telescope, PIXELS, "f32"))]
    solvephase = [(p, solvephase_model.Model(telescope, PIXELS, p)) for p in ("f64", "f32")]
    found = [Contender(numpy_model.NAME, p, 1, model, telescope) for p, model in numpy]
    found += [Contender(prysm_model.NAME, "f64", 1, prysm_model.Model(telescope, PIXELS), telescope)]
    found += [Contender(solvephase_model.NAME, p, 1, model, telescope) for p, model in solvephase]
    for route in ("fft", "matrix"):
        for size in (1, batch):
            model = jax_model.Model(telescope, PIXELS, route)
            found.append(Contender(jax_model.NAME, "f32", size, model, telescope, route))
    return found + ours(same, telescope, "same model", (1, batch))


def ours(model, telescope: Telescope, route: str, batches) -> list[Contender]:
    """Ours on every device, with some model."""
    found = []
    for name, (device, precision) in cophase_model.devices().items():
        for size in batches:
            session = cophase_model.Model(model, device, precision, size)
            words = f"{route}, {name.removesuffix(' ' + precision)}"
            found.append(Contender(cophase_model.NAME, precision, size, session, telescope, words))
    return found


def evaluations(entries: list[Contender], images: Images, rounds: int) -> list[dict]:
    """Times of one objective with its gradient. Everybody in turn, `rounds` times; coefficients differ from image to
    image and from call to call."""
    random = np.random.default_rng(1)
    modes = entries[0].telescope.modes
    points_nm = 40 * random.standard_normal((4, max(entry.batch for entry in entries), modes))
    reference = entries[0].model
    reference.load(images.electrons[0], images.weights[0])
    value, gradient = reference.evaluate(points_nm[0, 0])
    calls = {}
    for entry in entries:
        entry.load(images)
        at = [points[0] if entry.batch == 1 else points[: entry.batch] for points in points_nm]
        # The flux is a parameter of this one, which the others fit on the way.
        more = (reference.flux_e,) if isinstance(entry.model, solvephase_model.Model) else ()
        agree(entry, value, gradient, entry.model.evaluate(at[0], *more))
        turns = iter(range(1 << 62))
        calls[entry] = lambda entry=entry, at=at, turns=turns: entry.model.evaluate(at[next(turns) % len(at)])
    for _ in range(rounds):
        for entry, call in calls.items():
            entry.clock.round(call, entry.batch, ROUND_S)
    return [entry.row | entry.clock.figures() for entry in entries]


def agree(entry: Contender, value: float, gradient: np.ndarray, answer) -> None:
    """Everybody evaluates the same function, or the times mean nothing."""
    theirs, slope = (np.asarray(part) for part in answer)
    theirs, slope = (theirs.ravel()[0], slope.reshape(-1, gradient.size)[0])
    off = max(abs(theirs / value - 1), np.abs(slope - gradient).max() / np.abs(gradient).max())
    limit = AGREEMENT[entry.row["precision"]]
    if not off <= limit:
        raise SystemExit(f"{entry.says()} evaluates another function: off by {off:.1e}, where {limit:.0e} is rounding")


def estimates(entries: list[Contender], images: Images, few: int, rounds: int) -> list[dict]:
    """Times and errors of whole estimates: the first `few` images, one after the other, or batches `rounds` times."""
    rows = []
    for entry in entries:
        found = []
        if entry.batch == 1:
            # What is compiled or allocated at a first call is none of an estimate's time.
            entry.load(images)
            entry.model.evaluate(np.zeros(entry.telescope.modes))
            for image in range(few):
                entry.load(images, image)
                found.append(entry.clock.round(entry.model.estimate, 1))
            found_nm = np.stack(found)
        else:
            entry.load(images)
            found_nm = entry.model.estimate()
            for _ in range(rounds):
                entry.clock.round(entry.model.estimate, entry.batch)
        errors_nm = images.errors_nm(entry.telescope, found_nm)
        phasing_nm, ncpa_nm = pooled(errors_nm[:few])
        whole = dict(zip(("phasing_all_nm", "ncpa_all_nm"), pooled(errors_nm)))
        rows.append(entry.row | entry.clock.figures() | {"phasing_nm": phasing_nm, "ncpa_nm": ncpa_nm} | whole)
        print(f"  {entry.says()}, batch {entry.batch}: {rows[-1]['us'] / 1e3:.2f} ms an image", flush=True)
    return rows


def compare(rows: list[dict], errors: bool) -> None:
    """Adds to every row of the others how many times faster we are: one image against one, and in a batch; at the same
    error or a smaller one where there are errors."""
    for row in rows:
        for name, batched in (("ratio_one", False), ("ratio_batch", True)):
            rivals = [r for r in rows if r["who"] == cophase_model.NAME and (r["batch"] > 1) == batched]
            if errors:
                rivals = [r for r in rivals if all(r[key] <= EQUAL * row[key] for key in ("phasing_nm", "ncpa_nm"))]
            best = min(rivals, key=lambda r: r["us"], default=None)
            if row["who"] != cophase_model.NAME and best and (batched or row["batch"] == 1):
                row[name] = row["us"] / best["us"]
                row[name + "_cpu"] = row["cpu_us"] / best["cpu_us"]


def table(rows: list[dict], errors: bool) -> str:
    """Aligned text."""
    heads = ["who", "route", "type", "batch", "us/image", "quartiles", "CPU us"]
    heads += ["phasing nm", "NCPA nm"] * errors + ["we, one: x", "we, batch: x"]
    lines = [heads]
    for row in rows:
        spread = f"{row['quartile_1_us']:.0f} .. {row['quartile_3_us']:.0f}"
        line = [row["who"], row["route"], row["precision"], str(row["batch"]), f"{row['us']:.0f}", spread]
        line += [f"{row['cpu_us']:.0f}"] + [f"{row[key]:.3f}" for key in ("phasing_nm", "ncpa_nm") if errors]
        lines.append(line + [f"{row[key]:.1f}" if key in row else "" for key in ("ratio_one", "ratio_batch")])
    widths = [max(len(line[column]) for line in lines) for column in range(len(heads))]

    def aligned(line):
        words, numbers = zip(line[:3], widths[:3]), zip(line[3:], widths[3:])
        cells = [word.ljust(width) for word, width in words] + [number.rjust(width) for number, width in numbers]
        return "  ".join(cells).rstrip() + "\n"

    return "".join(map(aligned, lines))


def machine() -> dict:
    """What this was measured on, and with what."""
    packages = ("numpy", "scipy", "jax", "jaxlib", "prysm", "solvephase")
    info = Path("/proc/cpuinfo")
    named = [line for line in info.read_text().splitlines() if "model name" in line] if info.exists() else []
    processor = named[0].partition(":")[2].strip() if named else platform.processor()
    load = os.getloadavg()[0]
    versions = {name: version(name) for name in packages}
    return {"processor": processor, "threads": os.cpu_count(), "load_before": load, "versions": versions}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="benches/peers/run", description=__doc__)
    parser.add_argument("--batch", type=int, default=200, help="images of a batch (200)")
    parser.add_argument("--seeds", type=int, default=8, help="different truths among them (8)")
    parser.add_argument("--few", type=int, default=4, help="images that are estimated one at a time (4)")
    parser.add_argument("--rounds", type=int, default=7, help="times that each evaluation and each batch is timed (7)")
    parser.add_argument(
        "--jax-batch", type=int, default=16, help="images of JAX's batched estimate, which is slow (16)"
    )
    parser.add_argument("--program", type=Path, default=Path("cophase"), help="the program that makes the images")
    parser.add_argument("--json", type=Path, help="file for all figures")
    return parser.parse_args()


def main() -> None:
    given = arguments()
    result = {"machine": machine()}
    print(f"{result['machine']['processor']}, {result['machine']['threads']} threads", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        each = -(-given.batch // given.seeds)
        images = Images.read(make(given.program, Path(folder), given.seeds, each))
    telescope = Telescope.of(SAMPLES)
    entries = contenders(telescope, given.batch)
    result["evaluation"] = evaluations(entries, images, given.rounds)
    compare(result["evaluation"], errors=False)
    print("\nObjective and gradient\n" + table(result["evaluation"], errors=False), flush=True)

    print("Whole estimates")
    everybody = contenders(telescope, given.batch)
    # Estimates take JAX's faster transform.
    entries = [entry for entry in everybody if not entry.ours and entry.batch == 1 and entry.row["route"] != "matrix"]
    batched = jax_model.Model(telescope, PIXELS, "fft")
    entries.append(Contender(jax_model.NAME, "f32", given.jax_batch, batched, telescope, "fft, our metric"))
    entries += [entry for entry in everybody if entry.ours]
    for samples, crop in OWN:
        entries += ours(*cophase_model.own(samples, crop), f"{samples} samples, {crop} pixels", (1, given.batch))
    result["estimate"] = estimates(entries, images, given.few, given.rounds)
    compare(result["estimate"], errors=True)
    print("\nWhole estimates; errors over the same images\n" + table(result["estimate"], errors=True))
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
