"""Print every figure of the shapers beside what the sources print, for docs/results-shaping.md.

Run as ``python -m tools.shaper_results [section ...]``; without a name all sections are printed.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from threadline.machine import load_machine
from threadline.motion.shaping import (
    ControllerLimits,
    FlexibleMode,
    Requirement,
    Shaper,
    check_higher_modes,
    convolve,
    design,
    direct_shaper,
    direct_unit_magnitude,
    insensitivity,
    klipper_export,
    realise,
    specified_insensitivity,
    vibration_of,
)
from threadline.motion.shaping.onoff.body_and_modes import RestToRest
from threadline.motion.shaping.onoff.optimal import time_optimal
from threadline.motion.shaping.onoff.robust import compare_shapers, robust_optimum
from threadline.motion.shaping.onoff.switched import residual_front
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import prove
from threadline.verdict import Criterion, Spec

PAPER = FlexibleMode(3.04, 0.17)
TRUE = FlexibleMode(3.04, 0.0089)
MODEL = FlexibleMode(3.029, 0.0090)
MOVE = RestToRest(0.2, 1.0, (FlexibleMode(3.04),))
KINDS = (
    "zv", "mzv", "zvd", "zvdd", "ei", "2hump-ei", "3hump-ei",
    "um-zv", "um-zvd", "um-ei", "um-2ei", "negative-zv",
)  # fmt: skip


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table that Markdown understands."""
    print(f"\n### {title}\n")
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(row) + " |")


def numbers(values: Sequence[float] | np.ndarray, digits: int) -> str:
    return " ".join(f"{v:.{digits}f}" for v in values)


def facts() -> None:
    """Equations 12, 14, 15, Figure 6 and the misread damping ratio."""
    zv, um = design("zv", PAPER), design("um-2ei", PAPER)
    both = convolve(zv, um)
    rows = [
        ["eq 12, ZV amplitudes", ".6323 .3677", numbers(zv.amplitudes, 5)],
        ["eq 12, ZV times s", "0 .167", numbers(zv.times_s, 5)],
        ["eq 14, times s", "0 .0427 .1309 .2219 .2607 .3869 .3963", numbers(um.times_s, 4)],
        ["eq 14, amplitudes", "1 -1 1 -1 1 -1 1", numbers(um.amplitudes, 0)],
        [
            "eq 15, times s (every printed one after the first is 1 ms late)",
            "0 .044 .132 .168 .211 .223 .262 .299 .388 .390 .397 .429 .555 .564",
            numbers(both.times_s, 4),
        ],
        [
            "eq 15, amplitudes (10th printed -.63, 14th .36)",
            ".63 -.63 .63 .37 -.37 -.63 .63 .37 -.63 -.63 .63 .37 -.37 .36",
            numbers(both.amplitudes, 2),
        ],
        ["eq 15, sum of amplitudes", "1, but .73 as printed", f"{both.amplitudes.sum():.6f}"],
        ["eq 15, levels", "0 .37 .63 1", numbers(sorted({round(x, 2) for x in both.levels}), 2)],
    ]
    swapped = Shaper(amplitudes=zv.amplitudes[::-1], times_s=zv.times_s)
    cases = [
        ("Figure 6, amplitudes swapped", "45 % less only: 41.8 %", swapped, PAPER),
        ("Figure 6, both .63227", "under 30 %: 26.5 %", trains(zv, [zv.amplitudes[0]] * 2), PAPER),
        ("Figure 6, both .5", "20.9 %", trains(zv, [0.5, 0.5]), PAPER),
        ("Figure 6, convolved", "0", both, PAPER),
        ("ZV of 0.17 at 0.0089", "24.8 %", zv, TRUE),
        ("UM of 0.17 at 0.0089", "14.0 %", um, TRUE),
        ("both of 0.17 at 0.0089", "3.5 %", both, TRUE),
        ("ZV of 0.17 on the model, 3.029 Hz", "24.7 %", zv, MODEL),
        ("UM of 0.17 on the model, 3.029 Hz", "13.9 %", um, MODEL),
        ("both of 0.17 on the model, 3.029 Hz", "3.4 %", both, MODEL),
    ]
    rows += [[name, told, f"{vibration_of(s, m) * 100:.2f} %"] for name, told, s, m in cases]
    table("The paper's shapers", ("figure", "printed or recomputed before", "here"), rows)


def trains(like: Shaper, amplitudes: Sequence[float]) -> Shaper:
    return Shaper(amplitudes=np.array(amplitudes), times_s=like.times_s)


