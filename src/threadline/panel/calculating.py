"""A calculation of the panel, in a separate process: plan, simulate, judge, write the proof.

It reads one request as JSON from standard input and writes JSON lines to standard output: the share
done, and at the end the figures, or why there are none.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.reading import noting_inputs, reading_within
from threadline.dynamics.plausibility import plausibility_warnings
from threadline.errors import ThreadlineError
from threadline.files import ChannelKind
from threadline.jobs.operations import Job, Move, MoveRun, Operation, Source, begins_circuit
from threadline.live.kinds_run import run_kind_of
from threadline.machine import Machine
from threadline.panel.job_views import plan_views
from threadline.panel.programs import PROGRAMMED, by_priority, planned, program_path, words_of
from threadline.panel.welcoming import mandrel_of
from threadline.proof.option_form import Door, Group
from threadline.proof.option_table import options_for
from threadline.proof.pipeline import (
    Proof,
    Trials,
    check_machine,
    open_job,
    prove_plan,
    with_shaping,
)
from threadline.proof.proof_file import read_proof, write_proof
from threadline.proof.recorded import warnings_of
from threadline.proof.request import chosen_machine, trials_of
from threadline.verdict import Spec, closing, load_spec
from threadline.verdict.rendering import criteria_json
from threadline.verdict.replayed import least_friction, recorded_fibre, wound_job

_SHOWN = 2000  # largest number of instants in a plot
_MOST_PLACES = 20_000  # largest number of places on the centre line of the bands of a winding
_OUTLINE = 241  # number of places on the meridian of a mandrel
_NICE = 10  # the executor gets processor time first


def machine_of(content: Mapping[str, Any]) -> Machine:
    """Return the machine of a request."""
    return chosen_machine(str(content["machine"]), content["par"])


def calculate(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of a program; write its proof into ``content["proof_file"]``.

    Raises
    ------
    InputError
        If the program cannot be read, planned or judged.
    """
    machine = machine_of(content)
    check_machine(machine)
    with noting_inputs():
        wanted = load_spec(None if content["spec"] is None else Path(content["spec"]), machine)
        folder = Path(content["folder"])
        words_of_level = [one.word for one in options_for("panel", Door.PANEL, [Group.LEVEL])]
        trials = trials_of(**{word: content[word] for word in words_of_level})
        with reading_within(folder):
            words = _by_priority(folder, content, machine, wanted, trials)
            plan, options = planned(folder, {**content, **words}, machine)
            spec = with_shaping(wanted, machine, options)
            proof = prove_plan(plan, spec, _share, trials)
        write_proof(proof, content["proof_file"])
    starts = run_kind_of(machine).start(plan.commands).tolist()
    return {
        **figures(proof),
        "program": str(content["program"]),
        "feed": {**content, **words}["feed"],
        "starts": starts,
        "words": words,
        "wound": wound(proof),
        "proof": read_proof(content["proof_file"]).content["sha256"],
    }


def _by_priority(
    folder: Path, content: Mapping[str, Any], machine: Machine, wanted: Spec, trials: Trials
) -> Mapping[str, Any]:
    if content["priority"] == PROGRAMMED:
        return {}
    path = program_path(folder, str(content["program"]))
    options = words_of(content, path)
    job = open_job(path, machine, options)
    spec = with_shaping(wanted, machine, options)
    return by_priority(str(content["priority"]), job, machine, spec, options, trials, _share)


def figures(proof: Proof) -> dict[str, Any]:
    """Return the figures of a proof that the operator sees, SI units."""
    plan, verdict = proof.plan, proof.verdict
    circuits, points = circuits_and_points(plan.job)
    ticks = plan.commands.tick_count()
    times_s, planned_at = _commanded(proof)
    suspicions = plausibility_warnings(plan.machine)
    return {
        "program": plan.job.name,
        "passed": verdict.passed,
        "closing": closing(verdict),
        "duration_s": plan.duration_s,
        "ticks": ticks,
        "circuits": circuits,
        "ticks_per_circuit": None if not circuits or ticks is None else round(ticks / circuits),
        "points": points,
        "warnings": [one for one in warnings_of(proof) if one not in suspicions],
        "doubts": suspicions,
        "criteria": criteria_json(verdict),
        "times_s": [round(float(t), 6) for t in times_s],
        "mandrel": None if (found := mandrel_of(plan.machine)) is None else found.model_dump(),
        "planned": {
            name: [round(float(p), 7) for p in positions] for name, positions in planned_at.items()
        },
        **plan_views(proof),
    }


