"""Hostile command lines: extreme numbers, odd names, pairs of options, outputs that are inputs.

    python -m tools.fuzz_commands --minutes 10 --seed 1

Every case runs the whole program in this process. It may end with 0, 1 or 2 and, from 2 on, with
one line on standard error and nothing on standard output. Everything else is a failure: a
traceback (status 70), a warning of a library, a second line, a number that JSON lacks, an input
that changed, an output left alone or half-written, or a minute without a word; what is still at
work by then and says so is stopped, and counted as status 124. Cases depend on seed, class and
number only, so that ``--kind machine-number --first 4711 --cases 1`` runs one again.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import sys
import tempfile
import time
import tomllib
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tools import short_jobs
from tools.fuzz_cases import (
    JOBS,
    LIBRARY,
    PLAIN,
    Case,
    answer_alarms,
    run_case,
)
from tools.fuzz_live import options, store
from tools.fuzz_odd import odd_file, study

from threadline.machine import overlay_names

_SHOWN = 40

EXTREMES = """
0 -0 1 -1 2 1e-3 1e3 1e-6 1e6 1e-12 1e12 1e-30 1e30 1e-300 1e300 5e-324 1.7e308 1e-9 1e9
0.1234567 3.3333333333333333333333333333333333333333 -1e30 1e15 1e-15 nan inf
""".split()  # noqa: SIM905 - a table of words
NAMES = [
    "$x^$", "[/b]", "a *) b := TRUE; (*", "a\nb", "\x1b[2J", "'\"`", "<script>", "{{ 7 }}", "; M3",
    "$", "%", "../..", "K\u00e4fig \u7e54", "\u202egrp", "a" * 300, "[red]", ":x:", "-m",
]  # fmt: skip
# --- numbers of machine files, one by one ---


@dataclass(frozen=True)
class Number:
    """A number of a machine file of the library.

    Attributes
    ----------
    machine, keys
        The file, and where the number stands in it: keys of tables, and places in a list.
    value
        As it stands there: text with a unit, or a bare number.
    whole
        The list that it is in, or itself.
    """

    machine: str
    keys: tuple[str, ...]
    place: int | None
    value: Any
    whole: Any


def _numbers(table: Any, at: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _numbers(value, (*at, key))
        else:
            yield (*at, key), value


def _is_number(value: Any) -> bool:
    if isinstance(value, str):
        return re.match(r"-?[\d.]+(e-?\d+)?( |$)", value) is not None
    return isinstance(value, int | float) and not isinstance(value, bool)


def _all_numbers() -> Iterator[Number]:
    for path in sorted(LIBRARY.glob("*.toml")):
        if ".spec." in path.name:
            continue
        for keys, value in _numbers(tomllib.loads(path.read_text(encoding="utf-8"))):
            if isinstance(value, list):
                for place, one in enumerate(value):
                    if _is_number(one):
                        yield Number(path.stem, keys, place, one, value)
            elif _is_number(value):
                yield Number(path.stem, keys, None, value, value)


NUMBERS = list(_all_numbers())
_TIMES = {"times 1000": 1e3, "times 1/1000": 1e-3, "times 10": 10.0, "negative": -1.0}
CHANGES = (*EXTREMES, *_TIMES, "another unit")


def _changed_text(value: Any, change: str) -> str:
    """Return the TOML of a number that was changed."""
    if not isinstance(value, str):
        number = str(_TIMES[change] * value) if change in _TIMES else change
        return '"1 kg"' if change == "another unit" else number
    number, _, rest = value.partition(" ")
    unit = re.split(r" exact| \+-|, |: ", rest)[0].strip()
    unit = "" if re.match(r"(exact|\+-)", rest) else unit
    if change == "another unit":
        unit = "s" if unit == "kg" else "kg"
    elif change in _TIMES:
        number = f"{_TIMES[change] * float(number):.17g}"
    else:
        number = change
    return json.dumps(f"{number} {unit} exact, assumed")


def _overlaid(number: Number, change: str) -> tuple[str, str]:
    """Return a machine file with one number changed, and how it is called."""
    keys, overlay = number.keys, ""
    text = _changed_text(number.value, change)
    if number.place is not None:
        rows = [json.dumps(one) for one in number.whole]
        rows[number.place] = text
        text = f"[{', '.join(rows)}]"
    if keys[0] == "overlays":
        overlay = f"+{keys[1]}"
    name = ".".join(json.dumps(key) for key in keys)
    return f'base = "{number.machine}"\n{name} = {text}\n', f"m.toml{overlay}"


def machine_number(rng: random.Random, index: int) -> Case:
    """Go through every number and every change in turn, so that none is left out.

    Neighbouring cases are of numbers far apart: a few are a fair share of all.
    """
    at = 7919 * index % (len(NUMBERS) * len(CHANGES))  # a prime, and no divisor of that
    number, change = NUMBERS[at % len(NUMBERS)], CHANGES[at // len(NUMBERS)]
    text, reference = _overlaid(number, change)
    kind = "stitcher" if number.machine.startswith("stitcher") else number.machine
    verb = rng.choices(("prove", "compile", "analyse"), weights=(7, 2, 1))[0]
    words = _command(rng, verb, JOBS[kind], kind, reference)
    if verb == "prove":  # one run asks all that twenty ask, but for what varies from run to run
        words += rng.choice((["--nominal"], ["--nominal"], ["--nominal"], []))
    return Case(words, {"m.toml": text})


def _command(rng: random.Random, verb: str, job: str, machine: str, reference: str) -> list[str]:
    switched = machine == "letter-placer"
    stitched = JOBS[machine] == "short.dst"
    if verb == "analyse" and not switched:
        return ["analyse", reference, *rng.choice(([], ["--json"]))]
    if verb == "compile":
        tables = ("csv", "npz", "nc", "ticks")
        target = rng.choice(("st", "plcopen") if switched else ("steps",) if stitched else tables)
        return ["compile", job, "-m", reference, "--target", target, "-o", "out.x"]
    words = ["prove", job, "-m", reference, *rng.choice(([], ["--json"]))]
    if switched:
        return [*words, *rng.choice(([], ["--shaper", "um-zv"], ["--shaper", "zv"]))]
    if stitched:
        return words
    names = ("linear", "auto", "auto", "cubic", "quintic", "b-spline", "parabolic")
    return [*words, "--interpolation", rng.choice(names)]


# --- numbers and pairs of options ---

UNITS = ("mm", "m", "mm/s", "m/s^2", "Hz", "s", "ms", "%", "count/tick", "stitch/s", "")
KINDS = (
    "zv", "mzv", "zvd", "zvdd", "ei", "2hump-ei", "3hump-ei", "um-zv", "um-zvd", "um-ei", "um-2ei",
    "negative-zv", "negative-2ei", "si", "direct", "um-direct",
)  # fmt: skip


def number(rng: random.Random, unit: str, usual: str) -> str:
    """Return a usual number, a wild or an extreme one, with its unit or now and then another."""
    if rng.random() < 0.05:
        unit = rng.choice(UNITS)
    kind = rng.random()
    if kind < 0.4:
        text = usual
    elif kind < 0.8:
        text = f"{10.0 ** rng.uniform(-5, 5):.4g}"
    else:
        text = rng.choice(EXTREMES)
    return f"{text} {unit}".strip()


def shaper_numbers(rng: random.Random, _index: int) -> Case:
    """Design shapers of every kind, for one to three modes, with any pair of options."""
    words = ["shaper", "--kind", rng.choice(KINDS)]
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        words += ["--mode", number(rng, "Hz", rng.choice(("3.04", "0.1", "25", "645")))]
    options: dict[str, Callable[[], str]] = {
        "--damping": lambda: number(rng, "", "0.17"),
        "--tolerance": lambda: number(rng, "", "0.05"),
        "--band": lambda: number(rng, "", "0.2"),
        "--tick": lambda: number(rng, "s", "0.01"),
        "--dwell": lambda: number(rng, "ms", "20"),
        "--max-impulses": lambda: rng.choice(("0", "1", "3", "-1", "99999")),
        "--still": lambda: number(rng, "", "0.01"),
    }
    for name in rng.sample(sorted(options), rng.choice((0, 1, 2))):
        words += [name, options[name]()]
    if rng.random() < 0.25:
        words += ["--move", number(rng, "mm", "100")]
        words += ["--acceleration", number(rng, "m/s^2", "1")]
    if rng.random() < 0.3:
        words.append(rng.choice(("--free", "--klipper", "--json")))
    return Case(words, {})


def option_pairs(rng: random.Random, _index: int) -> Case:
    """Take two or three options of a command at random, right and wrong ones."""
    machine = rng.choice(sorted(JOBS))
    overlays = overlay_names(machine)
    reference = machine + (f"+{rng.choice(overlays)}" if overlays and rng.random() < 0.3 else "")
    verb = rng.choice(("prove", "prove", "compile", "fastest", "compare", "size", "law"))
    if verb == "law":
        return Case(["law", rng.choice(("cubic", "trapezoid", "modified-sine", "", "[/b]"))], {})
    words = [verb] if verb == "size" else [verb, JOBS[machine], "-m", reference]
    if verb == "compile":
        words += ["--target", rng.choice(("csv", "nc", "st", "plcopen", "npz", "ticks", "hal"))]
        words += ["-o", "out.x"]
    if verb == "fastest":
        low = 10.0 ** rng.uniform(-4, 1)
        words += ["--low", f"{low} m/s", "--high", f"{low * rng.choice((0.5, 1.0, 1.001))} m/s"]
    options: dict[str, Callable[[], str | None]] = {
        "--feed": lambda: number(rng, rng.choice(("mm/s", "count/tick")), "10"),
        "--tolerance": lambda: number(rng, "mm", "0.1"),
        "--limits": lambda: number(rng, "%", "50"),
        "--interpolation": lambda: rng.choice(
            ("auto", "linear", "cubic", "quintic", "parabolic", "b-spline", "b-spline-pulled", "x")
        ),
        "--shaper": lambda: rng.choice(
            ("zv", f"zv:{number(rng, 'Hz', '12')}", f"X=ei:{number(rng, 'Hz', '12')}:0.02", "*")
        ),
        "--smoothing": lambda: number(rng, "ms", "40"),
        "--feed-mode": lambda: rng.choice(("path", "base-axes:A", "base-axes:Q", "x")),
        "--repeats": lambda: rng.choice(("1", "2", "0", "-3", "1e3")),
        "--margin": lambda: number(rng, "%", "20"),
        "--feed-forward": lambda: None,
        "--json": lambda: None,
        "--recording": lambda: rng.choice(("r.npz", "r.csv", "r.plt", "r.x", "no/such/r.csv")),
        "--actual": lambda: rng.choice((*JOBS, "nothing", reference)),
    }
    for name in rng.sample(sorted(options), rng.choice((1, 2, 3))):
        value = options[name]()
        words += [name] if value is None else [name, value]
    return Case(words, {})


# --- names, and outputs that are inputs ---


def names(rng: random.Random, _index: int) -> Case:
    """Call jobs, machines and files by names that are markup, formulas or program."""
    name, other = rng.choice(NAMES), rng.choice(NAMES)
    machine = rng.choice(sorted(JOBS))
    quoted, title = json.dumps(name), json.dumps(other)
    files: dict[str, str | bytes] = {
        "m.toml": f'base = "{machine}"\nname = {quoted}\ntitle = {title}\n'
    }
    job = JOBS[machine]
    if machine == "letter-placer":
        files["moves.toml"] = short_jobs.MOVES.replace('"short"', json.dumps(name))
        job = "moves.toml"
    elif rng.random() < 0.5 and len(name) < 200 and "/" not in name:
        ending = JOBS[machine].removeprefix("short")
        job = f"./{name}{ending}"
        texts: dict[str, str | bytes] = {".prg": short_jobs.PROGRAM, ".dst": short_jobs.DESIGN}
        files[job] = texts.get(ending, short_jobs.DRAWN_SEAM)
    verb = rng.choice(("prove", "compile", "compile", "report"))
    if verb == "report":
        fast = [] if machine in PLAIN else ["--interpolation", "linear"]
        return Case(["prove", job, "-m", "m.toml", "--report", "rep", *fast], files)
    return Case(_command(rng, verb, job, machine, "m.toml"), files)


def outputs(rng: random.Random, _index: int) -> Case:
    """Write to a file that is read, reached by any way, or to what cannot be written."""
    machine = rng.choice(sorted(JOBS))
    base = f"{machine}-base.toml"
    files = {"m.toml": f'base = "{base}"\n'}
    out = rng.choice(
        (JOBS[machine], base, "m.toml", f"{machine}-base.spec.toml", "line.csv", "soft.csv",
         "hard.csv", "loop.csv", "folder.csv", "kept.csv", "fifo.csv", "dangling.csv", "new.csv",
         "no/new.csv", "short.prg/x.csv", "/dev/full", "/dev/null", "/proc/x.csv")
    )  # fmt: skip
    fast = [] if machine in PLAIN else ["--interpolation", "linear"]
    reads = frozenset({JOBS[machine], base, "m.toml", f"{machine}-base.spec.toml", "kept.csv"})
    reads |= {"line.csv"} if machine == "stitcher" else set()
    reads |= {"soft.csv", "hard.csv"} if machine == "lathe-winder" else set()
    if rng.random() < 0.5:
        target = rng.choice(
            ("st", "plcopen") if machine == "letter-placer"
            else ("steps",) if machine in PLAIN else ("csv", "npz")
        )  # fmt: skip
        return Case(
            ["compile", JOBS[machine], "-m", "m.toml", "--target", target, "-o", out, *fast],
            files,
            reads,
        )
    report = rng.choice(([], ["--report", rng.choice(("rep", "m.toml", "folder.csv", "taken"))]))
    into = rng.choice(("--recording", "--recording", "--proof"))
    return Case(["prove", JOBS[machine], "-m", "m.toml", into, out, *report, *fast], files, reads)


def odd_files(rng: random.Random, _index: int) -> Case:
    """Put a file that is none, or of another kind, where one is read."""
    return Case(*odd_file(rng))


def studies(rng: random.Random, _index: int) -> Case:
    """Ask the commands that study something with numbers of all sizes."""
    return Case(*study(rng, number))


def stores(rng: random.Random, _index: int) -> Case:
    """List and judge the runs of stores whose index holds something else."""
    return Case(*store(rng))


def live(rng: random.Random, _index: int) -> Case:
    """Run with faults and speeds of all sizes, and prove by laws of any numbers."""
    return Case(*options(rng, number))


KINDS_OF_CASES: dict[str, Callable[[random.Random, int], Case]] = {
    "machine-number": machine_number,
    "shaper": shaper_numbers,
    "options": option_pairs,
    "names": names,
    "outputs": outputs,
    "odd-files": odd_files,
    "stores": stores,
    "live": live,
    "studies": studies,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="stop after so long")
    parser.add_argument("--cases", type=int, default=10**9, help="or after so many, of each class")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=sorted(KINDS_OF_CASES), help="only this class")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    given = parser.parse_args()
    answer_alarms()
    warnings.simplefilter("error")
    end = time.monotonic() + 60.0 * given.minutes
    tally: Counter[tuple[str, int]] = Counter()
    failures, slowest = 0, (0.0, "")
    index = given.first
    while time.monotonic() < end and index < given.first + given.cases:
        for kind in [given.kind] if given.kind else KINDS_OF_CASES:
            case = KINDS_OF_CASES[kind](random.Random(f"{given.seed}/{kind}/{index}"), index)
            with tempfile.TemporaryDirectory() as folder:
                found = run_case(case, Path(folder))
            tally[kind, found.status] += 1
            again = f"--seed {given.seed} --kind {kind} --first {index} --cases 1"
            slowest = max(slowest, (found.took_s, again))
            if found.problem:
                failures += 1
                if failures <= _SHOWN:
                    print(f"{again}\n{case.words}\n{found.problem}\n", file=sys.stderr, flush=True)
        index += 1
    for kind in KINDS_OF_CASES:
        counts = {status: n for (which, status), n in sorted(tally.items()) if which == kind}
        counted = ", ".join(f"{n} with status {status}" for status, n in counts.items())
        if counts:
            print(f"{kind}: {sum(counts.values())} cases, {counted}")
    print(f"slowest: {slowest[0]:.1f} s, {slowest[1]}")
    print(f"{tally.total()} cases, {failures} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
