"""The loss of a DAC at a reversal, and rounding that is no reversal."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.dynamics.loop_ticks import acting


@pytest.mark.parametrize("rounded", [-2.8e-17, 0.0, 2.8e-17])
def test_a_level_of_rest_has_no_sign(rounded: float) -> None:
    """On one processor it is -2.8e-17 V, on another 0: the next tick is no reversal."""
    acts = acting(np.array([rounded, 3.5, 2.0, rounded, -0.2, -0.3]))
    assert acts == pytest.approx([0.0, 3.5, 2.0, 0.0, -0.2, -0.3], abs=1e-12)


def test_the_first_tick_after_a_reversal_is_lost() -> None:
    acts = acting(np.array([0.4, -0.1, -0.3, 0.2, -0.2]))
    assert acts.tolist() == [0.4, 0.0, -0.3, 0.0, -0.2]
