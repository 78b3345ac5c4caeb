"""Yield against speed: ``python -m tools.yield_against_speed winder`` or ``stitcher``.

Prints a table and draws it into ``docs/pictures``. Machines are drawn within the tolerances of the
library's file, seed 1, and all get the commands planned for the machine as typed. The winder's are
2000 at each feed, by the specification of the library; the stitcher's are 100 at each needle speed
of the thesis's test path, with feed-forward, by place and length alone.
``--cluster ADDRESS`` judges the machines on a cluster, as the commands do. ``--part 3/16 -o FILE``
writes the rows of some of the speeds, and ``--merge FILE...`` prints and draws the whole.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from threadline.base.cluster import on_cluster
from threadline.base.cluster_worker import versions
from threadline.base.writing import staged_file
from threadline.commands.plan import Plan
from threadline.errors import OptionError, ThreadlineError
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, prove_plan
from threadline.report.style import figure_style
from threadline.search.machine_yield import MachineYield
from threadline.search.yield_parts import Part, parse_part
from threadline.verdict import Spec, load_spec

ROOT = Path(__file__).resolve().parent.parent
SEAM = ROOT / "examples" / "stitcher-test-path.seam.toml"
PLACE = ROOT / "examples" / "stitcher-place.spec.toml"
FEEDS_MM_S = (5, 10, 15, 20, 25, 30, 32, 34, 36, 38, 40, 45, 50)
NEEDLES_HZ = (30, 34, 38, 42, 46, 50, 54, 58, 62, 66, 70, 73)
Row = tuple[float, bool, int, int, float, float, str]
"""Speed, whether one run is in spec, machines in spec of how many, the interval, what fails most.
"""
FEWER_MM_S = (20, 25, 30, 36, 40, 45, 50)  # a long job, and its plans take seconds
METHODS: dict[str, dict[str, Sequence[int]]] = {
    "x-180": {"linear": FEEDS_MM_S, "optimal": FEEDS_MM_S},
    "cone-dome-cylinder": {"linear": FEEDS_MM_S, "optimal": FEWER_MM_S},
}


FORMAT = "threadline yield against speed 1"
Rows = Mapping[tuple[str, int], Row]  # by the title of a table and the number of a speed in it


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m tools.yield_against_speed")
    parser.add_argument("which", choices=["winder", "stitcher"])
    parser.add_argument("--cluster")
    parser.add_argument("--part", type=parse_part)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--merge", nargs="+", type=Path)
    given = parser.parse_args(words)
    if (given.part is None) != (given.output is None) or (given.part and given.merge):
        parser.error("give --part K/N with -o FILE, or --merge FILE..., or none of them")
    try:
        known = {} if given.merge is None else merged(given.which, given.merge)
        with on_cluster(given.cluster, print):
            tables = Tables(known, given.part)
            with figure_style():
                draw_all(given.which, tables)
        if given.part is not None:
            write(given.output, given.which, given.part, tables.made)
    except ThreadlineError as error:
        parser.error(str(error))


def draw_all(which: str, tables: Tables) -> None:
    if which == "stitcher":
        stitcher(tables)
    else:
        for name in METHODS:
            winder(name, tables)


def identity(which: str) -> dict[str, str]:
    """Return what the rows of a part depend on."""
    return {"which": which, **versions()}


def write(path: Path, which: str, part: Part, made: Rows) -> None:
    """Write the rows of a part; the file appears whole, or not at all."""
    content = {
        "format": FORMAT,
        "identity": identity(which),
        "part": [part.number, part.count],
        "rows": [[title, number, *row] for (title, number), row in made.items()],
    }
    with staged_file(path) as file:
        file.write(json.dumps(content).encode())
    print(f"part {part}: {path}, {len(made)} speeds")


def merged(which: str, paths: Sequence[Path]) -> Rows:
    """Return the rows of all parts.

    Raises
    ------
    OptionError
        If a part is missing, is there twice, or was made by something else.
    """
    rows: dict[tuple[str, int], Row] = {}
    known: dict[int, Path] = {}
    counts: set[int] = set()
    for path in paths:
        content = _content(path)
        identity_there = content["identity"]
        other = [
            name for name, value in identity(which).items() if identity_there.get(name) != value
        ]
        if other:
            raise OptionError(f"{str(path)!r} was made with another {', '.join(other)}")
        number, count = content["part"]
        if number in known:
            raise OptionError(f"part {number} is there twice: {known[number]} and {path}")
        known[number] = path
        counts.add(count)
        rows |= {(title, at): tuple(row) for title, at, *row in content["rows"]}
    missing = sorted(set(range(1, max(counts) + 1)) - set(known))
    if missing or len(counts) > 1:
        raise OptionError(f"parts are missing of {max(counts)}: {missing}")
    return rows


def _content(path: Path) -> Any:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["format"] == FORMAT and {"identity", "part", "rows"} <= set(content):
            return content
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OptionError(f"{str(path)!r} is no part of such a table: {error}") from error
    raise OptionError(f"{str(path)!r} is no part of such a table")


def winder(name: str, tables: Tables) -> None:
    machine = load_machine("lathe-winder")
    job = read_job(ROOT / "examples" / f"{name}.prg", machine)

    def planned(method: str) -> Callable[[float], Plan]:
        def at(feed: float) -> Plan:
            options = Options(interpolation=method, feed=parse_feed(f"{feed} mm/s"))
            return plan_job(job, machine, options)

        return at

    spec = load_spec(None, machine)
    curves = {
        method: tables.rows(f"{name}, {method}", "mm/s", feeds, planned(method), spec, 2000)
        for method, feeds in METHODS[name].items()
    }
    tables.draw(name, "feed [mm/s]", curves)


def stitcher(tables: Tables) -> None:
    machine = load_machine("stitcher")

    def sewn(needle_hz: float) -> Plan:
        job = read_job(SEAM, machine, needle_speed=f"{needle_hz!r} stitch/s")
        return plan_job(job, machine, Options(feed_forward_s=0.04))

    spec = load_spec(PLACE, machine)
    rows = tables.rows("stitcher, feed-forward", "stitch/s", NEEDLES_HZ, sewn, spec, 100)
    tables.draw("stitcher", "needle speed [stitch/s]", {"feed-forward, place and length": rows})


class Tables:
    """Tables of yield against speed: judged here, or read from parts.

    Parameters
    ----------
    known
        Rows that were read from all parts; none to judge them here.
    part
        The part of the speeds that is judged; None for all.
    """

    def __init__(self, known: Rows, part: Part | None) -> None:
        self._known, self._part = known, part
        self.made: dict[tuple[str, int], Row] = {}

    def rows(
        self,
        title: str,
        unit: str,
        speeds: Sequence[int],
        planned: Callable[[float], Plan],
        spec: Spec,
        machines: int,
    ) -> list[Row]:
        """Print and return the yield at each speed."""
        print(f"\n### {title}\n\n| {unit} | one run | in spec of {machines} | yield | most fail |")
        print("|---|---|---|---|---|", flush=True)
        rows: list[Row] = []
        for number in self._own(len(speeds)):
            at = title, number
            row = self._known.get(at)
            if row is None:
                row = judged(float(speeds[number]), planned, spec, machines)
                self.made[at] = row
            speed, one, passed, _, low, high, name = row
            rows.append(row)
            print(
                f"| {speed:g} | {'in' if one else 'out'} | {passed} | {100 * low:.1f} to "
                f"{100 * high:.1f} % | {name} |",
                flush=True,
            )
        return rows

    def _own(self, count: int) -> Iterator[int]:
        """Yield the numbers of the speeds of the part."""
        if self._part is None:
            yield from range(count)
        else:
            yield from self._part.share(count, "speeds of a table", "run it whole")

    def draw(self, name: str, label: str, curves: dict[str, list[Row]]) -> None:
        """Draw the whole; a part has no picture."""
        if self._part is None:
            draw(name, label, curves)


def judged(speed: float, planned: Callable[[float], Plan], spec: Spec, machines: int) -> Row:
    plan = planned(speed)
    one = prove_plan(plan, spec).verdict.passed
    found = MachineYield(plan, spec).drawn(machines, 1)
    low, high = found.interval
    failed = max(found.found.rows, key=lambda row: row.failed.sum())
    name = failed.text if failed.failed.any() else "none"
    return speed, one, found.passed, machines, low, high, name


def draw(name: str, label: str, curves: dict[str, list[Row]]) -> None:
    figure = Figure(figsize=(6.4, 3.6))
    panel = figure.subplots()
    for (method, rows), look in zip(curves.items(), ("o-", "s--"), strict=False):
        speed, _, passed, machines, low, high = np.array([row[:6] for row in rows], dtype=float).T
        share = passed / machines
        # Not the middle of the interval: that is below 100 % where every machine is in spec.
        bars = 100 * np.array([share - low, high - share])
        panel.errorbar(speed, 100 * share, bars, fmt=look, capsize=2, label=method)
    panel.set_xlabel(label)
    panel.set_ylabel("yield, 95 % interval [%]")
    panel.set_ylim(-3, 103)
    panel.set_title(f"{name}: machines within the tolerances that are in spec")
    panel.legend(fontsize=7)
    file = ROOT / "docs" / "pictures" / f"yield-{name}.png"
    figure.savefig(file, dpi=130, metadata={"Software": None})
    print(file.relative_to(ROOT))


if __name__ == "__main__":
    main()
