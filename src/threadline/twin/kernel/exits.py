"""Kernel code: first exit of a polynomial from its bounds.

Guarantees for a guard g on (0, until], in a cell with fastest rate x length at most 1/2, with g
inside its bounds at 0:

- At a reported exit, g is on that bound, to rounding.
- If g is outside at the end, an exit is reported: the first one, except for excursions as below.
- An earlier excursion out and back is missed only if it is smaller than a hundredth of ``until^4``
  times the largest fourth derivative: the cubic through both ends can hide a 384th, and the secant
  of the slope, which finds the peak of a section, the rest.
- The exit of a monotone guard is always found if its end is outside.
- The exit of a lane does not depend on width or other lanes; lanes outside the mask have none.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from llvmlite import ir

from threadline.twin.kernel.code import INTEGER, POINTER, Code, Value
from threadline.twin.kernel.layout import Layout
from threadline.twin.kernel.names import Exit

_MOST_STEPS = 60


class _Polynomial:
    """A guard within a cell: coefficients, bounds, and the remaining length of the cell."""

    def __init__(self, code: Code, terms: int, poly: Value, more: Value) -> None:
        self.code = code
        self.q = [code.read_lanes(poly, k * code.width) for k in range(terms + 1)]
        self.low, self.high, self.until = (
            code.read_lanes(more, k * code.width) for k in (Exit.LOW, Exit.HIGH, Exit.UNTIL)
        )

    def at(self, s: Value, order: int) -> list[Value]:
        """Return value, slope and half the second derivative, up to ``order``."""
        found = [self.q[-1]] + [self.code.number(0.0)] * order
        for coefficient in self.q[-2::-1]:
            for m in range(order, 0, -1):
                found[m] = self.code.fma(found[m], s, found[m - 1])
            found[0] = self.code.fma(found[0], s, coefficient)
        return found

    def beyond(self, value: Value) -> Value:
        """Return the lanes in which a value is out of bounds."""
        return (value > self.high) | (value < self.low)


class _Bracket(NamedTuple):
    """A point inside the bounds, a point outside, and the values and slopes at both."""

    left: Value
    right: Value
    before: Value
    after: Value
    falls: Value
    rises: Value


def write_first_exit(module: ir.Module, layout: Layout, monotone: bool) -> Any:
    """Write the function that finds the first exit of a polynomial on (0, until].

    Arguments: coefficients, [low, high, until, side], mask of lanes; ``until`` and ``side`` (+1
    above, -1 below, 0 for no exit) are set. A monotone polynomial has an exit if its end is
    outside.
    """
    name = "first_exit_monotone" if monotone else "first_exit"
    width = layout.shape.width
    code = Code(module, name, (POINTER, POINTER, INTEGER), width, False)
    poly, more, bits = code.arguments
    lanes = code.from_bits(bits)
    guard = _Polynomial(code, layout.shape.terms, poly, more)
    side = code.variable(code.vector, 0.0)

    def locate(found: Value, bracket: _Bracket) -> None:
        above = bracket.after > guard.high
        sign = code.choose(above, code.number(1.0), code.number(-1.0))
        bound = code.choose(above, guard.high, guard.low)
        s = _root(guard, found, sign, bound, bracket)
        code.write_lanes(more, Exit.UNTIL * width, code.choose(found, s, guard.until))
        side.set(code.choose(found, sign, 0.0))

    if monotone:
        end = guard.at(guard.until, 0)[0]
        found = guard.beyond(end) & lanes
        with code.when(code.any(found)):
            rises = guard.at(guard.until, 1)[1]
            zero = code.number(0.0)
            locate(found, _Bracket(zero, guard.until, guard.q[0], end, guard.q[1], rises))
    else:
        end, fall = guard.at(guard.until, 1)
        third = guard.until * (1.0 / 3.0)
        hull = guard.beyond(code.fma(guard.q[1], third, guard.q[0]))
        hull = hull | guard.beyond(end - fall * third) | guard.beyond(end)
        with code.when(code.any(hull & lanes)):
            found, bracket = _bracketed(guard, layout.shape.sections, (end, fall), lanes)
            with code.when(code.any(found)):
                locate(found, bracket)
    code.write_lanes(more, Exit.SIDE * width, side.get())
    code.finish()
    return code.function


def _bracketed(
    guard: _Polynomial, sections: int, end: tuple[Value, Value], lanes: Value
) -> tuple[Value, _Bracket]:
    """Return the lanes with an exit, and the section of the first one, or its part up to a peak."""
    code = guard.code
    zero = code.number(0.0)
    found = ~lanes & lanes
    bracket = _Bracket(zero, zero, zero, zero, zero, zero)
    a, value_a, slope_a = zero, guard.q[0], guard.q[1]
    for section in range(sections):
        b = guard.until * ((section + 1) / sections)
        value_b, slope_b = end if section + 1 == sections else guard.at(b, 1)
        # If the slope changes sign in the section, the secant of the slope finds the peak.
        turns = slope_a * slope_b < 0.0
        middle = code.fma(b - a, slope_a / (slope_a - slope_b), a)
        middle = code.choose(turns, middle, b)
        value_m, slope_m = guard.at(middle, 1)
        peak = turns & guard.beyond(value_m)
        here = (guard.beyond(value_b) | peak) & ~found & lanes
        now = _Bracket(
            a,
            code.choose(peak, middle, b),
            value_a,
            code.choose(peak, value_m, value_b),
            slope_a,
            code.choose(peak, slope_m, slope_b),
        )
        pairs = zip(now, bracket, strict=True)
        bracket = _Bracket(*(code.choose(here, new, old) for new, old in pairs))
        found = found | here
        a, value_a, slope_a = b, value_b, slope_b
    return found, bracket


def _root(guard: _Polynomial, found: Value, sign: Value, bound: Value, bracket: _Bracket) -> Value:
    """Write Halley's method with a bracket; each lane stops independently."""
    code = guard.code
    # Inverse cubic Hermite interpolation, or the secant if that leaves the bracket.
    span, rise = bracket.right - bracket.left, bracket.after - bracket.before
    x = (bound - bracket.before) / rise
    one, other = rise / bracket.falls, rise / bracket.rises
    bend = (one - span) * (1.0 - x) - (other - span) * x
    secant = code.fma(span, x, bracket.left)
    guess = code.fma(x * (1.0 - x), bend, secant)
    fits = (guess >= bracket.left) & (guess <= bracket.right)
    guess = code.choose(fits, guess, secant)
    s = code.variable(code.vector, guess)
    left = code.variable(code.vector, bracket.left)
    right = code.variable(code.vector, bracket.right)
    open_ = code.variable(INTEGER, code.bits(found))
    turn = code.variable(INTEGER, 0)
    with code.loop() as leave:
        leave(open_.get().equals(0))
        leave(turn.get() >= _MOST_STEPS)
        turn.set(turn.get() + 1)
        now = s.get()
        value, slope, half_bend = guard.at(now, 2)
        off = value - bound
        too_far = off * sign > 0.0
        lanes = code.from_bits(open_.get())
        right.set(code.choose(too_far & lanes, now, right.get()))
        left.set(code.choose(~too_far & lanes, now, left.get()))
        below = code.fma(slope, slope, off * half_bend * -1.0)
        better = now - off * slope / below
        inside = (better >= left.get()) & (better <= right.get())
        better = code.choose(inside, better, (left.get() + right.get()) * 0.5)
        moved = code.call("fabs", better - now)
        done = (moved < 3e-5) & inside | (right.get() - left.get() < 1e-15)
        s.set(code.choose(lanes, better, now))
        open_.set(code.bits(lanes & ~done))
    return s.get()
