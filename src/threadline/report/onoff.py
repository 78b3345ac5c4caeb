"""What the shapers of an on/off machine do, in numbers and pictures.

``python -m threadline.report.onoff FOLDER`` prints the tables and writes the figures.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.jobs import Job, read_job
from threadline.machine import Machine, load_machine
from threadline.plant.pneumatic import StepRinging, flow_mode, step_ringing
from threadline.report.style import figure_style
from threadline.shaping import FlexibleMode, Shaper, convolve, design
from threadline.shaping.types import UNSHAPED
from threadline.signals import SwitchSchedule
from threadline.targets.plc_net import petri_net
from threadline.targets.schedule import Scheduled, ScheduledMove, compile_schedule
from threadline.targets.schedule_options import shaping_of
from threadline.twin.switching import SwitchOptions, ringing_m, simulate_switching

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = ("zv", "zvd", "um-zv", "um-zvd", "um-ei", "um-2ei", "zv*um-2ei", "negative-zv")
MICRO = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class BreakSweep:
    """Ringing of the frame after a beam was broken, by the instant of the break.

    Parameters
    ----------
    name
        Of the shaper.
    times_s, ringing_m
        (n,) since the move began; amplitude of the frame once the valves are shut.
    over_level
        By how much the command exceeds the unshaped level.
    """

    name: str
    times_s: FloatArray
    ringing_m: FloatArray
    over_level: float


def train_of(kind: str, mode: FlexibleMode) -> Shaper:
    """Return the shaper of a word: kinds joined by ``*``, or ``none``."""
    if kind == "none":
        return UNSHAPED
    made = [design(word, mode) for word in kind.split("*")]
    return made[0] if len(made) == 1 else convolve(*made)


def level_steps(shaper: Shaper, on_s: float) -> tuple[FloatArray, FloatArray]:
    """Return times, s, and heights of the steps of a shaped move that is on for ``on_s``."""
    times = np.concatenate((shaper.times_s, shaper.times_s + on_s))
    heights = np.concatenate((shaper.amplitudes, -shaper.amplitudes))
    order = np.argsort(times, kind="stable")
    return times[order], heights[order]


def break_sweep(name: str, shaper: Shaper, on_s: float, ringing: StepRinging) -> BreakSweep:
    """Break the beam at every millisecond of the move: the level drops to 0 at once.

    Steps of the level ring on independently; each counts with its decay since. The valves that
    shut are one more step, of minus the level of that instant.
    """
    return sweep_of_steps(name, *level_steps(shaper, on_s), ringing)


def sweep_of_steps(
    name: str, steps: FloatArray, heights: FloatArray, ringing: StepRinging
) -> BreakSweep:
    """The same for any command: its level steps by ``heights`` at the times ``steps``, s."""
    times = np.arange(0.0, steps[-1] + 0.2, 1e-3)
    done = steps[None, :] <= times[:, None] + 1e-12
    gone = np.where(done, times[:, None] - steps[None, :], 0.0)
    ring = np.where(done, heights[None, :] * np.exp(ringing.pole * gone), 0.0).sum(axis=1)
    level = np.where(done, heights[None, :], 0.0).sum(axis=1)
    size = np.abs(ringing.amplitude_m * (ring - level))
    levels = np.cumsum(heights)
    return BreakSweep(name, times, size, float(max(0.0, levels.max() - 1.0, -levels.min())))


def break_sweeps(machine: Machine, axis: str = "X") -> list[BreakSweep]:
    """Return a sweep for the unshaped move and for each kind of shaper, full stroke."""
    cylinder = machine.cylinders[axis]
    on_s, ringing = cylinder.stroke.si / cylinder.speed.si, step_ringing(machine, axis)
    mode = FlexibleMode(*flow_mode(machine, axis))
    return [break_sweep(kind, train_of(kind, mode), on_s, ringing) for kind in ("none", *KINDS)]


def break_on_twin(scheduled: Scheduled, move: ScheduledMove, scans: IntArray) -> FloatArray:
    """Return what rings, m, when the valves shut at some scans after a move began: by the twin.

    A beam is broken half a scan before. The move is played alone from the start of the stroke.
    (n,) amplitudes at the instant of the shutting, by a sine fitted to what the frame does once
    lag and dead time are over.
    """
    machine, commands = scheduled.machine, scheduled.commands
    cylinder, pole = machine.cylinders[move.axis], step_ringing(machine, move.axis).pole
    rows = (commands.ticks >= move.first_tick) & (commands.ticks <= move.last_tick)
    alone = replace(
        commands,
        ticks=commands.ticks[rows] - move.first_tick,
        levels=commands.levels[rows],
        operation=commands.operation[rows],
        duration_ticks=move.last_tick - move.first_tick + round(0.2 / commands.clock.period_s),
        events=(),
    )
    calm_s = cylinder.delay.si + 8.0 * cylinder.lag.si
    period_s = float(commands.clock.period_s)
    found = []
    for scan in scans.tolist():
        options = SwitchOptions(after_s=calm_s + 1.0, break_s=(scan - 0.5) * period_s)
        shut_s = scan * period_s
        recording = simulate_switching(alone, machine, options)
        size = ringing_m(recording, move.axis, shut_s + calm_s, pole)
        found.append(size * np.exp(-pole.real * (calm_s - cylinder.delay.si)))
    return np.array(found)


def move_sweep(
    scheduled: Scheduled, move: ScheduledMove, breaks: int = 8
) -> tuple[BreakSweep, tuple[FloatArray, FloatArray]]:
    """Return the sweep of a move as it is scheduled, and times and sizes that the twin finds."""
    period_s = float(scheduled.commands.clock.period_s)
    steps = np.array(move.levels.ticks, dtype=np.float64) * period_s
    heights = np.diff(move.levels.levels, prepend=0.0)
    ringing = step_ringing(scheduled.machine, move.axis)
    sweep = sweep_of_steps("as scheduled", steps, heights, ringing)
    scans = np.unique(np.linspace(1, move.levels.ticks[-1], breaks).round().astype(np.int64))
    instants = scans.astype(np.float64) * period_s
    return sweep, (instants, break_on_twin(scheduled, move, scans))


def break_figure(
    sweeps: list[BreakSweep], twin: tuple[FloatArray, FloatArray] | None = None
) -> Figure:
    """Draw the ringing after a break against the instant of the break, a panel per shaper.

    ``twin``: times, s, and sizes, m, that go into the first panel.
    """
    from matplotlib.figure import Figure

    columns = 3
    rows = -(-len(sweeps) // columns)
    figure = Figure(figsize=(9.0, 2.3 * rows))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    worst = next(float(s.ringing_m.max()) for s in sweeps if s.name == "none") * MICRO
    for panel, sweep in zip(panels, sweeps, strict=False):
        panel.plot(sweep.times_s * 1e3, sweep.ringing_m * MICRO, color="#0072B2", linewidth=1.2)
        panel.axhline(worst, color="#D55E00", linestyle=(0, (1, 1.5)), linewidth=1.2)
        over = f", {sweep.over_level:.0%} over the level" if sweep.over_level > 1e-9 else ""
        panel.set_title(f"{sweep.name}{over}")
    if twin is not None:
        panels[0].plot(twin[0] * 1e3, twin[1] * MICRO, "o", color="black", mfc="none")
    for panel in panels[len(sweeps) :]:
        panel.set_visible(False)
    figure.supxlabel("beam broken, ms after the move began (dotted: worst unshaped)")
    figure.supylabel("frame rings then, um")
    return figure


def petri_figure(scheduled: Scheduled) -> Figure:
    """Draw the Petri net of a schedule: a row of places per step, bars for transitions."""
    from matplotlib.figure import Figure

    net = petri_net(scheduled)
    steps = list(dict.fromkeys(place.step for place in net.places))
    by_step = {step: [p for p in net.places if p.step == step] for step in steps}
    widest = max(len(places) for places in by_step.values())
    figure = Figure(figsize=(1.25 * widest + 1.6, 1.15 * len(steps) + 0.8))
    panel = figure.subplots()
    for row, step in enumerate(steps):
        panel.text(-0.7, -row, step, ha="right", va="center", weight="bold")
        for column, place in enumerate(by_step[step]):
            face = "white" if place.wait is None else "#E8E8E8"
            panel.plot(column, -row, "o", markersize=21, mfc=face, mec="black", zorder=3)
            panel.text(column, -row, str(place.number), ha="center", va="center", zorder=4)
            label = f"{place.due_ms} ms" if place.wait is None else place.wait[0]
            panel.plot([column + 0.5] * 2, [-row - 0.22, -row + 0.22], "k-", linewidth=2.4)
            panel.annotate(
                "",
                (column + 0.95 - 0.2, -row),
                (column + 0.2, -row),
                arrowprops={"arrowstyle": "->", "linewidth": 0.8},
                zorder=1,
            )
            panel.text(column + 0.5, -row + 0.27, label, ha="center", va="bottom", fontsize=6)
            flows = "\n".join(n for n in place.on if n != "main_air")
            panel.text(column, -row - 0.25, flows, ha="center", va="top", fontsize=4.6)
    panel.set_xlim(-2.2, widest + 0.2)
    panel.set_ylim(-len(steps) + 0.3, 0.75)
    panel.set_axis_off()
    panel.set_title(
        f"{scheduled.job.name}: one token; grey places wait for an input; a broken beam returns "
        "the token to place 0, everything off"
    )
    return figure


def step_ends(commands: SwitchSchedule) -> list[tuple[str, int]]:
    """Return every step of the cycle with the tick at which it ends."""
    events = [e for e in commands.events if e.kind == "tool"]
    ends = [*(e.tick for e in events[1:]), commands.duration_ticks]
    return [(e.name, end) for e, end in zip(events, ends, strict=True)]


def until(commands: SwitchSchedule, tick: int) -> SwitchSchedule:
    """Return the beginning of a schedule, up to ``tick``."""
    count = int(np.searchsorted(commands.ticks, tick))
    return replace(
        commands,
        ticks=commands.ticks[:count],
        levels=commands.levels[:count],
        operation=commands.operation[:count],
        duration_ticks=tick,
        events=tuple(e for e in commands.events if e.tick < tick),
    )


@dataclass(frozen=True, slots=True)
class StepVibration:
    """Ringing at the end of a step of the cycle, m."""

    step: str
    x_m: float
    z_m: float


def cycle_ringing(scheduled: Scheduled, settle_s: float = 1.0) -> list[StepVibration]:
    """Return the ringing that each step of the cycle leaves, with all that went before it.

    The twin plays the cycle up to the end of the step and then stands still for ``settle_s``.
    """
    rows = []
    machine = scheduled.machine
    for step, end in step_ends(scheduled.commands):
        part = until(scheduled.commands, end)
        recording = simulate_switching(part, machine, SwitchOptions(after_s=settle_s + 1.0))
        times, _ = recording.samples("operation")
        begin = float(times[-1]) - 0.8
        x, z = (
            ringing_m(recording, axis, begin, step_ringing(machine, axis).pole)
            for axis in ("X", "Z")
        )
        rows.append(StepVibration(step, x, z))
    return rows


def scheduled_cycle(job: Job, machine: Machine, shaper: str, paper: bool) -> Scheduled:
    """Return the cycle with ``shaper`` made for the paper's mode, or for the machine's own."""
    mode, damping = ("3.04 Hz", 0.17) if paper else (None, None)
    shaping = shaping_of(machine, shaper, mode=mode, damping_ratio=damping)
    return compile_schedule(job, machine, shaping)


CASES = (
    ("own", "letter-placer+whole-scans+own-damping", False),
    ("own, 50 % hysteresis", "letter-placer+whole-scans+own-damping+hysteresis", False),
    ("paper's shaper, own damping", "letter-placer+whole-scans", True),
    ("paper's shaper, damping 0.17", "letter-placer+whole-scans+paper-damping", True),
)


def print_tables(job_file: Path) -> None:
    """Print both tables."""
    print("break, um: worst and mean over the instants, over the level")
    sweeps = break_sweeps(load_machine("letter-placer"))
    for sweep in sweeps:
        worst, mean = sweep.ringing_m.max() * MICRO, sweep.ringing_m.mean() * MICRO
        end = sweep.ringing_m[-1] * MICRO
        print(
            f"{sweep.name:12s} worst {worst:7.1f} mean {mean:7.1f} unbroken {end:7.1f} "
            f"over {sweep.over_level:.2f}"
        )
    for title, reference, paper in CASES:
        machine = load_machine(reference)
        job = read_job(job_file, machine)
        for shaper in ("none", "zv"):
            rows = cycle_ringing(scheduled_cycle(job, machine, shaper, paper))
            cells = " ".join(f"{r.step} {r.x_m * MICRO:.0f}/{r.z_m * MICRO:.0f}" for r in rows)
            print(f"{title}; {shaper}: {cells} (um, X/Z)", flush=True)


def write_figures(job_file: Path, folder: Path) -> list[Path]:
    """Write the figures and return their files."""
    machine = load_machine("letter-placer")
    scheduled = scheduled_cycle(read_job(job_file, machine), machine, "zv", True)
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    with figure_style():
        for name, figure in (
            ("broken-beam", break_figure(break_sweeps(machine))),
            ("petri-net", petri_figure(scheduled)),
        ):
            for suffix in ("png", "svg"):
                files.append(folder / f"{name}.{suffix}")
                figure.savefig(files[-1])
    return files


if __name__ == "__main__":
    JOB = Path("examples/letter-cycle.toml")
    for file in write_figures(JOB, Path(sys.argv[1])):
        print(file)
    print_tables(JOB)
