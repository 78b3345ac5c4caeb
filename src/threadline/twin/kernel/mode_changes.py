"""Kernel code: an advance with mode changes, each located exactly.

A guard is checked over an advance by the four Bezier points of its cubic Hermite interpolant, a
monotone guard by its ends. If all of them are inside the bounds, the advance is made in one step.
Otherwise it is made cell by cell: within a cell the guards are polynomials, Taylor series with a
remainder below 1e-17 of the state, whose first exit is found to rounding. An excursion out and back
within a checked interval h is missed only if it exceeds the bound by less than the error of the
interpolant, ``h^4 max|g''''| / 384``; h times the fastest rate is at most 1, within a cell 1/2.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from threadline.twin.kernel.code import INTEGER, POINTER, Code, Value
from threadline.twin.kernel.lanes import Context, Lanes
from threadline.twin.kernel.layout import Layout
from threadline.twin.kernel.names import Count, Exit, Field, Slot

_MOST_EVENTS = 2000.0


def write_change(module: ir.Module, layout: Layout) -> Any:
    """Write the function that changes the modes of some lanes.

    Arguments: rows of the lanes, their group index, their events (w + 1 above guard w, -w - 1
    below, 0 for none), counts, context. Lanes with the same mode and event are handled together.
    """
    plan_at, width = layout.plan, layout.shape.width
    arguments = (POINTER, INTEGER, POINTER, POINTER, POINTER)
    code = Code(module, "change", arguments, width, True)
    base, number, given, counts, array = code.arguments
    context = Context(code, array)
    rows = Lanes(code, layout, base)
    tables, events = context.pointer(Slot.TABLES), code.read_lanes(given, 0)
    offset = number * (layout.table_rows * width)
    left = code.variable(INTEGER, code.bits(code.call("fabs", events) > 0.0))
    with code.loop() as leave:
        leave(left.get().equals(0))
        rows.forget()
        first = code.first_bit(left.get())
        event = code.to_integer(code.read(given, first))
        place = code.place(rows.base, layout[Field.MODE,] * width)
        mode = code.to_integer(code.read(place, first))
        alike = rows[Field.MODE,].equals(code.to_number(mode))
        alike = alike & events.equals(code.to_number(event))
        now = code.from_bits(left.get()) & alike
        left.set(left.get() - code.bits(now))
        guard = code.choose(event > 0, event, code.integer(0) - event) - 1
        which = guard * 2 + code.choose(event > 0, code.integer(1), code.integer(0))
        target = code.place(rows.base, layout.fixed * width)
        plan = code.read(context.pointer(Slot.PLANS), mode, POINTER)

        def blend(row: Value, value: Value | float, now: Value = now) -> None:
            at = row * width
            code.write_lanes(rows.base, at, code.choose(now, value, code.read_lanes(rows.base, at)))

        switch = code.read(plan, guard + plan_at.switch, INTEGER)
        with code.when(switch >= 0):
            blend(switch + layout.row.get((Field.TRIPPED, 0), 0), 1.0)
        held = code.read(plan, which + plan_at.held, INTEGER)
        with code.when(held >= 0):
            old = code.place(code.read(tables, mode, POINTER), offset)
            blend(held, code.read_lanes(old, (which + layout.of_mode) * width))
        to = code.read(plan, which + plan_at.to, INTEGER)
        done = code.read(counts, Count.EVENTS, INTEGER) + code.ones(code.bits(now))
        code.write(counts, Count.EVENTS, done, INTEGER)
        table = _table(context, tables, to)
        unmet = _is_null(code, table)
        with code.when_seldom(unmet):
            code.write(counts, Count.UNMET, code.integer(1), INTEGER)
        with code.when(~unmet):
            blend(code.integer(layout[Field.MODE,]), code.to_number(to))
            _copy(code, target, code.place(table, offset), layout.copied, now)
    if layout.shape.lengths > 1:
        rows.forget()
        _choose_source(code, rows, tables, offset)
    code.finish()
    return code.function


def _table(context: Context, tables: Value, mode: Value) -> Value:
    """Return the table of a mode, filled at its first use; 0 if it cannot be filled."""
    code = context.code
    table = code.variable(POINTER, code.read(tables, mode, POINTER))
    with code.when_seldom(_is_null(code, table.get())):
        code.run_address(context.integer(Slot.MEET), mode)
        table.set(code.read(tables, mode, POINTER))
    return table.get()


def _copy(code: Code, target: Value, source: Value, rows: int, where: Value) -> None:
    """Write rows to some lanes; for all lanes, the usual case, without reading first."""
    width = code.width
    everywhere = code.bits(where).equals((1 << width) - 1)
    with code.when(everywhere), code.count(0, rows) as row:
        code.write_lanes(target, row * width, code.read_lanes(source, row * width))
    with code.when(~everywhere), code.count(0, rows) as row:
        at = row * width
        value = code.choose(where, code.read_lanes(source, at), code.read_lanes(target, at))
        code.write_lanes(target, at, value)


def _choose_source(code: Code, rows: Lanes, tables: Value, offset: Value) -> None:
    """Write the address of the rows of advances: in the table of a mode, 0 for several modes."""
    layout, width = rows.layout, rows.shape.width
    mode = code.to_integer(code.read(code.place(rows.base, layout[Field.MODE,] * width), 0))
    same = rows[Field.MODE,].equals(code.to_number(mode))
    at = offset + (layout.first_length - layout.fixed) * width
    source = code.variable(POINTER, code.place(code.read(tables, mode, POINTER), at))
    with code.when(code.any(~same)):
        source.set(Value(code, ir.Constant(POINTER, None)))
    code.write(rows.base, layout[Field.SOURCE,] * width, source.get(), POINTER)


def write_gather(module: ir.Module, layout: Layout) -> Any:
    """Write the function that collects the rows of one advance for lanes in several modes.

    Arguments: rows of the lanes, their group index, length, context.
    """
    width = layout.shape.width
    code = Code(module, "gather", (POINTER, INTEGER, INTEGER, POINTER), width, True)
    base, number, length, array = code.arguments
    tables = Context(code, array).pointer(Slot.TABLES)
    rows = Lanes(code, layout, base)
    offset = number * (layout.table_rows * width)
    first = length * layout.per_length + (layout.first_length - layout.fixed)
    left = code.variable(INTEGER, code.integer((1 << width) - 1))
    target = code.place(base, layout.first_length * width)
    modes = rows[Field.MODE,]
    with code.loop() as leave:
        leave(left.get().equals(0))
        one = code.place(base, layout[Field.MODE,] * width)
        mode = code.to_integer(code.read(one, code.first_bit(left.get())))
        now = modes.equals(code.to_number(mode))
        left.set(left.get() - code.bits(now))
        source = code.place(code.read(tables, mode, POINTER), offset + first * width)
        _copy(code, target, source, layout.per_length, now)
    code.finish()
    return code.function


def _is_null(code: Code, pointer: Value) -> Value:
    return Value(code, code.at.ptrtoint(pointer.ir, INTEGER)).equals(0)


def write_events(module: ir.Module, layout: Layout, change: Any, first_exit: Any) -> Any:
    """Write the function that advances ``width`` lanes with mode changes.

    Arguments: rows of the lanes, their group index, length, mask, whole advance or none (then it
    only leaves modes whose guards are violated), counts, context. ``first_exit`` holds the
    functions for monotone (True) and other guards (False).
    """
    shape = layout.shape
    n, width, K = shape.states, shape.width, shape.terms
    arguments = (POINTER, INTEGER, INTEGER, INTEGER, INTEGER, POINTER, POINTER)
    code = Code(module, "events", arguments, width, True)
    base, number, length, bits, whole, counts, array = code.arguments
    context = Context(code, array)
    live = code.from_bits(bits)
    rows = Lanes(code, layout, base)
    poly, more, kept = code.space((K + 1) * width), code.space(4 * width), code.space(width)
    cells, fraction = code.variable(code.vector, 0.0), code.variable(code.vector, 0.0)
    changes, event = code.variable(code.vector, 0.0), code.variable(code.vector, 0.0)
    span = code.read(context.pointer(Slot.CELL_S), length)
    with code.when(whole > 0):
        z, old = (code.place(base, layout[f, 0] * width) for f in (Field.COLUMN, Field.OLD))
        _copy(code, z, old, n, live)
        slow = code.read(counts, Count.SLOW, INTEGER) + code.ones(bits)
        code.write(counts, Count.SLOW, slow, INTEGER)
        many = code.read(context.pointer(Slot.CELLS), length)
        cells.set(code.choose(live, Value(code, code.lift(many, code.vector)), 0.0))
        fraction.set(code.choose(live, code.number(1.0), 0.0))

    def turn() -> None:
        """Change the modes of the lanes with an event."""
        code.write_lanes(kept, 0, event.get())
        changes.set(changes.get() + code.choose(_is_event(event), code.number(1.0), 0.0))
        code.run(change, base, number, kept, counts, array)

    def _is_event(variable: Any) -> Value:
        return code.call("fabs", variable.get()) > 0.0

    with code.loop() as leave:
        endless = code.any(changes.get() > _MOST_EVENTS)
        with code.when_seldom(endless):
            code.write(counts, Count.ENDLESS, code.integer(1), INTEGER)
        leave(endless)
        rows.forget()
        now = code.number(0.0)
        for w in range(len(shape.guards) - 1, -1, -1):
            value = rows.product(Field.GUARD, w, shape.guards[w].row)
            now = code.choose(value > rows[Field.HIGH, w], code.number(w + 1.0), now)
            now = code.choose(value < rows[Field.LOW, w], code.number(-w - 1.0), now)
        event.set(code.choose(live, now, 0.0))
        stay = ~code.any(_is_event(event))
        moving = cells.get() > 0.0
        leave(stay & ~code.any(moving))
        with code.when(stay):
            _cell(code, rows, (cells, fraction, event), moving, span, (poly, more), first_exit)
        with code.when(code.any(_is_event(event))):
            turn()
    code.finish()
    return code.function


def _cell(
    code: Code,
    rows: Lanes,
    variables: Any,
    moving: Value,
    span: Value,
    spaces: tuple[Value, Value],
    first_exit: Any,
) -> None:
    """Write an advance to the end of the cell or to its first event."""
    shape, (cells, fraction, event), (poly, more) = rows.shape, variables, spaces
    n, width, K = shape.states, shape.width, shape.terms
    time = code.choose(moving, fraction.get() * span, 0.0)
    columns = [rows.column(j) for j in range(shape.columns)]
    first = [
        rows.product(Field.MATRIX, i, pattern, columns) * time
        for i, pattern in enumerate(shape.matrix)
    ]
    series = [columns[:n], first]
    for k in range(2, K + 1):
        step = time * (1.0 / k)
        series.append(
            [
                code.total([(rows[Field.MATRIX, i, j], series[-1][j]) for j in pattern if j < n])
                * step
                for i, pattern in enumerate(shape.matrix)
            ]
        )
    code.write_lanes(more, Exit.UNTIL * width, 1.0)
    for w, guard in enumerate(shape.guards):
        inner = [j for j in guard.row if j < n]
        for k in range(K + 1):
            if k == 0:
                value = rows.product(Field.GUARD, w, guard.row)
            else:
                value = code.total([(rows[Field.GUARD, w, j], series[k][j]) for j in inner])
            code.write_lanes(poly, k * width, value)
        code.write_lanes(more, Exit.LOW * width, rows[Field.LOW, w])
        code.write_lanes(more, Exit.HIGH * width, rows[Field.HIGH, w])
        code.run(first_exit[shape.monotone(w)], poly, more, code.bits(moving))
        side = code.read_lanes(more, Exit.SIDE * width)
        left = code.call("fabs", side) > 0.0
        event.set(code.choose(left, side * (w + 1.0), event.get()))
    until = code.read_lanes(more, Exit.UNTIL * width)
    for i in range(n):
        value = series[K][i]
        for k in range(K - 1, -1, -1):
            value = code.fma(value, until, series[k][i])
        rows[Field.COLUMN, i] = code.choose(moving, value, columns[i])
    left = fraction.get() - fraction.get() * until
    finished = ~(code.call("fabs", event.get()) > 0.0) | (left <= 1e-14)
    cells.set(code.choose(moving & finished, cells.get() - 1.0, cells.get()))
    fraction.set(code.choose(finished, code.number(1.0), left))
