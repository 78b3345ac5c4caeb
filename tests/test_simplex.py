"""Small dense linear programs: the next method if one gives no answer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import optimize

from threadline.base.linear_programs import solved

COST = np.array([1.0, 2.0])
BELOW = (-np.ones((1, 2)), [-3.0])


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, bool]]:
    """Make named methods fail; list the methods that were called."""
    methods: list[tuple[str, bool]] = []
    linprog = optimize.linprog

    def solve(*args: Any, method: str, options: Any, **rest: Any) -> optimize.OptimizeResult:
        methods.append((method, options.get("presolve", True)))
        status = STATUS.get(method)
        if status is not None:
            return optimize.OptimizeResult(x=None, fun=None, status=status, message="")
        return linprog(*args, method=method, options=options, **rest)

    monkeypatch.setattr(optimize, "linprog", solve)
    return methods


STATUS: dict[str, int] = {}


@pytest.mark.parametrize(
    ("failing", "seconds", "moves"),
    [
        ({}, None, ["highs-ds"]),
        ({"highs-ds": 4}, None, ["highs-ds", "highs"]),
        ({"highs-ds": 1}, 30.0, ["highs-ds", "highs-ipm"]),
        ({"highs-ds": 4, "highs": 1}, 30.0, ["highs-ds", "highs", "highs-ipm"]),
    ],
)
def test_another_way_is_asked_where_one_has_no_answer(
    asked: list[tuple[str, bool]],
    monkeypatch: pytest.MonkeyPatch,
    failing: dict[str, int],
    seconds: float | None,
    moves: list[str],
) -> None:
    for method, status in failing.items():
        monkeypatch.setitem(STATUS, method, status)
    found = solved(COST, below=BELOW, bounds=(0.0, None), seconds=seconds)
    assert asked == [(way, way != "highs-ds") for way in moves]
    assert found.x == pytest.approx([3.0, 0.0])


def test_infeasible_program_returns_its_status(asked: list[tuple[str, bool]]) -> None:
    found = solved(COST, equal=(np.ones((1, 2)), [3.0]), below=BELOW, bounds=(0.0, 1.0))
    assert found.status == 2 and asked == [("highs-ds", False)]
