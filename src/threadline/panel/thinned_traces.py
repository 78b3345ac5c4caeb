"""Traces thinned for plots, and files of recordings, in a separate process.

It imports little besides the reader of recordings, so that it begins at once.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import ThreadlineError
from threadline.files import Channel, ChannelKind, Recording
from threadline.files.formats import read_recording, write_recording

STRETCHES = 1000
"""Time intervals of a trace; each shows its smallest and its largest deviation."""
_ACTUAL = (ChannelKind.LOAD, ChannelKind.MEASURED)


def thinned(recording: Recording) -> dict[str, Any]:
    """Return commanded and actual positions of all axes, SI.

    All axes share the instants. In each time interval these are the instants of the smallest and
    the largest deviation of every axis, so that no peak is lost. The actual position is the load
    position, or else the encoder reading. If nothing is measured it is the command, and
    ``measured`` is False.
    """
    pairs = _pairs(recording)
    if not pairs:
        return {"times_s": [], "axes": {}}
    columns: dict[str, list[FloatArray]] = {c.name: [] for pair in pairs.values() for c in pair}
    for block in recording:
        for name, parts in columns.items():
            parts.append(block.samples[name])
    samples = {name: np.concatenate(parts) for name, parts in columns.items()}
    first = next(iter(pairs.values()))[0]
    positions = {name: (samples[c.name], samples[a.name]) for name, (c, a) in pairs.items()}
    count = min(len(column) for column in samples.values())
    shown = _shown_columns(np.stack([(a - c)[:count] for c, a in positions.values()]))
    period_s = float(first.clock.period_s) * first.stride
    return {
        "times_s": [round(float(k) * period_s, 6) for k in shown],
        "axes": {
            name: {
                "commanded": _rounded(c[shown]),
                "actual": _rounded(a[shown]),
                "measured": pairs[name][0] is not pairs[name][1],
            }
            for name, (c, a) in positions.items()
        },
    }


def _pairs(recording: Recording) -> dict[str, tuple[Channel, Channel]]:
    """Return the channels of commanded and actual position, by axis."""
    by_axis: dict[str, tuple[Channel, Channel]] = {}
    for channel in recording.channels:
        if channel.kind is ChannelKind.COMMANDED and channel.axis:
            actual = [
                other
                for kind in _ACTUAL
                for other in recording.channels
                if (other.kind, other.axis) == (kind, channel.axis)
                and (other.clock.period_s, other.stride) == (channel.clock.period_s, channel.stride)
            ]
            by_axis[channel.axis] = (channel, actual[0] if actual else channel)
    return by_axis


def _shown_columns(deviations: FloatArray) -> IntArray:
    """Return the shown columns of (axes, n) ``deviations``, in order."""
    count = deviations.shape[1]
    starts = np.unique(np.linspace(0, count, min(STRETCHES, count) + 1, dtype=np.int64)[:-1])
    shown = [
        begin + np.array([part.argmin(), part.argmax()])
        for row in deviations
        for begin, part in zip(starts, np.split(row, starts[1:]), strict=True)
    ]
    return np.unique(np.concatenate([*shown, [0, count - 1]]).astype(np.int64))


def _rounded(values: FloatArray) -> list[float]:
    return [round(float(value), 8) for value in values]


def main() -> None:
    """Write the trace named by the first argument into the file named by the second."""
    trace, out = Path(sys.argv[1]), Path(sys.argv[2])
    try:
        recording = read_recording(trace)
        if out.suffix == ".json":
            content: Mapping[str, Any] = thinned(recording)
            out.write_text(json.dumps(content, allow_nan=False), "utf-8")
        else:
            write_recording(recording, out)
    except (ThreadlineError, OSError) as error:
        sys.stdout.write(f"{error}\n")
