"""Changes that must not matter to a verdict, and changes that must.

Three classes. ``same-recording``: a run with noise below any resolution, cut into other blocks, with
channels permuted or renamed, at twice the rate, written to a file and read again. ``same-program``:
comments, inches, other words for the same moves, a move split in two, a dwell of 0 where the machine
rests, a mirrored or a shifted path. ``same-machine``: other units, tables in another order, renamed
axes. The changed one must be judged as the one before, value by value; and a limit a thousandth
below what was measured must fail, while one a thousandth above it must pass.

The recordings are made once and judged many times. Changed samples lie side by side as runs of one
recording, so that a case holds ``RUNS`` of them. Of most programs and machines the path, or each
number, is compared; every ``_WHOLE``th is proved.
"""

from __future__ import annotations

import dataclasses
import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from tools.fuzz_recordings import MAKERS
from tools.fuzz_runs import Seed, plan_measured_once, seeds

from threadline.errors import Place
from threadline.signals import ChannelKind, Recording, RecordingBlock, Stream
from threadline.signals.files import read_recording, write_recording
from threadline.signals.files.channel_units import in_si
from threadline.verdict import Judge, Spec
from threadline.verdict.registry import MEASURES

RUNS = 8
_POOL = 6  # recordings of each machine: one as it ran, the others with a fault
_WHOLE = 16
_SAME = 1e-6  # of a value: what noise of the size of rounding may change
_NOISE = (-300.0, -12.0)  # decades
_BITS = (ChannelKind.INPUT, ChannelKind.OUTPUT, ChannelKind.OPERATION)
_NAMELESS = (ChannelKind.COMMANDED, ChannelKind.MEASURED, ChannelKind.LOAD, ChannelKind.FRAME)
"""Channels that are known by kind and axis, whatever their name."""
_FACTORS = (None, 0.999, 1.001, 0.5, 2.0)
_AT_TWICE_THE_RATE = (
    "contour_error", "turning_point_error", "tracking_error", "current_peak",
    "seam_error", "stitch_placement_error", "stitch_residual", "servo_force", "travel",
)  # fmt: skip
"""What a straight line between two samples leaves as it is."""

Key = tuple[str, str, str]
Samples = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Kept:
    """A recording that is judged many times, and what was measured in it."""

    seed: Seed
    samples: Samples
    measured: Mapping[Key, float]

    @property
    def runs(self) -> int:
        """How many runs its judge takes side by side."""
        alone = self.seed.facts.switched or self.seed.facts.places is not None
        return 1 if alone else RUNS


# --- recordings ---


@cache
def pool() -> tuple[Kept, ...]:
    """Return the recordings, some with a fault for a while in one channel."""
    found = []
    for number, seed in enumerate(seeds()):
        for k in range(_POOL):
            samples: Samples = seed.samples
            if k:
                channels = MAKERS["judge-axes"](random.Random(f"{number}/{k}"), seed)
                samples = {name: one.chunks[0][1] for name, one in channels.items()}
            known = _values(seed, recording_of(seed, samples), seed.proof.spec)
            found.append(Kept(seed, samples, known))
    return tuple(found)


def recording_of(
    seed: Seed, samples: Samples, edges: tuple[int, ...] = (), runs: int = 1
) -> Recording:
    """Return (n,) or (n, runs) samples as a recording, cut into blocks before the rows ``edges``."""
    told = seed.proof.recording
    channels = tuple(c for c in told.channels if c.name in samples)
    count = len(next(iter(samples.values())))
    ends = (0, *edges, count)
    blocks = [
        RecordingBlock(
            first_tick={channels[0].clock.name: a},
            samples={name: values[a:b] for name, values in samples.items()},
        )
        for a, b in zip(ends[:-1], ends[1:], strict=True)
    ]
    return replace(told, channels=channels, blocks=Stream.of(blocks), runs=runs)


def _rows(seed: Seed, recording: Recording, spec: Spec) -> list[tuple[Key, np.ndarray, np.ndarray]]:
    with plan_measured_once(seed.proof.plan):
        each = Judge(seed.proof.plan, spec).each(in_si(recording, Place("case")))
    return [((r.name, r.axis, r.step), r.values, r.failed) for r in each.rows]


def _values(seed: Seed, recording: Recording, spec: Spec) -> dict[Key, float]:
    return {key: float(values[0]) for key, values, _ in _rows(seed, recording, spec)}


def spec_about(rng: random.Random, kept: Kept) -> tuple[Spec, dict[Key, bool]]:
    """Return a specification with limits about what was measured, and whether each must fail."""
    criteria, must = [], {}
    named = {(c.name, c.axis, c.step): c for c in reversed(kept.seed.proof.spec.criteria)}
    for key, value in kept.measured.items():
        name, axis, step = key
        plain = named.get((name, "", ""))
        own = named.get(key, named.get((name, axis, ""), named.get((name, "", step), plain)))
        if own is None or (name, axis, step) in must:
            continue
        factor = rng.choice(_FACTORS)
        limited = factor is not None and math.isfinite(value) and value > 1e-9
        limit = factor * value if limited and factor is not None else None
        criteria.append(
            replace(own, axis=axis, step=step, limit=limit, hard=False, required=False)
        )
        must[key] = limit is not None and value > limit
    return replace(kept.seed.proof.spec, criteria=tuple(criteria)), must


