"""Commands of one cylinder, compared with an integrator and with the time-optimal equation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tools.second_search import left, second

from threadline.commands.schedule_moves import AT_ONCE
from threadline.motion.shaping.onoff.flow_search import FlowMove, shortest_flow_command
from threadline.motion.shaping.onoff.switched import Valves
from threadline.search.move_commands import gapped, residual_ringing, stepped, time_optimal_s

SCAN_S = 0.01
POLE = -0.15 + 18.3j
TURN = complex(np.exp(POLE * SCAN_S))


def integrated(ticks: tuple[int, ...], levels: tuple[float, ...]) -> float:
    """Return the amplitude after a command by DOP853, relative to the amplitude of one step.

    q'' - 2 Re(p) q' + |p|^2 q = |p|^2 u: q rests at u, and a step leaves an envelope that the same
    equation gives; both envelopes are computed from q - u and its rate.
    """

    def rates(u: float) -> Any:
        return lambda _, x: [x[1], abs(POLE) ** 2 * (u - x[0]) + 2.0 * POLE.real * x[1]]

    def envelope(state: np.ndarray, u: float) -> float:
        away, rate = state[0] - u, state[1]
        return float(np.hypot(away, (rate - POLE.real * away) / POLE.imag))

    state = np.zeros(2)
    for begin, end, level in zip(ticks, ticks[1:], levels, strict=False):
        span = (0.0, (end - begin) * SCAN_S)
        done = solve_ivp(rates(level), span, state, "DOP853", rtol=1e-11, atol=1e-13)
        state = done.y[:, -1]
    return envelope(state, levels[-1]) / envelope(np.zeros(2), 1.0)


@pytest.mark.parametrize(
    ("ticks", "levels"),
    [
        ((0, 47), (1.0, 0.0)),
        ((0, 11, 15, 42, 48, 57), (1.0, 0.0, 1.0, 0.0, 1.0, 0.0)),
        ((0, 14, 50, 64), (0.63, 1.0, 0.37, 0.0)),
    ],
)
def test_closed_form_is_what_an_integrator_finds(
    ticks: tuple[int, ...], levels: tuple[float, ...]
) -> None:
    assert abs(residual_ringing(ticks, levels, TURN, AT_ONCE)) == pytest.approx(
        integrated(ticks, levels), abs=1e-8
    )


def test_candidates_cover_the_distance_and_keep_the_dwell() -> None:
    made = [
        *gapped(47, 2, TURN, 0.1, 10, AT_ONCE),
        *stepped(47, 2, TURN, 0.1, [(0.507, 0.493)], AT_ONCE),
    ]
    assert {c.levels[0] for c in made} == {1.0, 0.507}
    for command in made:
        spans = np.diff(command.ticks)
        assert spans.min() >= 2
        assert float(spans @ command.levels[:-1]) == pytest.approx(47.0, abs=1e-9)
        assert abs(command.left) <= 0.1
        assert command.left == pytest.approx(
            residual_ringing(command.ticks, command.levels, TURN, AT_ONCE), abs=1e-12
        )


def symmetric(on_s: float, omega: float) -> float:
    """Return the shortest duration of on, gap, on, gap, on that leaves an undamped mode at rest.

    About the middle the ringing has one quadrature: sin(w T/2) - sin(w (b/2 + g)) + sin(w b/2) = 0
    with b the middle stretch and g a gap, T = on + 2 g. Every b is tried, with its first root g.
    """
    best = np.inf
    for b in np.linspace(0.02, 0.98, 400) * on_s:
        g = np.linspace(0.0, 0.5 * np.pi / omega, 4000)
        left = np.sin(0.5 * omega * on_s + omega * g) - np.sin(omega * (0.5 * b + g))
        left += np.sin(0.5 * omega * b)
        crossed = np.flatnonzero(np.diff(np.sign(left)) != 0)
        if len(crossed):
            best = min(best, on_s + 2.0 * float(g[crossed[0]]))
    return best


def test_time_optimal_commands() -> None:
    """An undamped mode that is excited for whole periods is at rest afterwards: nothing is faster.

    Otherwise the optimum switches, symmetric about its middle as undamped optima are; its own
    equation gives it here. The grid of the program is 1/800 of the duration: 2 ms with margin.
    """
    omega = 18.3
    period_s = 2.0 * np.pi / omega
    assert time_optimal_s(2.0 * period_s, omega * 1j) == pytest.approx(2.0 * period_s, abs=1e-9)
    for on_s in (0.47, 0.5, 1.5 * period_s):
        assert time_optimal_s(on_s, omega * 1j) == pytest.approx(symmetric(on_s, omega), abs=2e-3)


def test_every_tenth_scan_of_a_quick_controller_is_looked_at() -> None:
    """The commands are the same as with a scan ten times as long, in ten times as many scans."""
    coarse = gapped(47, 2, TURN, 0.1, 10, AT_ONCE)
    fine = gapped(470, 20, TURN**0.1, 0.1, 100, AT_ONCE, step=10)
    assert [tuple(10 * t for t in c.ticks) for c in coarse] == [c.ticks for c in fine]
    assert coarse


@pytest.mark.long(shown_by="test_time_optimal_commands")
def test_a_second_search_finds_nothing_shorter() -> None:
    """An independent integer program proves that a command one scan shorter is impossible."""
    turns = np.exp(np.array([-0.3 + 48.0j, -0.3 + 57.0j, -0.3 + 66.0j]) * SCAN_S)
    move = FlowMove(
        on_scans=14.0,
        valves=Valves(flows=(0.63, 0.37)),
        dwell_scans=2,
        turns=turns,
        most=np.full(3, 0.25),
    )
    ours = shortest_flow_command(move, 10, 40)
    assert ours is not None
    assert second(move, ours.scans - 1, 60.0)[0] == "impossible"
    what, levels = second(move, ours.scans, 60.0)
    assert what == "found"
    assert left(move, levels) <= 1.0
    assert sum(levels) == pytest.approx(14.0, abs=0.2)
