"""The report of a proof of an on/off machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from threadline.doubts import doubts, doubts_of_all
from threadline.foreign_messages import grouped
from threadline.options import OF_AXES
from threadline.pipeline import Proof
from threadline.plan import Plan
from threadline.report.document import (
    Document,
    Printed,
    Table,
    changes,
    options_facts,
    origin_facts,
    run_facts,
)
from threadline.report.drawn_run import drawn_run
from threadline.report.onoff import break_figure
from threadline.report.petri_net import petri_figures
from threadline.report.publish import write_document
from threadline.report.style import figure_style
from threadline.report.switching_figures import (
    cycle_figure,
    frame_figure,
    residual_figure,
    residuals_figure,
    shaper_words,
)
from threadline.targets.schedule_moves import shaping_words
from threadline.verdict import closing, closing_of_all, step_rows, verdict_rows

if TYPE_CHECKING:
    from threadline.search import Comparison
    from threadline.search.studied import Studied

_DRAWN = ("residual_vibration",)
_CAPTIONS = {
    "residual": "What rings in the frame once each step has brought its cylinder to rest"
    "{beside}; dotted: the limit.",
    "cycle": "Pistons, and what was switched on, over the cycle; dotted lines part the steps.",
    "frame": "The frame over the cycle{beside}.",
    "broken-beam": "A beam of the light grid is broken at each instant of the longest move and all "
    "valves shut: what rings then. First the move as it is scheduled, with the twin's own runs as "
    "circles at the scans that shut the valves; then every kind of shaper, made for "
    "the machine's own mode.",
    "petri-net": "The sequence that the PLC program runs, a Petri net with one token: places "
    "numbered as in its text, below them the outputs that are on. A bar lets the token pass after "
    "the time of its own place, or when its input comes; grey places wait for an input, and one "
    "that does not come in time is a fault. The places of homing bring every cylinder back from "
    "wherever it stands. The program's own times count on from the last input "
    "that was waited for, and add these up. The dashed line is what every place has: a broken "
    "beam, a missing enable, a late scan or a contact that cannot be believed return the token to "
    "place 0, everything off.",
}


def write_switching(studied: Studied, folder: Path, tables: Sequence[Printed] = ()) -> Path:
    """Write the report of a proof into ``folder``; return the path of the HTML page.

    ``tables`` come behind those of the proof: of the search that found its job.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    proof, unshaped = studied.proof, studied.unshaped
    plan = proof.plan
    shaper = plan.options.get("shaper")
    header, rows = verdict_rows(proof.verdict, every_axis=False)
    how = shaper_words(plan) if shaper is None else f"shaper {shaper}"
    steps = [_step_table(proof, how)]
    if unshaped is not None:
        steps.append(_step_table(unshaped, "without a shaper"))
    run = drawn_run(proof, _DRAWN)
    with figure_style():
        figures = {
            "residual": residual_figure(proof, unshaped),
            "frame": frame_figure(proof, run.recording, unshaped),
            "cycle": cycle_figure(proof, run.recording),
        }
        if studied.beam is not None:
            beam = studied.beam
            twin = beam.instants_s, beam.simulated_m
            figures["broken-beam"] = break_figure(beam.sweeps, twin)
        captions = dict(_CAPTIONS)
        beside = "" if unshaped is None else ", as planned and without a shaper"
        for name in ("residual", "frame"):
            captions[name] = captions[name].format(beside=beside)
        for name in ("frame", "cycle"):
            captions[name] += run.words(proof)
        for number, figure in enumerate(petri_figures(plan.scheduled), start=1):
            name = "petri-net" if number == 1 else f"petri-net-{number}"
            figures[name] = figure
            captions[name] = _CAPTIONS["petri-net"] if number == 1 else "The sequence, continued."
        document = Document(
            title=f"{plan.job.name} on {plan.machine.name}",
            subtitle="; ".join(
                [
                    plan.machine.title,
                    how,
                    *(f"{axis} {words}" for axis, words in shaping_rows(plan)),
                ]
            ),
            verdicts=[(closing(proof.verdict), proof.verdict.passed)],
            warnings=grouped(doubts(proof)),
            tables=[
                Table(title="Criteria", header=header, rows=rows),
                *changes(proof.verdict),
                *steps,
                *(Table(title=t, header=h, rows=r) for t, h, r in tables),
            ],
            figures=figures,
            captions=captions,
            facts=_facts(proof),
        )
        return write_document(document, folder, "report")


def write_switching_comparison(found: Comparison, folder: Path, tables: Sequence[Printed]) -> Path:
    """Write the report of a comparison of shapers; return the path of the HTML page."""
    first = found.proofs[0].plan
    good = all(proof.verdict.passed for proof in found.proofs)
    names = [proof.plan.options.get("shaper", "none") for proof in found.proofs]
    with figure_style():
        figures = {"residual": residuals_figure(found.proofs)}
        captions = {
            "residual": "What each step leaves ringing, shaper by shaper; dotted: the limit."
        }
        for name, proof in zip(names, found.proofs, strict=True):
            stem = "cycle-" + name.replace(":", "-").replace("*", "-by-").replace(" ", "")
            run = drawn_run(proof, _DRAWN)
            figures[stem] = cycle_figure(proof, run.recording)
            captions[stem] = f"Shaper {name}: pistons and outputs over the cycle.{run.words(proof)}"
        document = Document(
            title=f"{first.job.name} on {first.machine.name}: comparison",
            subtitle=first.machine.title,
            verdicts=[(closing_of_all([proof.verdict for proof in found.proofs]), good)],
            warnings=[
                *(f"{name} is refused: {why}" for name, why in found.refused),
                *grouped(doubts_of_all(found.proofs)),
            ],
            tables=[Table(title=t, header=h, rows=r) for t, h, r in tables],
            figures=figures,
            captions=captions,
            facts=[
                *_facts(found.proofs[0]),
                *((f"case {n}", f"shaper {name}") for n, name in enumerate(names, start=1)),
            ],
        )
        return write_document(document, folder, "comparison")


def about_switching(proof: Proof) -> list[str]:
    """Return the lines below the verdict: the shaper of each cylinder."""
    return [f"Cylinder {axis}:".ljust(22) + words for axis, words in shaping_rows(proof.plan)]


def shaping_rows(plan: Plan) -> list[list[str]]:
    """Return rows of a cylinder and its shaper, in words; none if no shaper was asked for."""
    if "shaper" not in plan.options:
        return []
    shaping = plan.scheduled.shaping
    return [[axis, shaping_words(shaping.get(axis))] for axis in plan.machine.cylinders]


def _step_table(proof: Proof, how: str) -> Table:
    header, rows = step_rows(proof.verdict)
    return Table(title=f"Step by step, {how}", header=header, rows=rows)


def _facts(proof: Proof) -> list[tuple[str, str]]:
    plan = proof.plan
    return [
        *origin_facts(plan.machine, plan.job),
        ("simulated", "yes" if proof.verdict.simulated else "no, recorded live"),
        *run_facts(proof.recording),
        ("scan", f"{float(plan.commands.clock.period_s) * 1e3:g} ms"),
        ("schedule", f"{plan.duration_s:g} s, {len(plan.scheduled.commands.ticks)} switchings"),
        *((f"cylinder {axis}", words) for axis, words in shaping_rows(plan)),
        *options_facts(plan.options, plan.machine, OF_AXES),
    ]
