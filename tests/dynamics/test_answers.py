"""The response of a load to the references of its loop, compared with numpy's direct sum."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.dynamics.responses import Answer


@pytest.mark.parametrize("taps", [1, 2, 7, 300])
@pytest.mark.parametrize("references", [1, 2, 100, 5000])
def test_a_load_is_at_the_sum_of_what_its_references_leave(references: int, taps: int) -> None:
    drawn = np.random.default_rng(references + taps)
    response = drawn.normal(size=taps)
    response /= response.sum()
    reference = 0.3 + np.cumsum(drawn.normal(size=references))
    at_rest = np.concatenate((np.full(taps - 1, reference[0]), reference))
    loads = Answer(axis="X", period_s=1e-3, taps=response).load(reference)
    # A transform rounds by the largest value: both are of order 100.
    assert loads == pytest.approx(
        np.convolve(at_rest, response, "valid"), abs=1e-12 * abs(response).sum() * 100
    )
