"""Kernel code: the actions at one instant, and the advance to the next."""

from __future__ import annotations

from typing import Any

from threadline.twin.kernel.code import INTEGER, POINTER, Value
from threadline.twin.kernel.lanes import Lanes
from threadline.twin.kernel.names import Action, Do, Field, Row
from threadline.twin.kernel.sensing import profiled, reading, write_bank, write_noise

_ENCODER = {"nearest": "floor", "floor": "floor", "truncate": "trunc"}
"""Intrinsic that rounds position + phase to counts, by the encoder's rounding."""
_DAC = {"nearest": "rint", "floor": "floor", "truncate": "trunc"}


def write_worst(rows: Lanes, references: list[Value]) -> None:
    """Update the largest |commanded - load| of every axis."""
    for x, axis in enumerate(rows.shape.axes):
        load = rows.product(Field.LOAD, x, axis.load)
        apart = references[axis.controller] * rows[Field.SCALE, x] - load
        _keep(rows, (Field.WORST, x), rows.code.call("fabs", apart))


def _keep(rows: Lanes, row: Row, value: Value) -> None:
    rows[row] = rows.code.larger(value, rows[row])


def write_actions(
    rows: Lanes, actions: tuple[Action, ...], references: list[Value], sent: dict[Action, Value]
) -> None:
    """Write the actions of a step.

    Parameters
    ----------
    references
        Commanded counts of each controller.
    sent
        Addresses at which a controller's level is written, and at which the arriving one is read.
    """
    for action in actions:
        c = action.controller
        if action.do == Do.CONTROL:
            if not rows.shape.controllers[c].banked:
                _control(rows, c, references[c])
            elif rows.shape.controllers[c].bank is not None:
                _control_bank(rows, c, references)
            if rows.shape.delayed:
                rows.code.write_lanes(sent[action], 0, rows[Field.LEVEL, c])
        elif action.do == Do.ARRIVE:
            if rows.shape.delayed:
                rows[Field.HELD, c] = rows.code.read_lanes(sent[action], 0)
            _arrive(rows, c)
    if any(action.do in (Do.TICK, Do.CONTROL) for action in actions):
        write_noise(rows)


def _control_bank(rows: Lanes, first: int, references: list[Value]) -> None:
    """Write the levels of all loops of a state-space controller."""
    bank = rows.shape.controllers[first].bank
    assert bank is not None
    loops = range(first, first + bank.loops)
    readings = [_read(rows, c) for c in loops]
    outputs = write_bank(rows, first, [references[c] for c in loops], readings)
    for c, value in zip(loops, outputs, strict=True):
        _convert(rows, c, value)


def _read(rows: Lanes, c: int) -> Value:
    """Return the reading of a controller's encoder, counts."""
    controller = rows.shape.controllers[c]
    read = rows.product(Field.SENSOR, c, controller.sensor)
    if rows.shape.quantised:
        read = rows.code.call(_ENCODER[controller.encoder], read + rows[Field.PHASE, c])
    return read


def _convert(rows: Lanes, c: int, value: Value) -> None:
    """Write the level of a controller's DAC for an output."""
    code, controller = rows.code, rows.shape.controllers[c]
    low, high = rows[Field.LEVEL_LOW, c], rows[Field.LEVEL_HIGH, c]
    level = code.call(_DAC[controller.dac], value) if rows.shape.quantised else value
    level = code.larger(low, code.smaller(high, level))
    if controller.feedback or controller.second:
        rows[Field.OUTPUT_1, c] = code.larger(low, code.smaller(high, value))
    if controller.reversal:
        level = code.choose(level * rows[Field.LEVEL, c] < 0.0, 0.0, level)
    rows[Field.LEVEL, c] = level


def _control(rows: Lanes, c: int, reference: Value) -> None:
    """Write ``u = b0 e + b1 e' + b2 e'' - a1 u' - a2 u''``, rounded and limited."""
    code, shape = rows.code, rows.shape
    controller = shape.controllers[c]
    read = rows.product(Field.SENSOR, c, controller.sensor)
    if shape.shared:
        _keep(rows, (Field.WORST, c), code.call("fabs", reference - read))
    if shape.quantised:
        read = code.call(_ENCODER[controller.encoder], read + rows[Field.PHASE, c])
    if controller.profile:
        reference = profiled(rows, c, reference)
    e = reference - read
    value = code.fma(rows[Field.B0, c], e, rows[Field.B1, c] * rows[Field.ERROR_1, c])
    if controller.feedback:
        value = value - rows[Field.A1, c] * rows[Field.OUTPUT_1, c]
    if controller.second:
        value = code.fma(rows[Field.B2, c], rows[Field.ERROR_2, c], value)
        value = value - rows[Field.A2, c] * rows[Field.OUTPUT_2, c]
        rows[Field.ERROR_2, c] = rows[Field.ERROR_1, c]
        rows[Field.OUTPUT_2, c] = rows[Field.OUTPUT_1, c]
    rows[Field.ERROR_1, c] = e
    _convert(rows, c, value)


