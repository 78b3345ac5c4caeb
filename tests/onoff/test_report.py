"""The report of an on/off machine: a broken beam, the net, and the figures on its page."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.commands.intents import Scheduled, ScheduledMove
from threadline.commands.plc_net import petri_net
from threadline.commands.plc_watch import home_places
from threadline.commands.schedule import compile_schedule
from threadline.commands.schedule_options import shaping_of
from threadline.dynamics.pneumatic import flow_mode, step_ringing
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.motion.shaping import FlexibleMode
from threadline.proof.options import Options
from threadline.proof.pipeline import prove
from threadline.report.proof import write_report
from threadline.report.style import figure_style
from threadline.report.switching import break_figure, petri_figures
from threadline.report.switching_figures import cycle_figure, frame_figure, residual_figure
from threadline.search.broken_beam import (
    break_on_twin,
    break_sweep,
    break_sweeps,
    move_sweep,
    train_of,
)
from threadline.search.report_data import report_data
from threadline.verdict import load_spec

TRIMMED = "letter-placer+whole-scans+own-damping"
ACROSS = """[[operation]]
valve = "main_air"
[[operation]]
step = "across"
move = { X = "200 mm" }
"""


def across(folder: Path, shaper: str) -> tuple[Scheduled, ScheduledMove]:
    file = folder / "across.toml"
    file.write_text(ACROSS)
    machine = load_machine(TRIMMED)
    scheduled = compile_schedule(read_job(file, machine), machine, shaping_of(machine, shaper))
    return scheduled, scheduled.moves[0]


@pytest.mark.parametrize("shaper", ["none", "zv", "um-zv"])
def test_twin_rings_after_a_broken_beam_as_the_residues_say(tmp_path: Path, shaper: str) -> None:
    """The picture shows residues of one mode; the twin does not know them.

    The bar is 2 % of the worst: the air's damping builds up over the first 10 mm in the twin alone.
    """
    scheduled, move = across(tmp_path, shaper)
    sweep, (instants, found) = move_sweep(scheduled, move, breaks=7)
    assert len(found) == 7
    expected = np.interp(instants, sweep.times_s, sweep.ringing_m)
    assert sweep.ringing_m.max() > 7e-4
    assert np.abs(found - expected).max() < 0.02 * sweep.ringing_m.max()


def test_unit_magnitude_halves_what_a_broken_beam_leaves(tmp_path: Path) -> None:
    """The reason for UM: the worst of all instants, shaped against unshaped, by the twin alone."""
    scans = np.arange(5, 60, 12)
    worst = {}
    for shaper in ("none", "um-zv"):
        scheduled, move = across(tmp_path, shaper)
        worst[shaper] = break_on_twin(scheduled, move, scans).max()
    assert worst["um-zv"] < 0.6 * worst["none"]


def test_unbroken_end_of_a_sweep_is_the_residual_of_the_shaper() -> None:
    """After the move ZV leaves nothing; over-pressure exceeds the level by its 100 %."""
    machine = load_machine("letter-placer")
    mode = FlexibleMode(*flow_mode(machine, "X"))
    ringing = step_ringing(machine, "X")
    for kind, over in (("zv", 0.0), ("um-2ei", 0.0), ("negative-zv", 1.0)):
        sweep = break_sweep(kind, train_of(kind, mode), 0.2 / 0.43, ringing)
        assert sweep.ringing_m[-1] < 1e-9
        assert sweep.over_level == pytest.approx(over, abs=1e-9)
    unshaped = break_sweep("none", train_of("none", mode), 0.2 / 0.43, ringing)
    # A step up and one down, half a period apart at 0.172 s, add; here they are 0.465 s apart.
    turn = np.exp(ringing.pole * 0.2 / 0.43)
    decayed = np.exp(ringing.pole.real * (unshaped.times_s[-1] - 0.2 / 0.43))
    expected = abs(ringing.amplitude_m) * abs(turn - 1.0) * decayed
    assert unshaped.ringing_m[-1] == pytest.approx(expected, rel=1e-9)


def test_break_figure_has_a_panel_for_every_shaper_and_the_circles_of_the_twin() -> None:
    machine = load_machine("letter-placer")
    with figure_style():
        sweeps = break_sweeps(machine)
        figure = break_figure(sweeps, (np.array([0.1]), np.array([2e-4])))
    panels = [p for p in figure.axes if p.get_visible()]
    assert [p.get_title(loc="left").split(",")[0] for p in panels] == [s.name for s in sweeps]
    for panel, sweep in zip(panels, sweeps, strict=True):
        curve, limit = panel.lines[:2]
        assert curve.get_ydata() == pytest.approx(sweep.ringing_m * 1e6)
        assert limit.get_ydata()[0] == pytest.approx(1511, abs=1)
    assert panels[0].lines[2].get_xydata().tolist() == [[100.0, 200.0]]


def test_petri_net_has_a_bar_for_every_place(examples: Path) -> None:
    """Rows of four; a bar shows the time of its own place, or the input with its timeout.

    The net's own times count from the last input: on the way down 10 ms after the wait, then the
    impulses of the shaper, 0.172 s or 180 ms on the scan, so that the first level lasts 170 ms.
    Every page has place 0, and the way back to it beside each of its rows. After the 55 places of
    the cycle come the five of homing: air, then each cylinder on its way and pressed there. Six
    places of the cycle, in which a cylinder creeps, stand below the place that waits.
    """
    machine = load_machine(TRIMMED)
    scheduled = compile_schedule(
        read_job(examples / "letter-cycle.toml", machine), machine, shaping_of(machine, "zv")
    )
    with figure_style():
        figures = petri_figures(scheduled)
    panels = [panel for figure in figures for panel in figure.axes]
    assert len(panels) == len(figures) == 3
    for figure in figures:  # as wide as a page has room for, and no higher
        assert figure.get_size_inches()[0] == 7.2
        assert figure.get_size_inches()[1] < 9.5
        assert min(t.get_fontsize() for t in figure.axes[0].texts) >= 7.0
    texts = [t.get_text() for panel in panels for t in panel.texts]
    numbers = [int(t) for t in texts if t.isdigit()]
    opens = [place for place in petri_net(scheduled).places if place.opens]
    assert len(opens) == 6
    beside = {place.number for place in opens}
    assert sorted(numbers) == [0, 0, 0, *(n for n in range(1, 61) if n not in beside)]
    for place in opens:
        (below,) = [t for t in texts if f"creeps by {place.number}:" in t.split("\n")]
        assert below.split("\n")[-2:] == [
            name for name in place.on if name.startswith(("x_", "z_"))
        ]
    events = [e for e in scheduled.commands.events if e.kind == "wait"]
    waits = {
        f"{e.name}\n(at most {late:g} s)"
        for e, late in zip(events, scheduled.wait_timeouts_s, strict=True)
    }
    assert sum(t in waits for t in texts) == len(events) == 9
    solid = [n for panel in panels for n in panel.lines if n.get_linestyle() == "-"]
    assert sum(line.get_marker() != "o" for line in solid) == 54
    dashed = [n for panel in panels for n in panel.lines if n.get_linestyle() == "--"]
    assert len(dashed) >= 14
    assert sum("main_air" in t.split("\n") for t in texts) == 54  # it opens first and stays open
    home = home_places(scheduled, 55, 10)
    assert [place.number for place in home] == [56, 57, 58, 59, 60]
    home_ms = sum(place.due_ms for place in home if place.wait is None)
    own_ms = sum(int(t.removesuffix(" ms")) for t in texts if t.endswith(" ms"))
    scans = scheduled.commands.duration_ticks - len(events)
    assert own_ms - home_ms == pytest.approx(10 * scans, abs=10 * len(events))
    assert "170 ms" in texts
    assert "every output off; home leads to 56, and then start to 1" in texts
    assert sum(t.startswith("back to 0") for t in texts) == 2


@pytest.mark.long(
    shown_by="test_break_figure_has_a_panel_for_every_shaper_and_the_circles_of_the_twin"
)
def test_report_of_a_proof_shows_both_with_and_without_a_shaper(tmp_path: Path) -> None:
    file = tmp_path / "across.toml"
    file.write_text(ACROSS)
    machine = load_machine(TRIMMED)
    spec = load_spec(None, machine)
    proof = prove(file, machine, spec, Options(shaper="zv"))
    unshaped = prove(file, machine, spec, Options())
    with figure_style():
        bars = residual_figure(proof, unshaped).axes[0].patches
        cycle = cycle_figure(proof, proof.recording)
        frame = frame_figure(proof, proof.recording, unshaped).axes[0]
    shown = [p.get_height() for p in bars if p.get_height()]
    measured = [
        p.verdict.result("residual_vibration", "X").measured * 1e6  # type: ignore[operator]
        for p in (proof, unshaped)
    ]
    assert shown == pytest.approx(measured)
    assert sum(not str(line.get_label()).startswith("_") for line in frame.lines) == 2
    lanes = [t.get_text() for t in cycle.axes[-1].get_yticklabels()]
    assert lanes == list(machine.outputs)
    scheduled = replace(proof.plan.scheduled, warnings=("X is commanded to 50.1 mm instead",))
    proof = replace(proof, plan=replace(proof.plan, intent=scheduled))
    page = write_report(report_data(proof), tmp_path / "report").read_text(encoding="utf-8")
    assert "X is commanded to 50.1 mm instead" in page
    assert "IN SPEC" in page
    hertz, ratio = flow_mode(machine, "X")
    assert page.count(f"shaped by zv for {hertz:.4g} Hz, damping ratio {ratio:.4g}") == 2
    assert "sums of these, from the last input" in page
    for words in ("Step by step, shaper zv", "Step by step, without a shaper"):
        assert words in page
    facts = re.findall(r"<tr><td class=\"left\">([^<]*)</td><td class=\"left fact\">", page)
    assert {"job", "job file", "machine", "shaper"} <= set(facts)
    assert len(facts) == len(set(facts))
    assert not {"feed", "interpolation", "limits", "tolerance", "machine file"} & set(facts)
    names = {f.name for f in (tmp_path / "report").iterdir()}
    for figure in ("residual", "cycle", "frame", "broken-beam", "petri-net"):
        assert {f"report-{figure}.svg", f"report-{figure}.png"} <= names
        assert page.count(f'<figure id="{figure}"><svg') == 1
