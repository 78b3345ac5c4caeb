"""Commands, positions and volts of a recorded run; or the reason why it cannot be fitted."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import Place, RecordingError
from threadline.files import ChannelKind, Recording, Stream, TickBlock, TickTable
from threadline.files.recording import Channel
from threadline.machine import Machine
from threadline.machine.variants import SUPPLY_CUT, coasting

CUT_AT = "cut_at_si"
"""Key in a recording's origin of the position, m or rad, from which on a coast had no supply."""
_MOST_TICKS = 400_000
_LEAST_TICKS = 20
_LARGEST_VALUE = 1e9  # m, rad or V
_LEAST_MOTION = 20.0  # counts
_OFF_COUNTS = 0.02
_CLAMP_SHARE = 0.99  # of the clamp, from which on volts count as clamped: within a DAC level
_CLIPPED = 0.2  # share of samples with the controller at its clamp, from which a run is refused


def check_run(recording: Recording, machine: Machine, axis: str, place: Place) -> None:
    """Refuse a run that another machine made, or whose controller was mostly at its clamp.

    Raises
    ------
    RecordingError
        As ``columns_in``, ``commands_in`` and ``refuse_clipped``.
    """
    columns = columns_in(recording, machine, place)
    commands_in(columns, machine, recording.job_sha256, place)
    if (volts := columns.get((ChannelKind.VOLTAGE, axis))) is not None:
        refuse_clipped(machine, axis, volts, place)


def columns_in(
    recording: Recording, machine: Machine, place: Place
) -> dict[tuple[ChannelKind, str], FloatArray]:
    """Return the samples of commands, positions and volts, by kind and axis, in SI.

    Raises
    ------
    RecordingError
        If a channel has another unit than its axis or another tick than the machine, samples are
        missing or not finite, or there are too many.
    """
    kinds = (ChannelKind.COMMANDED, ChannelKind.MEASURED, ChannelKind.VOLTAGE)
    channels: list[Channel] = [
        c for c in recording.channels if c.kind in kinds and c.axis in machine.axes
    ]
    tick = machine.tick_clock.period_s
    for channel in channels:
        kind = "m" if machine.axes[channel.axis].kind == "linear" else "rad"
        if channel.kind is not ChannelKind.VOLTAGE and channel.unit != kind:
            raise RecordingError(
                f"{channel.name} is in {channel.unit}, but axis {channel.axis} of {machine.name} "
                f"is {machine.axes[channel.axis].kind}: {kind}",
                place=place,
                remedy="Give the machine file of the run, or correct the unit of the column.",
            )
        period = channel.clock.period_s * channel.stride
        if abs(float(period / tick) - 1.0) > 1e-6:
            raise RecordingError(
                f"{channel.name} has a sample each {float(period) * 1e3:g} ms, but the tick of "
                f"{machine.name} is {float(tick) * 1e3:g} ms",
                place=place,
                remedy="Record every tick.",
            )
    parts: dict[tuple[ChannelKind, str], list[FloatArray]] = {}
    expected_tick: int | None = None
    for block in recording:
        first = {block.first_tick[c.clock.name] for c in channels}
        if expected_tick is not None and first and first != {expected_tick}:
            raise RecordingError(
                f"samples are missing at {expected_tick * float(tick):.6g} s",
                place=place,
                remedy="Fit a run without gaps.",
            )
        for channel in channels:
            parts.setdefault((channel.kind, channel.axis), []).append(block.samples[channel.name])
        if channels:
            expected_tick = next(iter(first)) + len(block.samples[channels[0].name])
            if expected_tick > _MOST_TICKS:
                raise RecordingError(
                    f"more than {_MOST_TICKS} samples", place=place, remedy="Fit a shorter run."
                )
    columns = {key: np.concatenate(blocks) for key, blocks in parts.items()}
    for (kind, name), values in columns.items():
        odd_rows = np.flatnonzero(~(np.abs(values) < _LARGEST_VALUE))
        if len(odd_rows):
            raise RecordingError(
                f"{name}.{kind.value} is {values[odd_rows[0]]:g} at "
                f"{odd_rows[0] * float(tick):.6g} s, which "
                "no axis reaches",
                place=place,
                remedy="Record again, or cut the run there.",
            )
    return columns


