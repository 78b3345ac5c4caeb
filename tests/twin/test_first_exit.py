"""The first exit of a guard, compared with a dense scan of the same function.

Guards within a cell are sums of exponentials whose rates times the cell are at most a half, given
to the search by Taylor's series; here they are scanned at 4001 points as exponentials. Bounds are
just reached, just missed, and crossed.
"""

from __future__ import annotations

from ctypes import CFUNCTYPE, c_int64, c_void_p
from math import ceil, factorial
from types import SimpleNamespace

import numpy as np
import pytest
from llvmlite import ir
from scipy.optimize import brentq

from threadline.twin.kernel.code import INTEGER, POINTER, Code
from threadline.twin.kernel.compiler import Compiler
from threadline.twin.kernel.exits import write_first_exit
from threadline.twin.kernel.names import Exit

COMPILER = Compiler()
RATE = 0.5  # largest rate times the length of a cell
TERMS = next(k for k in range(4, 40) if RATE ** (k + 1) / factorial(k + 1) < 1e-17)
SECTIONS = ceil(RATE / 0.3)
HIDDEN = 1.0 / 100.0
"""An excursion out and back that is larger than this share of the fourth derivative is seen."""


def search(width: int, monotone: bool):
    """Return the search as a function of (cases, terms + 1), low, high and until."""
    layout = SimpleNamespace(shape=SimpleNamespace(width=width, terms=TERMS, sections=SECTIONS))
    module = ir.Module("exit")
    function = write_first_exit(module, layout, monotone)
    code = Code(module, "run", (INTEGER, POINTER, POINTER, INTEGER), width, False)
    groups, poly, more, mask = code.arguments
    with code.count(0, groups) as at:
        code.run(
            function,
            code.place(poly, at * ((TERMS + 1) * width)),
            code.place(more, at * (len(Exit) * width)),
            mask,
        )
    code.finish()
    address = COMPILER.address(lambda: module, "run")
    run = CFUNCTYPE(None, c_int64, c_void_p, c_void_p, c_int64)(address)

    def found(series, low, high, until, lanes=(1 << width) - 1):
        def packed(rows):
            return np.ascontiguousarray(
                np.stack(rows, axis=1).reshape(-1, width, len(rows)).transpose(0, 2, 1)
            )

        poly = packed(list(np.asarray(series).T))
        more = packed([low, high, until, np.full(len(low), np.nan)])
        run(len(poly), poly.ctypes.data, more.ctypes.data, lanes)
        flat = more.transpose(0, 2, 1).reshape(-1, len(Exit))
        return flat[:, Exit.UNTIL], flat[:, Exit.SIDE]

    return found


class Guards:
    """Random sums of exponentials on [0, 1], real and complex, and their Taylor series."""

    def __init__(self, count: int, seed: int, monotone: bool) -> None:
        random = np.random.default_rng(seed)
        size = random.uniform(0.05, 1.0, (count, 3)) * RATE
        angle = random.uniform(-np.pi, np.pi, (count, 3)) * (random.random((count, 3)) < 0.7)
        phase = np.exp(1j * random.uniform(-np.pi, np.pi, (count, 3)))
        self.rates = -size * np.exp(1j * angle)
        self.weights = random.normal(size=(count, 3)) * phase
        if monotone:
            # One real exponential is monotone, whatever its rate.
            self.rates, self.weights = self.rates.real + 0j, self.weights.real + 0j
            self.weights[:, 1:] = 0.0
        k = np.arange(TERMS + 1)
        self.series = np.real(self.weights[:, :, None] * self.rates[:, :, None] ** k).sum(
            axis=1
        ) / [factorial(int(i)) for i in k]
        self.grid = np.linspace(0.0, 1.0, 2001)
        waves = np.exp(self.rates[:, :, None] * self.grid)
        self.values = np.real(self.weights[:, :, None] * waves).sum(axis=1)
        self.size = np.ptp(self.values, axis=1)
        fourth = (self.weights * self.rates**4)[:, :, None] * waves[:, :, ::40]
        self.bend = np.abs(np.real(fourth).sum(axis=1)).max(axis=1)

    def at(self, i: int, s: float) -> float:
        return float(np.real(self.weights[i] * np.exp(self.rates[i] * s)).sum())


