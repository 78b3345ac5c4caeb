"""Every operation of the code writer, compared with numpy, for one number and eight together.

Additions, products, quotients, roundings and choices follow IEEE 754 and must agree to the bit; a
fused product is compared with exact fractions, rounded once.
"""

from __future__ import annotations

from ctypes import CFUNCTYPE, addressof, c_double, c_int64, c_void_p, cast
from fractions import Fraction

import numpy as np
import pytest
from llvmlite import ir

from threadline.twin.kernel.code import INTEGER, POINTER, Code
from threadline.twin.kernel.compiler import Compiler

COMPILER = Compiler()
SPECIAL = (0.0, -0.0, 0.5, 1.5, 2.5, -0.5, -1.5, -2.5, 1e300, -1e300, 1e-308, 3.999999999999999)
WIDTHS = pytest.mark.parametrize("width", [1, 8])


def numbers(count: int, seed: int) -> np.ndarray:
    """Return ordinary and special numbers, a multiple of eight of them."""
    random = np.random.default_rng(seed)
    drawn = random.normal(size=count) * 10.0 ** random.integers(-8, 9, count)
    drawn[: len(SPECIAL)] = random.permutation(SPECIAL)
    return drawn


def run(width: int, write, *columns: np.ndarray) -> np.ndarray:
    """Compile ``out = write(code, *columns)`` and return it for all numbers."""
    module = ir.Module("one operation")
    code = Code(module, "run", (INTEGER, *[POINTER] * (len(columns) + 1)), width, False)
    count, out, *given = code.arguments
    with code.count(0, count, width) as at:
        code.write_lanes(out, at, write(code, *(code.read_lanes(g, at) for g in given)))
    code.finish()
    address = COMPILER.address(lambda: module, "run")
    function = CFUNCTYPE(None, c_int64, *[c_void_p] * (len(columns) + 1))(address)
    found = np.full(len(columns[0]), np.nan)
    function(len(found), found.ctypes.data, *(c.ctypes.data for c in columns))
    return found


def same(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(expected))


A, B, C = (numbers(400, seed) for seed in (1, 2, 3))
OPERATIONS = {
    "add": (lambda k, a, b, c: a + b, lambda: A + B),
    "add a number": (lambda k, a, b, c: a + 0.1, lambda: A + 0.1),
    "sub": (lambda k, a, b, c: a - b, lambda: A - B),
    "sub from a number": (lambda k, a, b, c: 0.1 - a, lambda: 0.1 - A),
    "mul": (lambda k, a, b, c: a * b, lambda: A * B),
    "div": (lambda k, a, b, c: a / (k.call("fabs", b) + 1.0), lambda: A / (np.abs(B) + 1.0)),
    "larger": (lambda k, a, b, c: k.larger(a, b), lambda: np.fmax(A, B)),
    "smaller": (lambda k, a, b, c: k.smaller(a, b), lambda: np.fmin(A, B)),
    "floor": (lambda k, a, b, c: k.call("floor", a), lambda: np.floor(A)),
    "rint": (lambda k, a, b, c: k.call("rint", a), lambda: np.rint(A)),
    "trunc": (lambda k, a, b, c: k.call("trunc", a), lambda: np.trunc(A)),
    "fabs": (lambda k, a, b, c: k.call("fabs", a), lambda: np.abs(A)),
    "sqrt": (lambda k, a, b, c: k.call("sqrt", k.call("fabs", a)), lambda: np.sqrt(np.abs(A))),
    "copysign": (lambda k, a, b, c: k.call("copysign", a, b), lambda: np.copysign(A, B)),
    "<": (lambda k, a, b, c: k.choose(a < b, a, c), lambda: np.where(A < B, A, C)),
    ">": (lambda k, a, b, c: k.choose(a > b, a, c), lambda: np.where(A > B, A, C)),
    "<=": (lambda k, a, b, c: k.choose(a <= b, a, c), lambda: np.where(A <= B, A, C)),
    ">=": (lambda k, a, b, c: k.choose(a >= b, a, c), lambda: np.where(A >= B, A, C)),
    "equals": (lambda k, a, b, c: k.choose(k.call("rint", a).equals(a), a, c),
               lambda: np.where(np.rint(A) == A, A, C)),
    "and": (lambda k, a, b, c: k.choose((a < b) & (b < c), 1.0, 0.0),
            lambda: ((A < B) & (B < C)).astype(float)),
    "or": (lambda k, a, b, c: k.choose((a < b) | (b < c), 1.0, 0.0),
           lambda: ((A < B) | (B < C)).astype(float)),
    "not": (lambda k, a, b, c: k.choose(~(a < b), 1.0, 0.0), lambda: (~(A < B)).astype(float)),
    "number": (lambda k, a, b, c: k.number(0.3), lambda: np.full(400, 0.3)),
    "integer": (lambda k, a, b, c: k.to_number(k.integer(7)), lambda: np.full(400, 7.0)),
    "any_negative": (lambda k, a, b, c: k.choose(k.any_negative([a, b]), 1.0, 0.0),
                     lambda: (np.signbit(A) | np.signbit(B)).astype(float)),
}  # fmt: skip


@WIDTHS
@pytest.mark.parametrize("name", list(OPERATIONS))
def test_operations(name, width):
    write, expected = OPERATIONS[name]
    same(run(width, write, A, B, C), expected())