def commands_in(
    columns: Mapping[tuple[ChannelKind, str], FloatArray],
    machine: Machine,
    job_sha256: str,
    place: Place,
) -> TickTable:
    """Return the recorded commands as a table of counts; an axis without any stands still.

    Raises
    ------
    RecordingError
        If there are none, too few, or they are not whole counts of the machine.
    """
    commanded = {name: columns.get((ChannelKind.COMMANDED, name)) for name in machine.axes}
    lengths = {
        len(position_column)
        for position_column in commanded.values()
        if position_column is not None
    }
    if not lengths:
        raise RecordingError(
            "the commanded position is missing",
            place=place,
            remedy="Record it: a column X.commanded [mm].",
        )
    (length,) = lengths
    if length < _LEAST_TICKS:
        raise RecordingError(
            f"{length} samples, fewer than {_LEAST_TICKS}", place=place, remedy="Record a move."
        )
    counts = np.zeros((length, len(machine.axes)), dtype=np.int64)
    for column, (name, axis) in enumerate(machine.axes.items()):
        position = commanded[name]
        if position is None:
            continue
        exact = position * axis.counts.si
        counts[:, column] = np.rint(exact)
        off_counts = float(np.abs(exact - counts[:, column]).max())
        if off_counts > _OFF_COUNTS:
            raise RecordingError(
                f"{name}.commanded lies up to {off_counts:.2g} counts beside whole counts of "
                f"{machine.name} ({axis.counts.si:.6g} {axis.counts.unit})",
                place=place,
                remedy="Give the machine file and the commands of the run.",
            )
    rows = np.diff(counts, axis=0)
    block = TickBlock(first_tick=0, counts=rows, operation=np.zeros(len(rows), dtype=np.int64))
    return TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=np.array([axis.counts.si for axis in machine.axes.values()]),
        start_counts=counts[0],
        blocks=Stream(iter, (block,)),
        job_sha256=job_sha256,
        machine_sha256=machine.sha256,
    )


def moves(
    columns: Mapping[tuple[ChannelKind, str], FloatArray], name: str, machine: Machine
) -> bool:
    """Return whether the commands of an axis move it by more than a few counts."""
    position = columns.get((ChannelKind.COMMANDED, name))
    if position is None or not machine.axes[name].controller:
        return False
    return float(np.ptp(position)) * machine.axes[name].counts.si >= _LEAST_MOTION


def cut_as_recorded(
    recording: Recording, machine: Machine, place: Place
) -> tuple[Machine, int | None]:
    """Return the machine as it was recorded, and the number of samples of a coast with supply.

    Raises
    ------
    RecordingError
        If the recording is a coast without its axis or the position of the cut.
    """
    if not any(channel.name == SUPPLY_CUT for channel in recording.channels):
        return machine, None
    cut_at, axis = recording.origin.get(CUT_AT, ""), recording.origin.get("axis", "")
    try:
        at_si = float(cut_at)
    except ValueError:
        at_si = np.nan
    if not np.isfinite(at_si) or axis not in machine.axes:
        raise RecordingError(
            f"it is a coast, and the axis of {machine.name} and the position at which the "
            "supply was cut are missing",
            place=place,
            remedy="Fit the file that threadline measure wrote, with the machine that it measured.",
        )
    is_cut = np.concatenate([block.samples[SUPPLY_CUT] for block in recording])
    return coasting(machine, axis, at_si), int(np.sum(is_cut == 0.0))


def refuse_clipped(machine: Machine, axis: str, volts: FloatArray, place: Place) -> None:
    """Refuse a run whose volts are mostly at the clamp: it says little about the loop.

    Raises
    ------
    RecordingError
        If more than a fifth of the samples are at the clamp.
    """
    dac = machine.controller_of(axis).dac
    clamp_v = dac.range.si * (1.0 - 2.0 ** (1.0 - dac.bits.si))
    share = float(np.mean(np.abs(volts) >= _CLAMP_SHARE * clamp_v))
    if share > _CLIPPED:
        raise RecordingError(
            f"the controller of {axis} is at its clamp of {clamp_v:.4g} V in {100.0 * share:.0f} "
            "% of "
            f"the samples, limit {100.0 * _CLIPPED:.0f} %",
            place=place,
            remedy="Record a slower run.",
        )