def _arrive(rows: Lanes, c: int) -> None:
    controller = rows.shape.controllers[c]
    held = rows[Field.HELD if rows.shape.delayed else Field.LEVEL, c] * rows[Field.GAIN, c]
    if controller.limited:
        limit = rows[Field.LIMIT, c]
        held = rows.code.larger(limit * -1.0, rows.code.smaller(limit, held))
    rows[Field.COLUMN, rows.shape.states + controller.drive] = held


def write_peaks(rows: Lanes) -> None:
    """Update the current of largest magnitude of every drive."""
    code = rows.code
    for d, pattern in enumerate(rows.shape.drives):
        now, peak = rows.product(Field.CURRENT, d, pattern), rows[Field.PEAK, d]
        rows[Field.PEAK, d] = code.choose(
            code.call("fabs", now) > code.call("fabs", peak), now, peak
        )


def write_advance(rows: Lanes, functions: tuple[Any, Any], call: list[Value]) -> None:
    """Write the advance to the next instant.

    Parameters
    ----------
    functions
        For lanes with mode changes, and for lanes in several modes; None without guards.
    call
        Rows of the lanes, their group index, length, counts, context.
    """
    events, gather = functions
    code, shape = rows.code, rows.shape

    def leave(mask: Value, whole: int, before: tuple[Value, ...] = ()) -> None:
        bits = code.bits(mask)
        with code.when_seldom(~bits.equals(0)):
            for i, value in enumerate(before):
                rows.leave_behind((Field.OLD, i), value)
            code.run(events, *call[:3], bits, code.integer(whole), *call[3:])

    if shape.peak:
        if events is not None:
            # Inputs may have jumped, so update the mode before reading the current.
            leave(rows.jumped(), 0)
            rows.forget()
        write_peaks(rows)
    before = tuple(rows[Field.COLUMN, i] for i in range(shape.states))
    rows.choose_length(gather, call[1], call[2], call[4])
    after = rows.advanced()
    if events is None:
        for i in range(shape.states):
            rows[Field.COLUMN, i] = after[i]
    else:
        near = rows.may_be_near(after)
        for i in range(shape.states):
            rows.leave_behind((Field.COLUMN, i), after[i])
        if near is None:
            leave(rows.may_leave(after), 1, before)
        else:
            with code.when_seldom(code.any(near)):
                leave(rows.may_leave(after) & near, 1, before)
        rows.forget()
    if shape.peak:
        write_peaks(rows)


def write_loads(rows: Lanes, in_window: Value) -> None:
    """Update the last load of every axis and, in the window, the smallest and largest one."""
    code = rows.code
    for x, axis in enumerate(rows.shape.axes):
        load = rows.product(Field.LOAD, x, axis.load)
        rows[Field.LAST, x] = load
        lowest, highest = rows[Field.LOWEST, x], rows[Field.HIGHEST, x]
        rows[Field.LOWEST, x] = code.choose(in_window, code.smaller(load, lowest), lowest)
        rows[Field.HIGHEST, x] = code.choose(in_window, code.larger(load, highest), highest)


def write_sample(rows: Lanes, records: Value, sample: Value, lane: Value) -> None:
    """Write a sample, column by column of ``SampleLayout``.

    Parameters
    ----------
    records
        Address and stride in numbers of each column; address 0 means that it is not sampled.
    sample, lane
        Index of the sample in this call, and index of the first lane.
    """
    code, shape = rows.code, rows.shape
    at = shape.sample
    values: dict[int, Value] = {}
    for c in range(len(shape.controllers)):
        values[at.read(c)] = _read(rows, c)
        values[at.volts(c)] = rows[Field.LEVEL, c] * rows[Field.VOLT, c]
    for x, axis in enumerate(shape.axes):
        values[at.load(x)] = rows.product(Field.LOAD, x, axis.load)
        values[at.frame(x)] = rows.product(Field.FRAME, x, axis.frame)
        values[at.rate(x)] = rows.product(Field.RATE, x, axis.rate)
    for d, pattern in enumerate(shape.drives):
        now, peak = rows.product(Field.CURRENT, d, pattern), rows[Field.PEAK, d]
        larger = code.call("fabs", now) > code.call("fabs", peak)
        values[at.current(d)] = now
        values[at.peak(d)] = code.choose(larger, now, peak)
        rows[Field.PEAK, d] = 0.0
    for s in range(shape.inputs):
        values[at.tripped(s)] = rows[Field.TRIPPED, s]
    for i in range(len(shape.observing)):
        values[at.observed(i)] = reading(rows, i)
    for column, value in values.items():
        place = code.read(records, 2 * column, INTEGER)
        with code.when(~place.equals(0)):
            out, apart = code.read(records, 2 * column, POINTER), 2 * column + 1
            code.write_lanes(out, sample * code.read(records, apart, INTEGER) + lane, value)