def bounds(guards: Guards, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds about the start: crossed, just reached by a millionth, just missed."""
    random = np.random.default_rng(seed)
    start, count = guards.values[:, 0], len(guards.values)
    top, bottom = guards.values.max(axis=1), guards.values.min(axis=1)
    nudge = guards.size * random.choice([1e-3, 1e-5, -1e-5, 1e-12], count)
    share = random.random(count)
    near = random.random(count) < 0.5
    high = np.where(near, top - nudge, start + share * 1.2 * (top - start))
    low = np.where(near, bottom + nudge, start + share * 1.2 * (bottom - start))
    gap = 1e-9 * guards.size
    return np.minimum(low, start - gap), np.maximum(high, start + gap)


def check_against_scan(guards, low, high, whole, found) -> int:
    """Assert the promise of the search for every case; return the number of exits."""
    until, side = found
    inside = guards.grid <= whole
    hidden = HIDDEN * whole**4 * guards.bend + 1e-12
    for i, values in enumerate(guards.values):
        beyond = np.maximum(values - high[i], low[i] - values)[inside]
        clear = np.flatnonzero(beyond > hidden[i])
        if not side[i]:
            assert until[i] == whole and not len(clear), i
            continue
        bound = high[i] if side[i] > 0 else low[i]
        assert 0.0 < until[i] <= whole, i
        assert abs(guards.at(i, until[i]) - bound) < 1e-12 * max(1.0, abs(bound)), i
        assert not len(clear) or guards.grid[clear[0]] >= until[i] - 1e-12, i
        # And no sooner than its first point outside, found by another method.
        first = int(np.argmax(beyond > 0)) if (beyond > 0).any() else len(beyond) - 1
        ends = guards.grid[max(first - 1, 0)], guards.grid[first]
        gaps = [guards.at(i, s) - bound for s in ends]
        if gaps[0] * gaps[1] < 0 and until[i] <= ends[1] + 1e-9:
            root = brentq(lambda s, i=i, b=bound: guards.at(i, s) - b, *ends, xtol=1e-15)
            steep = abs(gaps[1] - gaps[0]) / (ends[1] - ends[0])
            assert abs(until[i] - root) < 1e-12 + 1e-12 / steep, i
        assert until[i] > ends[0] - 1e-9, i
    return int(np.count_nonzero(side))


@pytest.mark.parametrize("monotone", [False, True])
@pytest.mark.parametrize(("width", "whole"), [(1, 1.0), (8, 0.6)])
def test_first_exit_is_that_of_a_dense_scan(width, whole, monotone):
    """Also for the rest of a cell: an exit after it does not count."""
    guards = Guards(1600, 5, monotone)
    low, high = bounds(guards, 6)
    found = search(width, monotone)(guards.series, low, high, np.full(len(low), whole))
    assert 300 < check_against_scan(guards, low, high, whole, found) < 1590


def test_widths_agree_to_the_bit_and_masked_lanes_stay():
    guards = Guards(800, 7, False)
    low, high = bounds(guards, 8)
    until = np.ones(len(low))
    one = search(1, False)(guards.series, low, high, until)
    eight = search(8, False)(guards.series, low, high, until)
    np.testing.assert_array_equal(one, eight)
    masked = search(8, False)(guards.series, low, high, until, lanes=0b01010101)
    odd = np.arange(len(low)) % 2 == 1
    np.testing.assert_array_equal(masked[0][odd], 1.0)
    np.testing.assert_array_equal(masked[1][odd], 0.0)
    np.testing.assert_array_equal(np.array(masked)[:, ~odd], np.array(eight)[:, ~odd])