def noisy(rng: random.Random, kept: Kept) -> dict[str, np.ndarray]:
    """Return the samples of all runs, side by side, with noise far below any resolution.

    Where there are several, the first is left as it was but for its commands.
    """
    kinds = {c.name: c.kind for c in kept.seed.proof.recording.channels}
    names = sorted(name for name in kept.samples if kinds[name] not in _BITS)
    chosen = rng.sample(names, rng.randint(1, len(names)))
    draw = np.random.default_rng(rng.getrandbits(64))
    found = dict(kept.samples)
    for name in names:
        runs = 1 if kinds[name] is ChannelKind.COMMANDED else kept.runs  # the same of all runs
        values = np.repeat(kept.samples[name][:, None], runs, axis=1)
        for run in range(min(1, runs - 1), runs if name in chosen else 0):
            size = 10.0 ** draw.uniform(*_NOISE)
            first = int(draw.integers(len(values))) if draw.random() < 0.5 else 0
            stop = first + int(draw.integers(1, 9)) if draw.random() < 0.3 else len(values)
            part = values[first:stop, run]
            part += size * draw.uniform(-1.0, 1.0, len(part))
        found[name] = values if runs > 1 else values[:, 0]
    return found


def told_otherwise(rng: random.Random, recording: Recording) -> Recording:
    """Return a recording with its channels in another order and by other names."""
    order = list(recording.channels)
    rng.shuffle(order)
    by = {c.name: f"{n} {c.name}" if c.kind in _NAMELESS else c.name for n, c in enumerate(order)}
    clock = replace(order[0].clock, name="another")
    blocks = [
        replace(
            block,
            first_tick={clock.name: next(iter(block.first_tick.values()))},
            samples={by[c.name]: block.samples[c.name] for c in order if c.name in block.samples},
        )
        for block in recording
    ]
    channels = tuple(replace(c, name=by[c.name], clock=clock) for c in order)
    return replace(recording, channels=channels, blocks=Stream.of(blocks))


def at_twice_the_rate(recording: Recording) -> Recording:
    """Return a recording with one more sample in the middle between every two."""
    (block,) = recording
    clock = replace(
        recording.channels[0].clock, period_s=recording.channels[0].clock.period_s / Fraction(2)
    )
    bits = {c.name for c in recording.channels if c.kind in _BITS}
    samples = {}
    for name, values in block.samples.items():
        twice = np.repeat(values, 2, axis=0)[:-1]
        if name not in bits:
            twice[1::2] = 0.5 * (values[:-1] + values[1:])
        samples[name] = twice
    channels = tuple(replace(c, clock=clock) for c in recording.channels)
    blocks = [RecordingBlock(first_tick={clock.name: 0}, samples=samples)]
    return replace(recording, channels=channels, blocks=Stream.of(blocks))


def check_recording(path: Path) -> None:
    """Judge a recording that was changed, and hold it against the one before.

    Raises
    ------
    AssertionError
        If a value or a status differs.
    """
    rng = random.Random(path.read_bytes())
    kept = rng.choice(pool())
    spec, must = spec_about(rng, kept)
    count = len(next(iter(kept.samples.values())))
    edges = tuple(sorted(rng.sample(range(1, count), rng.choice((0, 0, 1, 3, 30)))))
    whole = rng.randrange(_WHOLE) == 0
    twice = not whole and rng.random() < 0.2
    if whole:
        recording = recording_of(kept.seed, kept.samples)
        file = path.with_name(f"case.{rng.choice(('npz', 'csv', 'mcap'))}")
        write_recording(recording, file)
        recording = read_recording(file)
    else:
        runs = noisy(rng, kept)
        recording = recording_of(kept.seed, runs, () if twice else edges, kept.runs)
    if twice:
        recording = at_twice_the_rate(recording)
    if not whole and rng.random() < 0.5:
        recording = told_otherwise(rng, recording)
    rows = _rows(kept.seed, recording, spec)
    known = {key for key, _, _ in rows}
    assert known == set(must), f"criteria {known ^ set(must)} in one of the two alone"
    for key, values, failed in rows:
        if twice and key[0] not in _AT_TWICE_THE_RATE:
            continue
        off = values - kept.measured[key]
        small = _SAME * abs(kept.measured[key]) + 1e-10
        same = (np.abs(off) <= small) | (np.isnan(values) & np.isnan(kept.measured[key]))
        same |= values == kept.measured[key]
        where = f"{' '.join(key)} of {kept.seed.proof.plan.machine.name}"
        told = f"{values.tolist()}, before {kept.measured[key]!r}"
        assert same.all(), f"{where} is {told} (twice the rate: {twice}, file: {whole})"
        assert (failed == must[key]).all(), f"{where} failed {failed.tolist()}: {told}"
