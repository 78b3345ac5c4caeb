"""A job as it is read, without a simulation: its path, stitches or switchings; and a machine.

Proving a job takes tens of milliseconds; most changed jobs are only read. What is read of the
changed one must be that of the one before, number by number.
"""

from __future__ import annotations

import dataclasses
import math
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tools.fuzz_works import Written

from threadline.files import SwitchSchedule
from threadline.jobs import Job
from threadline.jobs.moves import STEP_EVENT
from threadline.jobs.operations import Dwell, Move, MoveRun, SetOutput, ToolEvent, WaitInput
from threadline.machine import Machine
from threadline.motion.path import programmed_path
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job

Arrays = dict[str, np.ndarray]

_WHATEVER = {"sha256", "file", "reference", "note", "unit", "title", "sources", "guide", "design"}
_SAME = 1e-9


def read(file: Path, machine: Machine, written: Written) -> Arrays:
    """Return what a job asks for: by the axes of before, and where these were."""
    options = Options(dialect=written.words.get("dialect"), offset=written.words.get("offset"))
    if machine.cylinders and written.switched:
        return _switchings(file, machine, written)
    job = open_job(file, machine, options)
    if machine.cylinders:
        return _listed(job, written)
    if machine.tables is not None:
        runs = [run for run in job.runs() if isinstance(run, MoveRun)]
        stitch = np.concatenate([run.columns["stitch"] for run in runs])
        places = np.concatenate([run.targets for run in runs])[stitch > 0]
        return _as_before(written, job.axes, places) | {"way": np.arange(len(places)) * 1.0}
    path = programmed_path(job, machine)
    blocks = list(path)
    places = np.concatenate([b.positions for b in blocks])
    ways = np.diff(places, axis=0, prepend=places[:1])
    times = np.cumsum(np.concatenate([b.nominal_s + b.dwell_s for b in blocks]))
    if written.from_start:  # the way from where the machine stands is another one
        places, ways, times = places[1:], ways[1:], times[1:] - times[1]
        ways[0] = 0.0
    found = _as_before(written, path.axes, places)
    return found | {"way": np.cumsum(np.linalg.norm(ways, axis=1)), "time": times}


def _as_before(written: Written, axes: tuple[str, ...], places: np.ndarray) -> Arrays:
    names = (written.names.get(axis, axis) for axis in axes)
    return {
        name: (places[:, k] - written.by.get(name, 0.0)) * written.signs.get(name, 1)
        for k, name in enumerate(names)
    }


def _listed(job: Job, written: Written) -> Arrays:
    """Return what a move list says, operation by operation, without the lines."""
    rows: list[tuple[float, ...]] = []
    row: tuple[float, ...]
    for one in job:
        match one:
            case ToolEvent(name=name):
                step = name.removeprefix(STEP_EVENT)
                row = (0.0, _number_of(written.names.get(step, step)), 0.0)
            case SetOutput(name=name, value=value):
                row = (1.0, _number_of(name), float(value))
            case WaitInput(name=name, value=value, timeout_s=timeout_s):
                row = (2.0, _number_of(name), timeout_s if value else -timeout_s)
            case Dwell(duration_s=duration_s):
                row = (3.0, duration_s, 0.0)
            case Move(target=target):
                row = (4.0, *target)
            case _:
                raise AssertionError(f"a move list here has no {one}")
        rows.append(row)
    return {"operations": np.array(rows)}


def _number_of(name: str) -> float:
    return float(zlib.crc32(name.encode()))


def _switchings(file: Path, machine: Machine, written: Written) -> Arrays:
    shaper = written.words.get("shaper")
    options = Options(shaper=None if shaper == "none" else shaper)
    commands = plan_job(open_job(file, machine, options), machine, options).commands
    assert isinstance(commands, SwitchSchedule)
    waits = [(one.tick, int(one.value or 0)) for one in commands.events if one.kind == "wait"]
    levels = {name: commands.levels[:, k].astype(float) for k, name in enumerate(commands.outputs)}
    ticks = np.append(commands.ticks, commands.duration_ticks).astype(float)
    return levels | {"ticks": ticks, "waits": np.array(waits, dtype=float).ravel()}


def hold_read(before: Arrays, after: Arrays, said: str) -> None:
    """Refuse a job that is read otherwise; a vertex more on the same way does not matter.

    Raises
    ------
    AssertionError
        If they differ.
    """
    assert before.keys() == after.keys(), f"read {sorted(before)} and {sorted(after)}: {said}"
    for name, values in before.items():
        there = after[name]
        if "way" in before and len(after["way"]) != len(before["way"]):
            there = np.interp(before["way"], after["way"], there)
        assert values.shape == there.shape, f"{name} is {there} and was {values}: {said}"
        same = np.abs(values - there).max(initial=0.0) < _SAME
        assert same, f"{name} is {there.tolist()} and was {values.tolist()}: {said}"


# --- machines ---


def numbers_of(machine: Machine) -> dict[str, Any]:
    """Return every number, word and switch of a machine by where it stands, but of redesigns."""
    return dict(_numbers(machine))


def _numbers(of: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    if dataclasses.is_dataclass(of) and not isinstance(of, type):
        names = (field.name for field in dataclasses.fields(of))
        of = {name: getattr(of, name) for name in names if name not in _WHATEVER}
    if isinstance(of, Mapping):
        for key, value in of.items():
            yield from _numbers(value, f"{at}.{key}")
    elif isinstance(of, list | tuple):
        for place, value in enumerate(of):
            yield from _numbers(value, f"{at}.{place}")
    else:
        yield at, of


def _alike(one: Any, two: Any) -> bool:
    if isinstance(one, float) and isinstance(two, float):
        return math.isclose(one, two, rel_tol=1e-12) or (math.isnan(one) and math.isnan(two))
    return bool(one == two)


def hold_machines(
    before: Mapping[str, Any], after: Mapping[str, Any], names: Mapping[str, str] | None = None
) -> None:
    """Refuse a machine with another number than before.

    Parameters
    ----------
    names
        Parts of before by their names now.

    Raises
    ------
    AssertionError
        If a number differs.
    """
    if names:
        after = {
            ".".join(names.get(word, word) for word in key.split(".")): (
                names.get(value, value) if isinstance(value, str) else value
            )
            for key, value in after.items()
        }
    differ = [key for key in before.keys() | after.keys()
              if not _alike(before.get(key), after.get(key))]  # fmt: skip
    assert not differ, "; ".join(f"{k}: {before.get(k)} {after.get(k)}" for k in differ[:5])
