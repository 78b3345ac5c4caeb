"""Kernel code: what happens at one instant, and the advance to the next, for some lanes."""

from __future__ import annotations

from typing import Any

from threadline.twin.code import Value
from threadline.twin.lanes import Lanes
from threadline.twin.profile import profiled
from threadline.twin.schedule import ARRIVE, CONTROL


def write_worst(rows: Lanes, references: list[Value]) -> None:
    """Keep the largest |commanded - load| of every axis whose controller doesn't read its load."""
    for x, axis in enumerate(rows.shape.axes):
        load = rows.product(("load", x), axis.load)
        apart = references[axis.controller] * rows["scale", x] - load
        _keep(rows, ("worst", x), rows.code.call("fabs", apart))


def _keep(rows: Lanes, name: tuple[object, ...], value: Value) -> None:
    rows[name] = rows.code.larger(value, rows[name])


def write_actions(
    rows: Lanes,
    actions: tuple[tuple[int, int], ...],
    references: list[Value],
    sent: dict[tuple[int, int], Value],
) -> None:
    """Write the actions of a step.

    Parameters
    ----------
    references
        Counts commanded to each controller.
    sent
        Where the level of a controller goes, and where the one that arrives comes from.
    """
    for what, c in actions:
        if what == CONTROL:
            _control(rows, c, references[c])
            if rows.shape.delayed:
                rows.code.write_lanes(sent[CONTROL, c], 0, rows["level", c])
        elif what == ARRIVE:
            if rows.shape.delayed:
                rows["held", c] = rows.code.read_lanes(sent[ARRIVE, c], 0)
            _arrive(rows, c)


def _control(rows: Lanes, c: int, reference: Value) -> None:
    """Write ``u = b0 e + b1 e' + b2 e'' - a1 u' - a2 u''``, rounded and limited."""
    code, shape = rows.code, rows.shape
    controller = shape.controllers[c]
    read = rows.product(("sensor", c), controller.sensor)
    if shape.shared:
        _keep(rows, ("worst", c), code.call("fabs", reference - read))
    if shape.quantised:
        read = code.call("floor", read + rows["phase", c])
    if controller.profile:
        reference = profiled(rows, c, reference)
    e = reference - read
    value = code.fma(rows["b0", c], e, rows["b1", c] * rows["e1", c])
    if controller.feedback:
        value = value - rows["a1", c] * rows["o1", c]
    if controller.second:
        value = code.fma(rows["b2", c], rows["e2", c], value)
        value = value - rows["a2", c] * rows["o2", c]
        rows["e2", c] = rows["e1", c]
        rows["o2", c] = rows["o1", c]
    rows["e1", c] = e
    low, high = rows["level low", c], rows["level high", c]
    level = code.call("rint", value) if shape.quantised else value
    level = code.larger(low, code.smaller(high, level))
    if controller.feedback or controller.second:
        rows["o1", c] = code.larger(low, code.smaller(high, value))
    if controller.reversal:
        level = code.choose(level * rows["level", c] < 0.0, 0.0, level)
    rows["level", c] = level


def _arrive(rows: Lanes, c: int) -> None:
    controller = rows.shape.controllers[c]
    held = rows["held" if rows.shape.delayed else "level", c] * rows["gain", c]
    if controller.limited:
        limit = rows["limit", c]
        held = rows.code.larger(limit * -1.0, rows.code.smaller(limit, held))
    rows["z", rows.shape.states + controller.drive] = held


def write_peaks(rows: Lanes) -> None:
    """Keep the current of largest magnitude of every drive."""
    code = rows.code
    for d, pattern in enumerate(rows.shape.drives):
        now, kept = rows.product(("current", d), pattern), rows["peak", d]
        rows["peak", d] = code.choose(code.call("fabs", now) > code.call("fabs", kept), now, kept)


def write_advance(rows: Lanes, functions: tuple[Any, Any], call: list[Value]) -> None:
    """Write the advance to the next instant.

    Parameters
    ----------
    functions
        For lanes whose modes change, and for those in several modes; None where there are none.
    call
        Rows of the lanes, their number among all such groups, length, counts, context.
    """
    events, gather = functions
    code, shape = rows.code, rows.shape

    def leave(mask: Value, whole: int, before: tuple[Value, ...] = ()) -> None:
        bits = code.bits(mask)
        with code.when_seldom(~bits.equals(0)):
            for i, value in enumerate(before):
                rows.leave_behind(("old", i), value)
            code.run(events, *call[:3], bits, code.integer(whole), *call[3:])

    if shape.peak:
        if events is not None:
            # Inputs may have jumped: the current belongs to the mode then in force.
            leave(rows.jumped(), 0)
            rows.forget()
        write_peaks(rows)
    before = tuple(rows["z", i] for i in range(shape.states))
    rows.choose_length(gather, call[1], call[2], call[4])
    after = rows.advanced()
    if events is None:
        for i in range(shape.states):
            rows["z", i] = after[i]
    else:
        near = rows.may_be_near(after)
        for i in range(shape.states):
            rows.leave_behind(("z", i), after[i])
        if near is None:
            leave(rows.may_leave(after), 1, before)
        else:
            with code.when_seldom(code.any(near)):
                leave(rows.may_leave(after) & near, 1, before)
        rows.forget()
    if shape.peak:
        write_peaks(rows)


def write_loads(rows: Lanes, in_window: Value) -> None:
    """Keep the load of every axis, the last and, in the window, the least and the greatest."""
    code = rows.code
    for x, axis in enumerate(rows.shape.axes):
        load = rows.product(("load", x), axis.load)
        rows["last", x] = load
        lowest, highest = rows["lowest", x], rows["highest", x]
        rows["lowest", x] = code.choose(in_window, code.smaller(load, lowest), lowest)
        rows["highest", x] = code.choose(in_window, code.larger(load, highest), highest)


def write_sample(rows: Lanes, out: Value) -> None:
    """Fill a sample of some lanes.

    Columns: counts and volts of each controller, load and frame of each axis, current and its
    peak of each drive, every switch.
    """
    code, shape = rows.code, rows.shape
    values: list[Value] = []
    for c, controller in enumerate(shape.controllers):
        read = rows.product(("sensor", c), controller.sensor)
        if shape.quantised:
            read = code.call("floor", read + rows["phase", c])
        values += [read, rows["level", c] * rows["volt", c]]
    for x, axis in enumerate(shape.axes):
        values.append(rows.product(("load", x), axis.load))
        values.append(rows.product(("frame", x), axis.frame))
    for d, pattern in enumerate(shape.drives):
        now, kept = rows.product(("current", d), pattern), rows["peak", d]
        larger = code.call("fabs", now) > code.call("fabs", kept)
        values += [now, code.choose(larger, now, kept)]
        rows["peak", d] = 0.0
    values += [rows["tripped", s] for s in range(shape.inputs)]
    for column, value in enumerate(values):
        code.write_lanes(out, column * shape.lanes, value)
