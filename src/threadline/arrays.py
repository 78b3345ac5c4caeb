"""Read-only checked arrays: what a frozen dataclass needs to be frozen indeed."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]


def read_only(values: ArrayLike, name: str, *, ndim: int) -> FloatArray:
    """Return a locked float64 copy of ``values``.

    Parameters
    ----------
    values
        Anything that numpy turns into an array of finite numbers.
    name
        Named in the error.
    ndim
        The number of dimensions that the array must have.

    Raises
    ------
    ValueError
        If the number of dimensions differs or a value is not finite.
    """
    array = np.array(values, dtype=np.float64)
    _check_ndim(array.ndim, name, ndim)
    if not np.isfinite(array).all():
        at = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"{name} must be finite, found {array[tuple(at)]!r} at index {at}")
    array.flags.writeable = False
    return array


def read_only_int(values: ArrayLike, name: str, *, ndim: int) -> IntArray:
    """Return a locked int64 copy of ``values``; refuse fractions instead of truncating them.

    Raises
    ------
    ValueError
        If the number of dimensions differs or a value is not a whole number.
    """
    source = np.asarray(values)
    if source.size and not np.issubdtype(source.dtype, np.integer):
        raise ValueError(f"{name} must hold whole numbers, got {source.dtype}")
    array = np.array(source, dtype=np.int64)
    _check_ndim(array.ndim, name, ndim)
    array.flags.writeable = False
    return array


def _check_ndim(found: int, name: str, wanted: int) -> None:
    if found != wanted:
        raise ValueError(f"{name} must have {wanted} dimension(s), got {found}")
