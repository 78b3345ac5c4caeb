"""Hostile recordings and specifications: what the judge passes, a second reading must let pass.

Three classes. ``judge-channels``: channels taken away, with units that differ. ``judge-blocks``:
blocks cut out, shortened, overlapped, reordered or moved. ``judge-axes``: specifications that name
single axes, or give shares without a unit. A fault is often put into the run first, so that hiding
it would be a false proof. What must come of a case is worked out by
``tests/verdict/interpreter.py``, which shares no code with the judge.

The runs are short, and what a plan is made of is held in memory, so that a judge is hundreds of
cases a second. Of most cases the recording is not written to a file and read again, and what the
measures say of the plan alone is taken from the case before; every ``_WHOLE``th goes the whole way.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from tests.verdict.interpreter import Channel, asked, cannot_pass, refused
from tools.fuzz_runs import Seed, plan_measured_once, seeds

from threadline.errors import Place
from threadline.files import Recording, RecordingBlock, Stream, SwitchSchedule
from threadline.files.formats import read_recording, write_recording
from threadline.files.formats.common import in_si
from threadline.verdict import judge, load_spec, verdict_json

CLASSES = ("judge-channels", "judge-blocks", "judge-axes")
_WHOLE = 16
_LIMITS = {
    "contour_error": ("0.5 mm", "5 mm"),
    "progress_error": ("0.5 mm", "5 mm"),
    "turning_point_error": ("0.5 mm", "5 mm"),
    "stitch_length_error": ("5 %", "0.5"),
    "dac_saturation": ("0 %", "1 %", "0.5"),
    "current_peak": ("1 A", "30 A"),
    "settling_time": ("100 ms", "2 s"),
    "velocity_ripple": ("5 %", "300 %"),
    "stitch_speed_error": ("5 %", "0.5"),
    "stitches_to_speed": ("2 stitch", "9 stitch"),
    "stitches_from_needle": ("2 stitch", "9 stitch"),
    "stitch_placement_error": ("0.5 mm", "5 mm"),
    "needle_time_error": ("5 %",),
    "seam_error": ("0.5 mm", "5 mm"),
}
_STITCHED = {
    "stitch_residual": ("0.1 mm", "1 mm"),
    "servo_force": ("50 %", "100 %"),
    "window_use": ("100 %",),
    "fetch_use": ("100 %",),
    "step_rate": ("200 kHz",),
    "travel": ("1 mm",),
}
_OF_TOOL = {
    "settling_time", "cycle_time", "switching_dwell", "contour_error", "progress_error",
    "stitch_length_error", "velocity_ripple", "stitch_speed_error", "stitches_to_speed",
    "stitches_from_needle",
    "stitch_placement_error", "needle_time_error", "seam_error", "window_use", "fetch_use",
}  # fmt: skip
_OF_AXIS = {
    "tracking_error": ("1", "30"),
    "velocity": ("20", "900", "2500"),
    "acceleration": ("1", "200"),
}
_UNITS_OF_AXIS = {
    "tracking_error": ("mm", "deg"),
    "velocity": ("mm/s", "deg/s"),
    "acceleration": ("m/s^2", "rad/s^2"),
}
_SHARES = ("stitch_length_error", "dac_saturation", "velocity_ripple")
_SWITCHED = {
    "residual_vibration": ("0.1 mm", "1 mm"),
    "settling_time": ("500 ms",),
    "end_position_error": ("0.5 mm",),
    "cycle_time": ("20 s",),
    "switching_dwell": ("50 ms",),
    "travel": ("1 mm",),
}


def _with_fault(rng: random.Random, seed: Seed) -> dict[str, np.ndarray]:
    """Return the samples, often with something wrong for a while in one channel."""
    samples = {name: values.copy() for name, values in seed.samples.items()}
    if rng.random() < 0.7:
        kind = rng.choice(("load", "voltage", "current", "frame", "commanded", "torque_share"))
        names = [n for n in samples if n.endswith(f".{kind}")]
        if names:
            values = samples[rng.choice(names)]
            begin = rng.randrange(len(values))
            end = begin + rng.choice((1, 10, 60))
            size = {"voltage": 20.0, "current": 100.0, "torque_share": 3.0}.get(
                kind, rng.choice((2e-3, 2e-2))
            )
            values[begin:end] += size
    return samples


def _described(seed: Seed, samples: dict[str, np.ndarray]) -> dict[str, Channel]:
    return {
        c.name: Channel(c.kind.value, c.axis, c.unit, seed.period_s, [(0, samples[c.name])])
        for c in seed.proof.recording.channels
        if c.name in samples
    }


def _other_units(rng: random.Random, channels: dict[str, Channel]) -> None:
    known = {"m": ("mm", 1e3), "rad": ("deg", 180 / np.pi), "V": ("mV", 1e3), "A": ("mA", 1e3)}
    for channel in channels.values():
        if channel.unit in known and rng.random() < 0.3:
            unit, factor = known[channel.unit]
            channel.chunks = [(f, v * factor) for f, v in channel.chunks]
            channel.unit = unit
        elif rng.random() < 0.005:
            channel.unit = rng.choice(("V", "mm", "deg", "", "A"))


def channels_taken_away(rng: random.Random, seed: Seed) -> dict[str, Channel]:
    """Take away channels, one or many, and give others in other units."""
    samples = _with_fault(rng, seed)
    share = rng.choice((0.05, 0.3, 0.8))
    commands = seed.proof.plan.commands
    outputs = set(commands.outputs if isinstance(commands, SwitchSchedule) else ())
    kept = {n: v for n, v in samples.items() if n in outputs or rng.random() > share}
    channels = _described(seed, kept or samples)
    _other_units(rng, channels)
    return channels


def blocks_moved(rng: random.Random, seed: Seed) -> dict[str, Channel]:
    """Cut the run into blocks; lose, shorten, overlap, swap or move some of them."""
    samples = _with_fault(rng, seed)
    channels = _described(seed, samples)
    count = len(next(iter(samples.values())))
    edges = sorted({0, count, *(rng.randrange(count) for _ in range(rng.choice((1, 3, 8))))})
    spans = [(a, a, b) for a, b in pairwise(edges)]  # first tick, rows
    kind = rng.randrange(7)
    at = rng.randrange(len(spans))
    lost: set[str] = set()
    if kind == 0:
        del spans[at]
    elif kind == 1:
        first, a, b = spans[at]
        spans[at] = (first, a, max(a, b - rng.choice((1, 5, 40))))
    elif kind == 2:
        shift = rng.choice((-1, -20, 1, 20, -(10**6)))
        spans = [(f + shift if i >= at else f, a, b) for i, (f, a, b) in enumerate(spans)]
    elif kind == 3 and len(spans) > 1:
        other = rng.randrange(len(spans))
        spans[at], spans[other] = spans[other], spans[at]
    elif kind == 4:
        lost = set(rng.sample(sorted(channels), rng.choice((1, 2, len(channels) // 2))))
    elif kind == 5:
        spans.append(spans[at])
    for name, channel in channels.items():
        values = samples[name]
        channel.chunks = [
            (first, values[a:b] if name not in lost or i != at else values[:0])
            for i, (first, a, b) in enumerate(spans)
        ]
    return channels


def whole_run(rng: random.Random, seed: Seed) -> dict[str, Channel]:
    """Change nothing but for the fault."""
    return _described(seed, _with_fault(rng, seed))


def spec_of(rng: random.Random, seed: Seed) -> str:
    """Return a specification of a few criteria, most of them of one axis."""
    rows, named = [], set()
    facts = seed.facts
    for _ in range(rng.randint(1, 6)):
        table = _SWITCHED if facts.switched else {**_LIMITS, **_OF_AXIS}
        table = table if facts.places is None else _STITCHED
        name = rng.choice(sorted(table))
        axis = "" if name in _OF_TOOL else rng.choice(list(facts.axes))
        if (name, axis) in named:
            continue
        named.add((name, axis))
        limit = rng.choice(table[name])
        if name in _OF_AXIS:
            limit += f" {_UNITS_OF_AXIS[name][axis in facts.rotary]}"
        rows.append("[[criteria]]")
        rows.append(f'name = "{name}"')
        rows += [f'axis = "{axis}"'] if axis else []
        if name in _SHARES and rng.random() < 0.1:
            rows.append("limit = 5")
        else:
            rows += [f'limit = "{limit}"'] if rng.random() < 0.9 else []
        rows += ["required = true"] if rng.random() < 0.5 else []
    return 'name = "fuzz"\n' + "\n".join(rows) + "\n"


def recording_of(seed: Seed, channels: dict[str, Channel]) -> Recording:
    """Return the channels as a recording; a block for each chunk."""
    recording = seed.proof.recording
    described = tuple(
        replace(c, unit=channels[c.name].unit) for c in recording.channels if c.name in channels
    )
    clock = described[0].clock.name
    chunks = {name: channel.chunks for name, channel in channels.items()}
    blocks = [
        RecordingBlock(
            first_tick={clock: next(iter(chunks.values()))[i][0]},
            samples={name: parts[i][1] for name, parts in chunks.items()},
        )
        for i in range(len(next(iter(chunks.values()))))
    ]
    return replace(recording, channels=described, blocks=Stream.of(blocks))


MAKERS: dict[str, Callable[[random.Random, Seed], dict[str, Channel]]] = {
    "judge-channels": channels_taken_away,
    "judge-blocks": blocks_moved,
    "judge-axes": whole_run,
}


def check(kind: str, path: Path) -> None:
    """Judge the case that ``path`` is the seed of, and hold it against the second reading.

    Raises
    ------
    AssertionError
        If what cannot pass has passed, or what had to be refused was not.
    """
    rng = random.Random(path.read_bytes())
    seed = rng.choices(seeds(), weights=(6, 2, 1, 2))[0]
    channels = MAKERS[kind](rng, seed)
    spec_file = path.with_name("case.spec.toml")
    spec_file.write_text(spec_of(rng, seed))
    spec = load_spec(spec_file, seed.proof.plan.machine)
    if "limit = 5\n" in spec_file.read_text():
        raise AssertionError(f"read, although a share of 5 has no unit\n{spec_file.read_text()}")
    recording = recording_of(seed, channels)
    must = refused(channels, seed.facts)
    if rng.randrange(_WHOLE) == 0:
        recorded = path.with_name("case.npz")
        write_recording(recording, recorded)
        verdict = judge([read_recording(recorded)], seed.proof.plan, spec)
    else:
        with plan_measured_once(seed.proof.plan):
            verdict = judge([in_si(recording, Place(path.name))], seed.proof.plan, spec)
    if must:
        raise AssertionError(f"judged, although {must}")
    content = json.loads(json.dumps(verdict_json(verdict, seed.proof.plan), allow_nan=False))
    text = spec_file.read_text()
    wrong = cannot_pass(channels, seed.facts, text)
    statuses: dict[tuple[str, str], list[str]] = {}
    for row in content["criteria"]:
        statuses.setdefault((row["name"], row["axis"]), []).append(row["status"])
    for (name, axis), why in wrong.items():
        found = statuses.get((name, axis), [])
        if found and all(status == "passed" for status in found):
            raise AssertionError(f"{name} {axis} passed, although {why}\n{text}")
    lacking = {
        (name, axis)
        for (name, axis), (_, required) in asked(text, seed.facts).items()
        if required and (name, axis) in wrong
    }
    if content["passed"] and lacking:
        raise AssertionError(f"in spec, although {lacking}: {wrong}\n{text}")


def fuzz_recordings() -> dict[str, tuple[str, Callable[..., bytes], Callable[[Path], None], int]]:
    """Return the readers of this module for the table of ``fuzz.py``."""
    return {kind: ("case.seed", case, partial(check, kind), 7) for kind in CLASSES}


def case(rng: random.Random) -> bytes:
    """Return the seed of a case; the runs are made before the first, and not while it is timed."""
    seeds()
    return rng.randbytes(16)
