"""Lines, stitches, steps and switchings of a job, which the page draws besides positions.

The same functions read a calculated plan, and a job that is shown before its calculation.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.reading import reading_within
from threadline.errors import ThreadlineError
from threadline.files import ChannelKind, Recording
from threadline.jobs.needle_holes import entering
from threadline.jobs.operations import (
    Job,
    Move,
    MoveRun,
    Source,
    ToolEvent,
    begins_circuit,
    lacking,
    move_runs,
)
from threadline.machine import Machine
from threadline.panel.programs import program_path
from threadline.panel.protocol import Preview
from threadline.panel.welcoming import mandrel_of
from threadline.proof.options import options_of
from threadline.proof.pipeline import Proof, open_job
from threadline.proof.request import chosen_machine
from threadline.verdict import sewn_stitches
from threadline.verdict.needle import has_stitches
from threadline.verdict.stitch_run import StitchRun

MOST_POINTS = 6000
"""Most points of a path, stitches, or changes of line that are sent to the page."""
_MOST_SWITCHED = 400  # an output with more changes would be drawn as a grey area
_MOST_READ = 2_000_000  # largest number of moves read from a job before its calculation
_MOST_TEXT = 300_000  # largest size of a program, bytes, whose text is shown
_STEP = "step "
_LEAST_TURN_M = 1e-4  # least distance between two turn-rounds


def plan_views(proof: Proof) -> dict[str, Any]:
    """Return lines, stitches, steps and switchings over the time of a proof's first run."""
    operations = _Operations.of(proof.recording)
    job = proof.plan.job
    lines, circuits = _lines(job, operations.operation)
    shown = np.flatnonzero(np.diff(lines, prepend=-1) | np.diff(circuits, prepend=0))
    shown = shown[:: max(1, -(-len(shown) // MOST_POINTS))]
    return {
        "lines": {
            "times_s": _listed(operations.begin_s[shown]),
            "line": lines[shown].tolist(),
            "circuit": circuits[shown].tolist(),
        },
        "stitches": _stitches(job, operations, _uses(proof)),
        "steps": _steps(job, operations),
        "lanes": _lanes(proof.recording),
        "turn_rounds": _turn_rounds(proof),
        "tension": tension_figures(proof.recording),
    }


class _Operations:
    """The operations of a recording in the order of their begins, and the instants, s."""

    def __init__(self, operation: IntArray, begin_s: FloatArray, end_s: float) -> None:
        self.operation, self.begin_s, self.end_s = operation, begin_s, end_s

    @classmethod
    def of(cls, recording: Recording) -> _Operations:
        channel = next((c for c in recording.channels if c.kind is ChannelKind.OPERATION), None)
        if channel is None:
            return cls(np.zeros(0, np.int64), np.zeros(0), 0.0)
        period_s = float(channel.clock.period_s) * channel.stride
        operations: list[IntArray] = [np.zeros(0, np.int64)]
        begin_s: list[FloatArray] = [np.zeros(0)]
        count, latest = 0, -1
        for block in recording:
            values = block.samples[channel.name].astype(np.int64)
            changes = np.flatnonzero(np.diff(values, prepend=latest))
            operations.append(values[changes])
            begin_s.append(period_s * (count + changes).astype(np.float64))
            count, latest = count + len(values), int(values[-1]) if len(values) else latest
        return cls(np.concatenate(operations), np.concatenate(begin_s), count * period_s)

    def ends_s(self, operations: IntArray) -> FloatArray:
        """Return the instants, s, at which the operations ``operations``, ascending, end."""
        following = np.searchsorted(self.operation, operations, side="right")
        return np.append(self.begin_s, self.end_s)[following]


def _lines(job: Job, operations: IntArray) -> tuple[IntArray, IntArray]:
    """Return (n,) line and (n,) circuit, 0 for none, of the ascending operations ``operations``.

    A circuit is a pass of an outermost subroutine call.
    """
    lines_found, circuits = np.zeros((2, len(operations)), np.int64)
    first = circuits_entered = 0
    previous_source: Source | None = None
    for item in job.runs():
        if isinstance(item, MoveRun):
            lines, passes = item.line, item.passes
        else:
            lines, passes = np.array([item.source.line]), item.source.passes
        source = Source("", int(lines[0]), passes)
        circuits_entered += begins_circuit(previous_source, source)
        previous_source = Source("", int(lines[-1]), passes)
        begin, end = np.searchsorted(operations, (first, first + len(lines)))
        lines_found[begin:end] = lines[operations[begin:end] - first]
        circuits[begin:end] = circuits_entered if passes else 0
        first += len(lines)
    return lines_found, circuits


def _steps(job: Job, operations: _Operations) -> list[dict[str, Any]]:
    """Return the named steps of a move list with their times."""
    steps: list[dict[str, Any]] = []
    if job.paced_by != "switchings":
        return steps
    for k, item in enumerate(job):
        if isinstance(item, ToolEvent) and item.name.startswith(_STEP):
            begin_s = (
                float(operations.ends_s(np.array([k - 1]))[0]) if len(operations.operation) else 0.0
            )
            steps.append(
                {
                    "name": item.name.removeprefix(_STEP),
                    "line": item.source.line,
                    "begin_s": begin_s,
                }
            )
    return steps


def _lanes(recording: Recording) -> list[dict[str, Any]]:
    """Return the inputs and outputs without an axis, and the times at which each changes."""
    switched = [
        c
        for c in recording.channels
        if c.kind in (ChannelKind.INPUT, ChannelKind.OUTPUT) and not c.axis
    ]
    first: dict[str, bool] = {}
    times: dict[str, list[float]] = {c.name: [] for c in switched}
    latest: dict[str, bool] = {}
    count = 0
    for block in recording if switched else ():
        for c in switched:
            is_on = block.samples[c.name] != 0
            if not len(is_on):
                continue
            state_before = latest.setdefault(c.name, bool(is_on[0]))
            first.setdefault(c.name, state_before)
            changes = np.flatnonzero(np.diff(is_on, prepend=state_before))
            period_s = float(c.clock.period_s) * c.stride
            times[c.name] += ((count + changes) * period_s).tolist()
            latest[c.name] = bool(is_on[-1])
        count += len(block.samples[switched[0].name])
    return [
        {
            "name": c.name,
            "input": c.kind is ChannelKind.INPUT,
            "on": first.get(c.name, False),
            "changes_s": [round(t, 4) for t in times[c.name]],
        }
        for c in switched
        if len(times[c.name]) <= _MOST_SWITCHED
    ]


def _turn_rounds(proof: Proof) -> dict[str, Any] | None:
    """Return instants and places at which the axis along the mandrel reverses; None without one."""
    mandrel = mandrel_of(proof.plan.machine)
    recording = proof.recording
    channel = None if mandrel is None else recording.find(ChannelKind.COMMANDED, mandrel.along)
    if mandrel is None or channel is None:
        return None
    period_s = float(channel.clock.period_s) * channel.stride
    turn_places: list[FloatArray] = [np.zeros(0)]
    turn_times_s: list[FloatArray] = [np.zeros(0)]
    count, direction, latest = 0, 0.0, 0.0
    for block in recording:
        places = block.samples[channel.name]
        steps = np.sign(np.diff(places, prepend=places[:1] if not count else latest))
        moving = np.flatnonzero(steps)
        turns = moving[np.diff(steps[moving], prepend=direction) * steps[moving] > 1.0]
        turn_places.append(np.where(turns > 0, places[turns - 1], latest))
        turn_times_s.append(period_s * (count + turns).astype(np.float64))
        if len(moving):
            direction = float(steps[moving[-1]])
        count, latest = count + len(places), float(places[-1]) if len(places) else latest
    places, times_s = np.concatenate(turn_places), np.concatenate(turn_times_s)
    far_apart = _further_apart(places, _LEAST_TURN_M)
    shown = np.flatnonzero(far_apart)[:: max(1, -(-int(far_apart.sum()) // MOST_POINTS))]
    return {
        "axis": mandrel.along,
        "times_s": _listed(times_s[shown]),
        "at": _listed(places[shown]),
    }


def tension_figures(recording: Recording) -> dict[str, Any] | None:
    """Return the fibre's tension in the simulated run, N: means over intervals, least and most.

    None if the machine has no spool, or the job has no product.
    """
    channel = recording.find(ChannelKind.TENSION)
    if channel is None:
        return None
    period_s = float(channel.clock.period_s) * channel.stride
    values = np.concatenate([np.zeros(0), *(block.samples[channel.name] for block in recording)])
    if not len(values):
        return None
    begins = np.arange(0, len(values), max(1, -(-len(values) // MOST_POINTS)))
    counts = np.diff(begins, append=len(values))
    return {
        "times_s": _listed(period_s * begins.astype(np.float64)),
        "mean": _listed(np.add.reduceat(values, begins) / counts),
        "least": round(float(values.min()), 4),
        "most": round(float(values.max()), 4),
    }


def _further_apart(places: FloatArray, least: float) -> NDArray[np.bool_]:
    """Return (n,) whether a turn is farther than ``least`` from the last kept one.

    Smaller turns come from rounded positions, and are no turns of the carriage.
    """
    is_kept = np.zeros(len(places), dtype=np.bool_)
    last_kept = -np.inf
    for k, place in enumerate(places.tolist()):
        is_kept[k] = abs(place - last_kept) > least
        last_kept = place if is_kept[k] else last_kept
    return is_kept


def _stitches(
    job: Job, operations_begun: _Operations | None, uses: tuple[str, FloatArray] | None
) -> dict[str, Any] | None:
    """Return the holes of a seam or a design in order; None for a job without stitches.

    Parameters
    ----------
    begun
        Instants at which the operations begin; None before the job is planned.
    uses
        Name of the limit, and the (s,) share of it that each stitch uses.
    """
    places, entering_rows, blocks, operations = [], [], [], []
    first = 0
    for item in move_runs(job):
        if not isinstance(item, MoveRun):
            first += 1
            continue
        block = item.columns.get("block")
        places.append(item.targets[:, :2])
        entering_rows.append(entering(item))
        blocks.append(np.zeros(len(item)) if block is None else np.where(lacking(block), 0, block))
        operations.append(first + np.arange(len(item)))
        first += len(item)
        if first > _MOST_READ:
            break
    is_sewn = np.concatenate(entering_rows) if entering_rows else np.zeros(0, bool)
    if not is_sewn.any():
        return None
    operation, place = np.concatenate(operations), np.concatenate(places)
    holes = np.flatnonzero(is_sewn)
    shown_numbers = np.arange(len(holes))[:: max(1, -(-len(holes) // MOST_POINTS))]
    shown = holes[shown_numbers]
    is_joined = np.append(False, is_sewn[holes[1:] - 1])  # no travel since the previous hole
    thread = np.concatenate(blocks).astype(np.int64)[shown]
    share = None if uses is None or len(uses[1]) != len(holes) else uses[1][shown_numbers]
    return {
        "x": _listed(place[shown, 0]),
        "y": _listed(place[shown, 1] if place.shape[1] > 1 else np.zeros(len(shown))),
        "joined": is_joined[shown_numbers].tolist(),
        "block": thread.tolist(),
        "threads": [None if one is None else one.rgb for one in job.threads],
        "number": (shown_numbers + 1).tolist(),
        "count": len(holes),
        "times_s": []
        if operations_begun is None
        else _listed(operations_begun.ends_s(operation[shown])),
        "use": [] if share is None else [round(float(u), 4) for u in np.nan_to_num(share)],
        "use_of": "" if uses is None or share is None else uses[0],
    }


def _uses(proof: Proof) -> tuple[str, FloatArray] | None:
    """Return the name of a limit, and the (s,) share of it that each stitch of a proof uses."""
    job = proof.plan.job
    limits = {(r.name, r.axis): r.limit for r in proof.verdict.results if r.limit}
    if has_stitches(job):
        limit = limits.get(("stitch_length_error", ""))
        if limit is None:
            return None
        criteria = [c for c in proof.spec.criteria if c.name == "stitch_length_error"]
        delay_s = float(criteria[0].options.get("delay", 0.0)) if criteria else 0.0
        shares = [
            np.where(run.stitches.exempt, 0.0, np.abs(run.length_error[:, 0]) / limit)
            for run in sewn_stitches(proof.plan, proof.recording, delay_s)
        ]
        return ("length error", np.concatenate(shares)) if shares else None
    if not job.threads:
        return None
    limits_by_axis = [limits.get(("stitch_residual", axis)) for axis in proof.plan.axes]
    if not all(limits_by_axis):
        return None
    residual = StitchRun(proof.recording, proof.plan).sewn.residual_m
    return "swing at the needle", np.nanmax(residual / np.array(limits_by_axis, np.float64), axis=1)


# --- a job before it is calculated ---------------------------------------------------------------


def preview(folder: Path, program: str, machine: Machine) -> dict[str, Any]:
    """Return the programmed path of a job, with its lines and stitches for the page.

    Raises
    ------
    InputError
        If the program cannot be read.
    """
    with reading_within(folder):
        path = program_path(folder, program)
        job = open_job(path, machine, options_of())
        positions, lines, moves, whole = _programmed(job)
        source = next((item.source.file for item in job if isinstance(item, Move)), str(path))
        text = _text(path.with_name(Path(source).name))
        stitches, steps = _stitches(job, None, None), _steps(job, _NOT_BEGUN)
    stride = max(1, -(-len(positions) // MOST_POINTS))
    return {
        "program": program,
        "planned": {name: _listed(positions[::stride, k]) for k, name in enumerate(job.axes)},
        "line": lines[::stride].tolist(),
        "moves": moves,
        "whole": whole,
        "paced_by": job.paced_by,
        "stitches": stitches,
        "steps": steps,
        "warnings": list(job.warnings),
        "mandrel": None if (found := mandrel_of(machine)) is None else found.model_dump(),
        "file": Path(source).name,
        "text": text,
    }


_NOT_BEGUN = _Operations(np.zeros(0, np.int64), np.zeros(0), 0.0)


def _programmed(job: Job) -> tuple[FloatArray, IntArray, int, bool]:
    """Return (n, axes) positions and (n,) lines of a job, the number of moves, and completeness.

    The last value is False if the job has more than ``_MOST_READ`` moves.
    """
    positions, lines, count = [np.array([job.start], np.float64)], [np.zeros(1, np.int64)], 0
    for item in move_runs(job):
        if not isinstance(item, MoveRun):
            continue
        positions.append(item.targets)
        lines.append(item.line)
        count += len(item)
        if count >= _MOST_READ:
            return np.concatenate(positions), np.concatenate(lines), count, False
    return np.concatenate(positions), np.concatenate(lines), count, True


def _text(path: Path) -> list[str]:
    """Return the lines of a file; none for a binary or a very long one."""
    if path.is_symlink() or not path.is_file():
        return []
    content = path.read_bytes()[: _MOST_TEXT + 1]
    if len(content) > _MOST_TEXT or b"\0" in content:
        return []
    try:
        return content.decode("utf-8").splitlines()
    except UnicodeDecodeError:
        return []


def _listed(values: FloatArray) -> list[float]:
    return [round(float(value), 6) for value in values]


def main() -> None:
    """Answer the request on standard input: its preview, or a line that says why there is none."""
    content: Mapping[str, Any] = json.loads(sys.stdin.read())
    try:
        machine = chosen_machine(str(content["machine"]), content["par"])
        found = preview(Path(content["folder"]), str(content["program"]), machine)
        sys.stdout.write(Preview.model_validate(found).model_dump_json())
    except (ThreadlineError, OSError) as error:
        sys.stdout.write(json.dumps({"error": str(error)}))