def robustness() -> None:
    """Duration, insensitivity and the worst of higher modes for every kind, undamped."""
    mode = FlexibleMode(1.0)
    rows = []
    for kind in KINDS:
        shaper = design(kind, mode)
        found = insensitivity(shaper, mode)
        higher = check_higher_modes(shaper, mode)
        export = klipper_export(shaper, mode)
        rows.append(
            [
                kind,
                f"{shaper.duration_s:.4f}",
                f"{found.value:.4f}",
                f"{shaper.over_level:.2f}",
                f"{higher.peak:.2f} at {higher.peak_hz:.2f} f",
                export.shaper_type or "none",
            ]
        )
    si = specified_insensitivity(mode, 0.2)
    rows.append(
        [
            "si, 20 %",
            f"{si.duration_s:.4f}",
            f"{insensitivity(si, mode).value:.4f}",
            f"{si.over_level:.2f}",
            f"{check_higher_modes(si, mode).peak:.2f}",
            klipper_export(si, mode).shaper_type or "none",
        ]
    )
    header = (
        "shaper", "periods", "insensitivity", "leaves [0, 1] by",
        "most at 1.5 to 10 f", "Klipper",
    )  # fmt: skip
    table("Every kind, undamped, tolerance 5 %", header, rows)
    two = [FlexibleMode(3.04, 0.009), FlexibleMode(9.1, 0.01)]
    direct = direct_shaper([Requirement(m) for m in two])
    joined = convolve(*(design("zv", m) for m in two))
    rows = [
        [name, f"{s.duration_s:.5f}", " ".join(f"{vibration_of(s, m):.1e}" for m in two)]
        for name, s in (
            ("two ZV convolved", joined),
            ("direct", direct),
            ("two UM-ZV convolved", convolve(*(design("um-zv", m) for m in two))),
            ("unit magnitude, direct", direct_unit_magnitude([Requirement(m) for m in two])),
        )
    ]
    table("Two modes, 3.04 Hz and 9.1 Hz", ("design", "duration s", "V of each"), rows)


def optimal() -> None:
    """The time-optimal move, the robust optimum, and every shaped move over both."""
    best = time_optimal(MOVE)
    robust = robust_optimum(MOVE, relative=0.2, tolerance=0.01)
    rows = [
        ["unshaped, rigid", ".8944", f"{MOVE.rigid_duration_s:.6f}"],
        ["time-optimal", ".920678", f"{best.command.duration_s:.6f}"],
        ["its switches", ".383164 .460339 .537513", numbers(best.command.switches_s, 6)],
        ["agreement with Pontryagin's condition, >= 0", "-", f"{best.certificate:.1e}"],
        ["robust optimum, 1 % over +-20 %", "-", f"{robust.duration_s:.4f}"],
    ]
    table("200 mm, 1 m/s^2, 3.04 Hz, undamped: seconds", ("move", "facts sheet", "here"), rows)
    printed = {"um-zv": "1.0041", "zv": "1.0589", "um-zvd": "1.1354", "zvd": "1.2234"}
    mode = MOVE.modes[0]
    shapers = [design(kind, mode) for kind in KINDS if not kind.startswith("negative")]
    shapers += [design(k, mode, tolerance=0.01) for k in ("ei", "2hump-ei", "um-ei", "um-2ei")]
    shapers.append(specified_insensitivity(mode, 0.2, 0.01))
    names = [s.name for s in shapers[:-5]]
    names += [f"{s.name}, 1 %" for s in shapers[-5:]]
    rows = [
        [
            name,
            printed.get(name, "-"),
            f"{r.duration_s:.4f}",
            f"{r.over_optimal:.3f}",
            f"{r.over_robust:.3f}",
            f"{r.worst_step * 100:.2f} %",
            f"{r.worst_unshaped * 100:.2f} %",
        ]
        for name, r in zip(
            names, compare_shapers(MOVE, shapers, relative=0.2, tolerance=0.01), strict=True
        )
    ]
    header = (
        "shaped move", "facts s", "here s", "over optimal", "over robust",
        "worst over +-20 %, of a step", "of the unshaped move's",
    )  # fmt: skip
    table("Shaped moves", header, rows)


