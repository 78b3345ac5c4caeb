"""The kernel: one connected piece with its controllers, tick by tick, for many variants.

It is written for the shape of the piece and compiled in a few tenths of a second, or read from the
cache. The compiler knows sizes, the pattern of every matrix and the actions of every kind of step,
but not the numbers. With one lane it is the kernel of a single machine: scalar and batch run the
same operations in the same order, so they agree bit by bit.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import CFUNCTYPE, c_int64, c_void_p
from functools import cache, partial
from threading import Lock
from typing import Any

from llvmlite import ir

from threadline.twin.kernel.code import INTEGER, POINTER, Code, Value
from threadline.twin.kernel.compiler import Compiler
from threadline.twin.kernel.exits import write_first_exit
from threadline.twin.kernel.lanes import Context, Lanes
from threadline.twin.kernel.layout import Layout
from threadline.twin.kernel.mode_changes import write_change, write_events, write_gather
from threadline.twin.kernel.names import Action, ClockEntry, Count, Do, Slot
from threadline.twin.kernel.sensing import write_goals
from threadline.twin.kernel.shape import Shape
from threadline.twin.kernel.tick import (
    write_actions,
    write_advance,
    write_loads,
    write_sample,
    write_worst,
)

_lock = Lock()


@cache
def _compiler() -> Compiler:
    return Compiler()


def kernel(shape: Shape) -> Any:
    """Return the kernel for a shape: a function of first and last block, and the context."""
    with _lock:
        return _kernel(shape)


@cache
def _kernel(shape: Shape) -> Any:
    address = _compiler().address(partial(_module, shape), "run", repr(shape))
    return CFUNCTYPE(None, c_int64, c_int64, c_void_p)(address)


def _module(shape: Shape) -> Any:
    """Write the kernel for a shape."""
    module = ir.Module("kernel")
    layout = Layout(shape)
    events = gather = None
    if shape.guards:
        change = write_change(module, layout)
        kinds = {shape.monotone(w) for w in range(len(shape.guards))}
        exits = {kind: write_first_exit(module, layout, kind) for kind in kinds}
        events = write_events(module, layout, change, exits)
        gather = write_gather(module, layout)
    _write_run(module, layout, (events, gather))
    return module


class _Run:
    """Shared values while the outermost function is written."""

    def __init__(self, code: Code, layout: Layout, functions: Any, array: Value) -> None:
        self.code, self.layout, self.shape = code, layout, layout.shape
        self.functions = functions
        self.array, self.context = array, Context(code, array)
        self.references = self.context.pointer(Slot.REFERENCES)
        self.rows = self.context.integer(Slot.ROWS)
        self.every = self.context.integer(Slot.EVERY)
        self.window = self.context.integer(Slot.WINDOW)

    def block(self, b: Value) -> None:
        """Set the addresses and variables of block b."""
        code, shape, context = self.code, self.shape, self.context
        K = len(shape.controllers)
        self.b, self.first = b, b * (shape.lanes // shape.width)
        size = self.layout.stride * shape.width
        self.work = code.place(context.pointer(Slot.WORK), self.first * size)
        entries = ClockEntry.HEADS + 2 * K
        self.clock = code.place(context.pointer(Slot.CLOCK), b * entries, INTEGER)
        self.counts = code.place(context.pointer(Slot.COUNTS), b * len(Count), INTEGER)
        self.row = code.variable(INTEGER, 0)
        self.taken = code.variable(INTEGER, 0)

    def over_lanes(self, write: Callable[[Value, Value, Lanes], None]) -> None:
        """Write a loop over the vectors of the block; arguments: group index, first lane, rows."""
        code, shape, layout = self.code, self.shape, self.layout
        if shape.lanes == shape.width:
            write(self.first, code.integer(0), Lanes(code, layout, self.work))
            return
        uniform = {
            name: code.splat(code.read(self.work, layout[name] * shape.width))
            for name in shape.uniform
            if name in layout.row
        }
        with code.count(0, shape.lanes // shape.width) as group:
            base = code.place(self.work, group * (layout.stride * shape.width))
            rows = Lanes(code, layout, base, uniform)
            write(self.first + group, group * shape.width, rows)

    def tick(self) -> None:
        """Write the part of a tick before its actions: loads, sample, the next row."""
        code, shape, row = self.code, self.shape, self.row
        now = code.read(self.clock, ClockEntry.NOW, INTEGER)
        in_window = now >= self.window
        with code.when_seldom(in_window | (row.get() + 1 >= self.rows)):
            self.over_lanes(lambda *found: write_loads(found[2], in_window))
        code.write(self.clock, ClockEntry.NOW, now + 1, INTEGER)
        row.set(row.get() + 1)
        with code.when_seldom(self.every > 0):
            until = code.variable(INTEGER, code.read(self.clock, ClockEntry.UNTIL_SAMPLE, INTEGER))
            with code.when(until.get().equals(0)):
                records, taken = self.context.pointer(Slot.RECORDS), self.taken.get()
                first = self.b * shape.lanes
                self.over_lanes(
                    lambda _, lane, rows: write_sample(rows, records, taken, first + lane)
                )
                self.taken.set(self.taken.get() + 1)
                until.set(self.every)
            code.write(self.clock, ClockEntry.UNTIL_SAMPLE, until.get() - 1, INTEGER)

    def sent(self, actions: tuple[Action, ...]) -> dict[Action, Value]:
        """Return the addresses of these actions in the dead-time rings, and advance the rings."""
        code, shape = self.code, self.shape
        found: dict[Action, Value] = {}
        if not shape.delayed:
            return found
        ring, size = self.context.pointer(Slot.RING), self.context.integer(Slot.RING_LENGTH)
        for action in actions:
            if action.do not in (Do.CONTROL, Do.ARRIVE):
                continue
            c = action.controller
            at = ClockEntry.HEADS + 2 * c + (action.do == Do.ARRIVE)
            head = code.read(self.clock, at, INTEGER)
            place = ((self.b * len(shape.controllers) + c) * size + head) * shape.lanes
            found[action] = code.place(ring, place)
            after = head + 1
            wrapped = code.choose(after >= size, code.integer(0), after)
            code.write(self.clock, at, wrapped, INTEGER)
        return found

    def _referred(self, c: int) -> range:
        """Return the loops whose references a controller's action needs."""
        bank = self.shape.controllers[c].bank
        return range(c, c + (1 if bank is None else bank.loops))

    def step(self, actions: tuple[Action, ...], length: Value) -> None:
        """Write a step of one kind; a negative length means no advance."""
        code, shape = self.code, self.shape
        ticks = any(a.do == Do.TICK for a in actions)
        advances = Action(Do.ADVANCE) in actions
        if ticks:
            self.tick()
        K = len(shape.controllers)
        at = (self.row.get() - 1) * K
        used = {c for a in actions if a.do == Do.CONTROL for c in self._referred(a.controller)}
        if ticks and not shape.shared:
            used |= {axis.controller for axis in shape.axes}
            used |= {c for c, controller in enumerate(shape.controllers) if controller.profile}
        scalars = {c: code.read(self.references, at + c) for c in sorted(used)}
        sent = self.sent(actions)

        def write(number: Value, lane: Value, rows: Lanes) -> None:
            references = [
                code.splat(scalars[c]) if c in scalars else code.number(0.0) for c in range(K)
            ]
            if ticks and not shape.shared:
                write_worst(rows, references)
                write_goals(rows, references)
            places = {key: code.place(base, lane) for key, base in sent.items()}
            write_actions(rows, actions, references, places)
            if advances and not shape.guards:
                advance(number, lane, rows)

        def advance(number: Value, _lane: Value, rows: Lanes) -> None:
            call = [rows.base, number, length, self.counts, self.array]
            write_advance(rows, self.functions, call)

        if len(actions) > advances:
            self.over_lanes(write)
        if advances and (shape.guards or len(actions) == 1):
            # In a separate loop: processors overlap short chains of operations better.
            self.over_lanes(advance)


