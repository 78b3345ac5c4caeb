"""The cases of the benchmarks still run; ``make bench`` gives their results."""

from __future__ import annotations

import importlib
import pkgutil

import benchmarks
import pytest
from benchmarks._twin_cases import CASES
from benchmarks._twin_peers import scipy_run
from benchmarks.twin import WITHIN_UM, difference_um


@pytest.mark.parametrize("name", [one.name for one in pkgutil.iter_modules(benchmarks.__path__)])
def test_every_module_is_read_where_no_peer_is_installed(name: str) -> None:
    module = importlib.import_module(f"benchmarks.{name}")
    assert name.startswith("_") or callable(module.run)


@pytest.mark.parametrize("case", CASES)
def test_the_axis_of_the_twin_moves_as_scipy_integrates_it(case: str) -> None:
    """Two reversals of the axis, with the bound that the benchmark itself states."""
    assert difference_um(case, scipy_run(case, 420, quantised=False)) < WITHIN_UM