def wound(proof: Proof) -> dict[str, Any] | None:
    """Return the mandrel of a proof's product with the fibre of the simulated run, for drawing.

    At most ``_MOST_PLACES`` places of the fibre are kept, at least half a band width apart.
    """
    job = wound_job(proof.plan)
    samples = None if job is None else recorded_fibre(proof.recording, job)
    if job is None or samples is None:
        return None
    turn, along = job.tool.turn, job.tool.along
    assert turn is not None and along is not None  # a machine with an eye has both axes
    surface, fibre = job.surface, samples.fibre
    u = np.linspace(0.0, surface.length_m, _OUTLINE)
    known_rows = np.flatnonzero(fibre.known)
    if not len(known_rows):
        return None
    length = np.maximum.accumulate(fibre.length_m[known_rows])
    step = max(0.5 * job.width_m, float(length[-1] - length[0]) / _MOST_PLACES)
    begins = np.diff(known_rows, prepend=-2) > 1
    drawn = np.flatnonzero(begins | (np.diff(np.floor(length / step), prepend=-1.0) > 0.0))
    steer = np.nan_to_num(np.abs(fibre.steer[known_rows]))
    slips = np.maximum.reduceat(steer, drawn) > least_friction(job.product)
    rows = known_rows[drawn]
    x, r = (values[:, 0] for values in surface.at(fibre.u[rows]))
    outline = surface.at(u)
    return {
        "mandrel": {
            "axis": turn.axis,
            "along": along.axis,
            "at": _rounded(outline[0][:, 0] + job.at_m),
            "radius": _rounded(outline[1][:, 0]),
        },
        "width": job.width_m,
        "times_s": _rounded(samples.time_s[rows]),
        "along": _rounded(x + job.at_m),
        "radius": _rounded(r),
        "angle": _rounded(fibre.angle[rows]),
        "winding": _rounded(fibre.winding[rows]),
        "begins": begins[drawn].tolist(),
        "slips": slips.tolist(),
    }


def _rounded(values: FloatArray) -> list[float]:
    return [round(float(value), 6) for value in values]


def circuits_and_points(job: Job) -> tuple[int | None, int]:
    """Return the number of passes of outermost subroutine calls, and the number of moves.

    The number of passes is None if there are fewer than two.
    """
    circuits, points, least_times = 0, 0, 0
    previous_source: Source | None = None
    for item, times, _ in job.folded():
        if times == 0:  # the end of repeated passes
            continue
        first, last = _end_sources(item)
        if begins_circuit(previous_source, first):
            # The moves of a pass that are in no inner call happen least often.
            circuits, least_times = circuits + least_times, times
        elif first.passes:
            least_times = min(least_times, times)
        previous_source = last
        if isinstance(item, MoveRun | Move):
            points += times * (len(item) if isinstance(item, MoveRun) else 1)
    circuits += least_times
    return (circuits if circuits > 1 else None), points


def _end_sources(item: Operation | MoveRun) -> tuple[Source, Source]:
    """Return the sources of a run's first and last move; for an operation, its source twice."""
    if not isinstance(item, MoveRun):
        return item.source, item.source
    first, last = (Source(item.file, int(item.line[k]), item.passes) for k in (0, -1))
    return first, last


def _commanded(proof: Proof) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return at most ``_SHOWN`` instants, and the commanded position of every axis at them."""
    recording = proof.recording
    channels = {c.axis: c for c in recording.channels if c.kind is ChannelKind.COMMANDED}
    if not channels:
        return np.empty(0), {}
    parts: dict[str, list[FloatArray]] = {name: [] for name in channels}
    for block in recording:
        for name, channel in channels.items():
            parts[name].append(block.samples[channel.name])
    positions = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    clock = next(iter(channels.values())).clock
    stride = -(-len(next(iter(positions.values()))) // _SHOWN)
    times_s = float(clock.period_s) * np.arange(
        len(next(iter(positions.values()))), dtype=np.float64
    )
    return times_s[::stride], {name: values[::stride] for name, values in positions.items()}


def _share(_what: str, share: float) -> None:
    if share:  # a stage without a share must not set the bar back to 0
        _print({"share": round(share, 3)})


def _print(content: Mapping[str, Any]) -> None:
    sys.stdout.write(json.dumps(content, allow_nan=False) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Answer the request on standard input."""
    os.nice(_NICE)
    try:
        _print({"figures": calculate(json.loads(sys.stdin.read()))})
    except (ThreadlineError, OSError) as error:
        _print({"error": str(error)})
