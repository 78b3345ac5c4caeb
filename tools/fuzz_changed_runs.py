"""A recording changed in one way, and limits about what was measured: for ``fuzz_every_kind.py``.

``RECORDED`` leaves every value as it was; ``LIMITS`` must turn the verdict, or must not.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from tests.verdict.interpreter import Facts
from tools.fuzz_recordings import MAKERS
from tools.fuzz_runs import Seed, plan_measured_once, seed_of
from tools.fuzz_same_programs import Key, Outcomes, same_verdicts
from tools.fuzz_same_recordings import (
    Kept,
    Samples,
    at_twice_the_rate,
    hold_against,
    noisy,
    recording_of,
    renamed,
    spec_about,
    values_of,
)
from tools.fuzz_works import Written

import threadline as tl
from threadline.commands.turns import Stitched
from threadline.errors import Place
from threadline.face.answers import Proved
from threadline.files import Recording, Stream
from threadline.files.formats import read_recording, write_recording
from threadline.files.formats.common import in_si
from threadline.proof.options import Options
from threadline.units import unit_factor
from threadline.verdict import Judge, Status, Verdict, judge, load_spec

SIDE = 32
"""Runs that lie side by side in a recording, each with a noise of its own."""
_UNITS = {
    "m": ("mm", "in", "um"), "rad": ("deg", "mrad"), "V": ("mV",), "A": ("mA",), "m/s": ("mm/s",),
    "rad/s": ("deg/s",),
}  # fmt: skip
_FORMATS = ("npz", "npz", "npz", "npz", "mcap", "mcap", "mcap", "csv")  # slow ones seldom
OF_MACHINE = "limits: one of the machine a thousandth aside"
_TOO_SHORT = "the recording goes on for"
"""A criterion that the end of a recording leaves open is not passed."""
_AXIS_LIMITS, _STEP_RATE = ("velocity", "acceleration", "jerk"), "step_rate"


@dataclass(frozen=True)
class Base:
    """A recording before it is changed.

    Attributes
    ----------
    outcomes
        The verdict of the proof.
    judged
        The verdict on the recording, as one of a machine.
    """

    kept: Kept
    outcomes: Outcomes
    judged: Outcomes


def bases_of(proof: Proved, rng: random.Random, file: Path) -> dict[str, Base]:
    """Return the run of a proof as it was, and with a fault in one channel for a while."""
    plan = proof.plan
    places = np.zeros((1, 2)) if isinstance(plan.intent, Stitched) else None
    switched = bool(plan.machine.cylinders)
    facts = Facts(list(plan.axes), set(), switched, 0.0, 0.0, places=places)
    seed = seed_of(proof.of, file, Options(), facts)
    channels = MAKERS["judge-axes"](rng, seed)
    faulty = {name: one.chunks[0][1] for name, one in channels.items()}
    outcome = outcomes_of(proof.verdict)
    return {name: _base(seed, samples, outcome)
            for name, samples in (("sound", seed.samples), ("faulty", faulty))}  # fmt: skip


def _base(seed: Seed, samples: Samples, outcome: Outcomes) -> Base:
    recording = recording_of(seed, samples)
    measured = values_of(seed, recording, seed.proof.spec)
    judged = judge([recording], seed.proof.plan, seed.proof.spec)
    return Base(Kept(seed, samples, measured, SIDE), outcome, outcomes_of(judged))


def outcomes_of(verdict: Verdict) -> Outcomes:
    """Return value, status and limit of each criterion."""
    return {
        (r.name, r.axis, r.step): (r.measured, r.status.value, r.limit) for r in verdict.results
    }


RunCheck = Callable[[random.Random, Base, Written | None], int]
"""Changes a recording, or limits, and judges; with the job as it is written, by the face."""

# --- changes of a recording ---


def _noisy(rng: random.Random, base: Base, edges: tuple[int, ...] = ()) -> Recording:
    """Return runs side by side, each but the first with a noise of its own."""
    kept = base.kept
    return recording_of(kept.seed, noisy(rng, kept), edges, kept.runs)


def _held(
    rng: random.Random, base: Base, recording: Recording, how: str, *, twice: bool = False
) -> int:
    hold_against(base.kept, recording, spec_about(rng, base.kept), twice, how)
    return recording.runs


def _noise(rng: random.Random, base: Base, _: Written | None) -> int:
    return _held(rng, base, _noisy(rng, base), "noise")


def _twice(rng: random.Random, base: Base, _: Written | None) -> int:
    return _held(rng, base, at_twice_the_rate(_noisy(rng, base)), "twice the samples", twice=True)


def _order(rng: random.Random, base: Base, _: Written | None) -> int:
    recording = _noisy(rng, base)
    channels = rng.sample(recording.channels, len(recording.channels))
    changed = replace(recording, channels=tuple(channels))
    return _held(rng, base, changed, f"order {[c.name for c in channels]}")


def _names(rng: random.Random, base: Base, _: Written | None) -> int:
    return _held(rng, base, renamed(_noisy(rng, base), "another"), "other names")


def _blocks(rng: random.Random, base: Base, _: Written | None) -> int:
    count = len(next(iter(base.kept.samples.values())))
    edges = tuple(sorted(rng.sample(range(1, count), rng.choice((1, 2, 5, 30)))))
    return _held(rng, base, _noisy(rng, base, edges), f"blocks {edges}")


def _units(rng: random.Random, base: Base, _: Written | None) -> int:
    recording = _noisy(rng, base)
    units = {
        c.name: rng.choice(_UNITS[c.unit])
        for c in recording.channels
        if c.unit in _UNITS and rng.random() < 0.6
    }
    channels = tuple(replace(c, unit=units.get(c.name, c.unit)) for c in recording.channels)
    (block,) = recording
    factors = {c.name: unit_factor(units[c.name], c.unit)
               for c in recording.channels if c.name in units}  # fmt: skip
    samples = {n: v / factors[n] if n in factors else v for n, v in block.samples.items()}
    blocks = Stream.of([replace(block, samples=samples)])
    changed = replace(recording, channels=channels, blocks=blocks)
    return _held(rng, base, changed, f"units {units}")


def _file(rng: random.Random, base: Base, written: Written | None) -> int:
    """Read a recording from a file; with the job, the face plans it again and judges."""
    seed = base.kept.seed
    seed.file.parent.mkdir(exist_ok=True)
    file = seed.file.with_name(f"run.{rng.choice(_FORMATS)}")
    write_recording(recording_of(seed, base.kept.samples), file)
    if written is None:
        return _held(rng, base, read_recording(file), f"in {file.name}")
    seed.file.write_bytes(written.data)
    same_verdicts(base.judged, outcomes_of(tl.judge(file).verdict), f"in {file.name}")
    return 1


JUDGED_BY_THE_FACE: tuple[RunCheck, ...] = (_file,)
RECORDED: dict[str, RunCheck] = {
    "recording: noise below the resolution": _noise,
    "recording: twice the samples": _twice,
    "recording: channels in another order": _order,
    "recording: other names of channels and clock": _names,
    "recording: other blocks": _blocks,
    "recording: in mm, inches, degrees, mA": _units,
    "recording: in a file": _file,
}

# --- limits ---


def _limited(base: Base, factors: Mapping[Key, float]) -> Verdict:
    """Judge by a specification in which each criterion has so many times its value as its limit."""
    seed = base.kept.seed
    named = {(c.name, c.axis, c.step): c for c in reversed(seed.proof.spec.criteria)}
    criteria = []
    for (name, axis, step), factor in factors.items():
        keys = ((name, axis, step), (name, axis, ""), (name, "", step), (name, "", ""))
        own = next((named[key] for key in keys if key in named), None)
        if own is None:
            continue
        value = base.kept.measured[name, axis, step]
        limit = value + (factor - 1.0) * abs(value)
        criteria.append(replace(own, axis=axis, step=step, limit=limit, hard=False, required=True))
    spec = replace(seed.proof.spec, criteria=tuple(criteria))
    with plan_measured_once(seed.proof.plan):
        recording = in_si(recording_of(seed, base.kept.samples), Place("case"))
        return Judge(seed.proof.plan, spec).verdict([recording])


def _limitable(base: Base) -> list[Key]:
    measured = base.kept.measured.items()
    return [key for key, value in measured if np.isfinite(value) and abs(value) > 1e-9]


def _below(rng: random.Random, base: Base, _: Written | None) -> int:
    """One limit lies a thousandth below what was measured, the others a thousandth above."""
    keys = _limitable(base)
    chosen = rng.choice(keys)
    verdict = _limited(base, {key: 0.999 if key == chosen else 1.001 for key in keys})
    failed = [(r.name, r.axis, r.step) for r in verdict.results if r.status is Status.FAILED]
    line = f"{failed} failed, and the limit of {chosen} was below {base.kept.measured[chosen]}"
    assert failed == [chosen], line
    assert not verdict.passed, line
    return 1


def _above(rng: random.Random, base: Base, _: Written | None) -> int:
    """Every limit lies a thousandth above what was measured, or less."""
    factor = 1.0 + 10.0 ** rng.uniform(-6.0, -3.0)
    verdict = _limited(base, dict.fromkeys(_limitable(base), factor))
    wrong = [
        r for r in verdict.results if r.status is not Status.PASSED and _TOO_SHORT not in r.note
    ]
    assert not wrong, f"limits {factor} times what was measured: {wrong}"
    assert verdict.passed or any(_TOO_SHORT in r.note for r in verdict.results)
    return 1


def _of_machine(rng: random.Random, base: Base, _: Written | None) -> int:
    """A limit of the machine lies a thousandth below, or above, what the plan asks of it."""
    kept = base.kept
    plan, machine = kept.seed.proof.plan, kept.seed.proof.plan.machine
    factor = rng.choice((0.998, 1.001))  # a thousandth is allowed for rounding
    # A plan as controllers of its time made it may exceed some; an axis may rest.
    measured = kept.measured
    limited = [
        (name, axis)
        for name, axis, step in measured
        if name in (*_AXIS_LIMITS, _STEP_RATE)
        and base.outcomes[name, axis, step][2] is not None
        and measured[name, axis, step] > 1e-9
    ]
    name, axis = rng.choice(limited)
    asked = factor * measured[name, axis, ""]
    if machine.tables is not None:
        rate = replace(machine.tables.step_rate, si=asked)
        machine = replace(machine, tables=replace(machine.tables, step_rate=rate))
    else:
        own = machine.axes[axis]
        limit = replace(getattr(own, name), si=asked)
        machine = replace(machine, axes={**machine.axes, axis: replace(own, **{name: limit})})
    spec = replace(load_spec(None, machine), lag_s=kept.seed.proof.spec.lag_s)
    with plan_measured_once(plan):  # what is measured of a plan does not hang on limits
        verdict = Judge(replace(plan, machine=machine), spec).verdict(
            [recording_of(kept.seed, kept.samples)]
        )
    found = {(r.name, r.axis): r.status for r in verdict.results}[name, axis]
    wanted = Status.FAILED if factor < 1.0 else Status.PASSED
    assert found is wanted, f"{name} {axis} of {factor} times its limit {found.value}"
    return 1


LIMITS: dict[str, RunCheck] = {
    "limits: one a thousandth below": _below,
    "limits: all a thousandth above at most": _above,
    OF_MACHINE: _of_machine,
}