def front() -> None:
    """Residual against time on a 10 ms scan: free levels, and on/off levels found."""
    robust = robust_optimum(MOVE, relative=0.2, tolerance=0.01).duration_s
    rows = []
    ticks = (89, 92, 96, 100, 104, 107, 109, 113, 117, 119)
    for point in residual_front(MOVE, relative=0.2, tolerance=0.01, tick_s=0.01, ticks=ticks):
        rows.append(
            [
                f"{point.duration_s:.2f}",
                f"{point.duration_s / robust:.3f}",
                "too short" if point.free is None else f"{point.free * 100:.2f} %",
                "none found" if point.switched is None else f"{point.switched * 100:.2f} %",
            ]
        )
    header = ("duration s", "over robust optimum", "free levels, least", "on/off within 1 %")
    table("Worst residual over +-20 % of 3.04 Hz, of one step, on a 10 ms scan", header, rows)


def rounding() -> None:
    """Trains on whole ticks over the band that the exact ones keep."""
    cases = (
        ("um-ei", 0.17, 0.001), ("um-2ei", 0.17, 0.001), ("um-2ei", 0.0089, 0.01),
        ("zvd", 0.0089, 0.01), ("2hump-ei", 0.0089, 0.01), ("3hump-ei", 0.0089, 0.01),
        ("zv*um-2ei", 0.0089, 0.01),
    )  # fmt: skip
    rows = []
    for kind, damping, tick_s in cases:
        mode = FlexibleMode(3.04, damping)
        shaper = convolve(*(design(one, mode) for one in kind.split("*")))
        over = realise(shaper, [mode], ControllerLimits(tick_s)).bands[0]
        rows.append(
            [
                f"{kind}, {damping:g}",
                f"{tick_s * 1e3:g}",
                f"{over.low_hz:.2f} to {over.high_hz:.2f}",
                *(f"{worst * 100:.1f} %" for worst in (over.nearest, over.made)),
                *(f"{w:.3f}" for w in (over.designed_width, over.nearest_width, over.made_width)),
            ]
        )
    header = (
        "shaper, damping", "tick ms", "band Hz", "worst, nearest ticks", "worst, searched",
        "insensitivity, exact", "nearest", "searched",
    )  # fmt: skip
    table("Trains on whole ticks", header, rows)


def moves() -> None:
    """One move on the winder with a swinging eye and one on the stitcher, by the twin."""
    criteria = (
        Criterion(name="residual_vibration", options={"after": 0.15, "window": 0.35}),
        Criterion(name="shaping_deviation"),
    )
    spec = Spec(name="residual", criteria=criteria)
    cases = (
        ("lathe-winder+springy", "X 150", "400 mm/s", ("12.463Hz:0.0574",)),
        ("stitcher", "X 100", "190 mm/s", ("10.952Hz:0.2707",)),
        ("stitcher", "Y 100", "190 mm/s", ("15.302Hz:0.2009", "29.828Hz:0.0434")),
    )
    rows = []
    for reference, words, feed, modes in cases:
        machine = load_machine(reference)
        axis = words[0]
        for kind in (None, "zv", "zvd", "ei"):
            shaper = None if kind is None else "*".join(f"{kind}:{m}" for m in modes)
            options = Options(shaper=shaper, feed=parse_feed(feed))
            with tempfile.TemporaryDirectory() as folder:
                job = Path(folder) / "move.prg"
                job.write_text(f"%\nO 1;\nN 10 G01 G91 F600;\nN 20 {words};\nN 30 M30;\n%\n")
                proof = prove(job, machine, spec, options)
                duration_s = proof.plan.motion.trajectory.duration_s
            results = {(r.name, r.axis): r for r in proof.verdict.results}
            left = results["residual_vibration", axis].measured
            away = results["shaping_deviation", ""].measured
            assert left is not None and away is not None
            rows.append(
                [
                    reference,
                    words,
                    kind or "unshaped",
                    " and ".join(modes),
                    f"{duration_s:.4f}",
                    f"{left * 1e3:.4f}",
                    f"{away * 1e3:.4f}",
                ]
            )
    header = (
        "machine", "move mm", "shaper", "closed-loop modes", "duration s",
        "residual vibration mm", "off the path mm",
    )  # fmt: skip
    table("Shaped and unshaped, 0.15 to 0.5 s after the command ends", header, rows)


SECTIONS: dict[str, Callable[[], None]] = {
    "facts": facts,
    "robustness": robustness,
    "optimal": optimal,
    "front": front,
    "rounding": rounding,
    "moves": moves,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("section", nargs="*", choices=[*SECTIONS, []])
    for name in parser.parse_args().section or SECTIONS:
        SECTIONS[name]()


if __name__ == "__main__":
    main()
