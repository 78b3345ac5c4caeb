"""Arrays that cannot be changed after a frozen dataclass has taken them."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.base.arrays import read_only, read_only_int


@pytest.mark.parametrize("lock", [read_only, read_only_int])
def test_a_copy_is_locked(lock) -> None:
    source = np.array([1, 2, 3])
    kept = lock(source, "kept", ndim=1)
    source[0] = 99
    assert kept.tolist() == [1, 2, 3]
    with pytest.raises(ValueError, match="read-only"):
        kept[0] = 5


@pytest.mark.parametrize("lock", [read_only, read_only_int])
def test_locked_array_is_not_copied_again(lock) -> None:
    """A block cut out of a locked array shares its memory; a view of a writable one does not."""
    whole = lock([1, 2, 3, 4], "whole", ndim=1)
    assert np.shares_memory(lock(whole[1:3], "part", ndim=1), whole)
    source = np.array([1, 2, 3, 4], dtype=whole.dtype)
    view = source[1:3]
    view.flags.writeable = False
    kept = lock(view, "kept", ndim=1)
    source[:] = 99
    assert kept.tolist() == [2, 3]
    stretched = np.broadcast_to(whole[:1], (3,))  # read-only, but not contiguous
    assert lock(stretched, "stretched", ndim=1).strides == whole.strides


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_the_place_of_a_number_that_is_not_finite_is_told(bad: float) -> None:
    with pytest.raises(ValueError, match=r"speed must be finite, found .* at index \[1, 0\]"):
        read_only([[0.0, 1.0], [bad, 2.0]], "speed", ndim=2)


def test_dimensions_are_checked() -> None:
    with pytest.raises(ValueError, match=r"speed must have 2 dimension\(s\), got 1"):
        read_only([1.0], "speed", ndim=2)
    with pytest.raises(ValueError, match=r"speed must have 1 dimension\(s\), got 0"):
        read_only_int(3, "speed", ndim=1)


def test_fractions_are_not_cut_off() -> None:
    with pytest.raises(ValueError, match="counts must hold whole numbers, got float64"):
        read_only_int([1.0, 2.5], "counts", ndim=1)
    assert read_only_int([], "counts", ndim=1).dtype == np.int64
    assert read_only_int(np.array([1], dtype=np.uint8), "counts", ndim=1).dtype == np.int64