def exact(a: float, b: float, c: float) -> float:
    """Return ``a b + c``, rounded once."""
    total = Fraction(a) * Fraction(b) + Fraction(c)
    return float(total) if total else a * b + c


@WIDTHS
def test_fused_products(width):
    """It is rounded once, so it differs from a product and a sum somewhere."""
    found = run(width, lambda k, a, b, c: k.fma(a, b, c), A, B, C)
    expected = np.array([exact(*abc) for abc in zip(A, B, C, strict=True)])
    same(found, expected)
    assert (found != A * B + C).any()


@WIDTHS
def test_totals(width):
    """Without a start the first term is a product; each later one is fused."""
    found = run(width, lambda k, a, b, c: k.total([(a, b), (b, c)]), A, B, C)
    same(found, np.array([exact(b, c, a * b) for a, b, c in zip(A, B, C, strict=True)]))
    started = run(width, lambda k, a, b, c: k.total([(a, b)], c), A, B, C)
    same(started, np.array([exact(*abc) for abc in zip(A, B, C, strict=True)]))
    same(run(width, lambda k, a, b, c: k.total([]), A, B, C), np.zeros(400))


@WIDTHS
def test_nothing_that_is_not_a_number_compares(width):
    """By IEEE 754 every comparison with it is false, so that it leaves no guard."""
    nothing = np.full(8, np.nan)
    for compare in ("__lt__", "__gt__", "__le__", "__ge__", "equals"):
        found = run(
            width, lambda k, a, b, f=compare: k.choose(getattr(a, f)(b), 1.0, 0.0), nothing, A[:8]
        )
        same(found, np.zeros(8))


@WIDTHS
def test_masks_are_bits(width):
    """The first lane is the lowest bit; ``ones``, ``first_bit``, ``any`` and back again."""

    def write(code, a, b):
        bits = code.bits(a < b)
        first = code.choose(bits.equals(0), code.integer(-1), code.first_bit(bits))
        back = code.choose(code.from_bits(bits), 64.0, 0.0)
        anywhere = code.choose(code.any(a < b), code.integer(1024), code.integer(0))
        return code.to_number(code.ones(bits) * 4096 + first + anywhere) + back

    below = (A < B).reshape(-1, width)
    ones, anywhere = below.sum(axis=1), below.any(axis=1)
    first = np.where(anywhere, below.argmax(axis=1), -1)
    expected = np.repeat(4096.0 * ones + first + 1024.0 * anywhere, width) + 64.0 * (A < B)
    same(run(width, write, A, B), expected)


@WIDTHS
def test_integers_loops_and_branches(width):
    """Sums of 0 ... n - 1 by a loop with a way out, by a count with a step, and by branches."""

    def write(code, a):
        looped = code.variable(INTEGER, 0)
        turn = code.variable(INTEGER, 0)
        with code.loop() as leave:
            leave(turn.get() >= 10)
            looped.set(looped.get() + turn.get())
            turn.set(turn.get() + 1)
        counted = code.variable(INTEGER, 0)
        with code.count(0, 10, 3) as index:
            counted.set(counted.get() + index)
        chosen = code.variable(INTEGER, 0)
        with code.when(turn.get().equals(10)):
            chosen.set(chosen.get() + 1)
        with code.when_seldom(turn.get() > 10):
            chosen.set(chosen.get() + 100)
        number = looped.get() * 10_000 + counted.get() * 100 + chosen.get() - 1
        return code.to_number(number) + a

    same(run(width, write, A), 45.0 * 10_000 + 18.0 * 100 + A)


@WIDTHS
def test_memory(width):
    """Single numbers, vectors, memory of the function itself, and integers read as such."""

    def write(code, a, b):
        room = code.space(3 * width)
        code.write_lanes(room, 0, a)
        code.write_lanes(room, width, b)
        code.write(room, 2 * width, code.read(room, 0))
        first = code.splat(code.read(room, 2 * width))
        whole = code.to_integer(code.call("floor", code.read(code.place(room, width), 0)))
        return code.read_lanes(room, width) - first + code.to_number(whole)

    small = np.clip(B, -1e6, 1e6)
    firsts = np.repeat(A[::width], width)
    wholes = np.repeat(np.floor(small[::width]), width)
    same(run(width, write, A, small), small - firsts + wholes)


def test_functions_call_functions():
    """By name within a module, and by address, like a callback into Python."""
    module = ir.Module("calls")
    inner = Code(module, "inner", (POINTER,), 1, True)
    inner.write(inner.arguments[0], 0, inner.read(inner.arguments[0], 0) * 3.0)
    inner.finish()
    outer = Code(module, "outer", (POINTER, INTEGER), 1, False)
    outer.run(inner.function, outer.arguments[0])
    outer.run_address(outer.arguments[1], outer.integer(5))
    outer.finish()
    called: list[int] = []
    back = CFUNCTYPE(None, c_int64)(called.append)
    address = COMPILER.address(lambda: module, "outer")
    cell = (c_double * 1)(7.0)
    CFUNCTYPE(None, c_void_p, c_int64)(address)(addressof(cell), cast(back, c_void_p).value)
    assert (cell[0], called) == (21.0, [5])