def _write_run(module: ir.Module, layout: Layout, functions: Any) -> None:
    shape = layout.shape
    code = Code(module, "run", (INTEGER, INTEGER, POINTER), shape.width, False)
    begin, end, array = code.arguments
    run = _Run(code, layout, functions, array)
    kinds, lengths = run.context.pointer(Slot.KINDS), run.context.pointer(Slot.LENGTHS)
    steps = run.context.integer(Slot.STEPS)
    with code.count(begin, end) as b:
        run.block(b)
        step = code.variable(INTEGER, code.read(run.clock, ClockEntry.STEP, INTEGER))
        with code.loop() as leave:
            kind = code.read(kinds, step.get(), INTEGER)
            starts = [i for i, k in enumerate(shape.kinds) if any(a.do == Do.TICK for a in k)]
            over = run.row.get() >= run.rows
            is_tick = kind < len(starts)
            assert starts == list(range(len(starts)))
            leave(over & is_tick)
            length = code.read(lengths, step.get(), INTEGER)
            _switch(code, kind, [partial(run.step, k, length) for k in shape.kinds])
            after = step.get() + 1
            step.set(code.choose(after >= steps, code.integer(0), after))
        code.write(run.clock, ClockEntry.STEP, step.get(), INTEGER)
    code.finish()


def _switch(code: Code, which: Value, cases: list[Callable[[], None]]) -> None:
    if len(cases) == 1:
        cases[0]()
        return
    blocks = [code.at.append_basic_block(f"kind{i}") for i in range(len(cases))]
    after = code.at.append_basic_block("after")
    choice = code.at.switch(which.ir, blocks[0])
    for i, (block, case) in enumerate(zip(blocks, cases, strict=True)):
        if i:
            choice.add_case(ir.Constant(INTEGER, i), block)
        code.at.position_at_end(block)
        case()
        code.at.branch(after)
    code.at.position_at_end(after)
