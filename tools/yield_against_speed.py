"""Yield against speed: ``python -m tools.yield_against_speed winder`` or ``stitcher``.

Prints a table and draws it into ``docs/pictures``. Machines are drawn within the tolerances of the
library's file, seed 1, and all get the commands planned for the machine as typed. The winder's are
2000 at each feed, by the specification of the library; the stitcher's are 100 at each needle speed
of the thesis's test path, with feed-forward, by place and length alone.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from threadline.commands.plan import Plan
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, prove_plan
from threadline.report.style import figure_style
from threadline.search.machine_yield import MachineYield
from threadline.verdict import Spec, load_spec

ROOT = Path(__file__).resolve().parent.parent
SEAM = ROOT / "examples" / "stitcher-test-path.seam.toml"
PLACE = ROOT / "examples" / "stitcher-place.spec.toml"
FEEDS_MM_S = (5, 10, 15, 20, 25, 30, 32, 34, 36, 38, 40, 45, 50)
NEEDLES_HZ = (30, 34, 38, 42, 46, 50, 54, 58, 62, 66, 70, 73)
Row = tuple[float, float, float, float]  # speed, share in spec, its interval
FEWER_MM_S = (20, 25, 30, 36, 40, 45, 50)  # a long job, and its plans take seconds
METHODS: dict[str, dict[str, Sequence[int]]] = {
    "x-180": {"linear": FEEDS_MM_S, "optimal": FEEDS_MM_S},
    "cone-dome-cylinder": {"linear": FEEDS_MM_S, "optimal": FEWER_MM_S},
}


def main(which: str) -> None:
    with figure_style():
        if which == "stitcher":
            stitcher()
        else:
            for name in METHODS:
                winder(name)


def winder(name: str) -> None:
    machine = load_machine("lathe-winder")
    job = read_job(ROOT / "examples" / f"{name}.prg", machine)

    def planned(method: str) -> Callable[[float], Plan]:
        def at(feed: float) -> Plan:
            options = Options(interpolation=method, feed=parse_feed(f"{feed} mm/s"))
            return plan_job(job, machine, options)

        return at

    spec = load_spec(None, machine)
    curves = {
        method: table(f"{name}, {method}", "mm/s", feeds, planned(method), spec, 2000)
        for method, feeds in METHODS[name].items()
    }
    draw(name, "feed [mm/s]", curves)


def stitcher() -> None:
    machine = load_machine("stitcher")

    def sewn(needle_hz: float) -> Plan:
        job = read_job(SEAM, machine, needle_speed=f"{needle_hz!r} stitch/s")
        return plan_job(job, machine, Options(feed_forward_s=0.04))

    spec = load_spec(PLACE, machine)
    rows = table("stitcher, feed-forward", "stitch/s", NEEDLES_HZ, sewn, spec, 100)
    draw("stitcher", "needle speed [stitch/s]", {"feed-forward, place and length": rows})


def table(
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
    for speed in speeds:
        plan = planned(float(speed))
        one = prove_plan(plan, spec).verdict.passed
        found = MachineYield(plan, spec).drawn(machines, 1)
        low, high = found.interval
        failed = max(found.found.rows, key=lambda row: row.failed.sum())
        name = failed.text if failed.failed.any() else "none"
        rows.append((speed, found.share, low, high))
        print(
            f"| {speed} | {'in' if one else 'out'} | {found.passed} | {100 * low:.1f} to "
            f"{100 * high:.1f} % | {name} |",
            flush=True,
        )
    return rows


def draw(name: str, label: str, curves: dict[str, list[Row]]) -> None:
    figure = Figure(figsize=(6.4, 3.6))
    panel = figure.subplots()
    for (method, rows), look in zip(curves.items(), ("o-", "s--"), strict=False):
        speed, share, low, high = np.array(rows).T
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
    main(sys.argv[1])
