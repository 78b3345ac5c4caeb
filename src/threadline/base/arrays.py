"""Read-only checked arrays, and a small cache for searches that need a result again."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = NDArray[np.float64]
ComplexArray: TypeAlias = NDArray[np.complex128]
IntArray: TypeAlias = NDArray[np.int64]


def read_only(values: ArrayLike, name: str, *, ndim: int) -> FloatArray:
    """Return a locked float64 array of ``values``: a copy, unless ``values`` is locked already.

    Parameters
    ----------
    values
        Anything that numpy turns into an array of finite numbers. A locked array whose bases are
        also locked is returned without copying.
    name
        Name of the array in errors.
    ndim
        The number of dimensions that the array must have.

    Raises
    ------
    ValueError
        If the number of dimensions differs or a value is not finite.
    """
    array = _taken(values, np.float64)
    _check_ndim(array.ndim, name, ndim)
    if not np.isfinite(array).all():
        index = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"{name} must be finite, found {array[tuple(index)]!r} at index {index}")
    array.flags.writeable = False
    return array


def real_numbers(values: ArrayLike) -> FloatArray:
    """Return a fresh float64 array of ``values``, which must be real numbers already.

    Raises
    ------
    TypeError, ValueError
        If the values are texts, complex, None, masked or beyond the range of floats, or if they are
        rows of unequal length.
    """
    if _is_masked(values):
        raise TypeError("masked values are not real numbers")
    array = np.asarray(values)
    if array.dtype.kind not in "biufO":
        raise TypeError(f"{array.dtype} are not real numbers")
    if array.dtype.kind == "O" and any(
        value is None or isinstance(value, str) for value in array.flat
    ):
        raise TypeError("texts, or nothing, are not real numbers")
    try:
        return np.array(array, dtype=np.float64)
    except OverflowError as error:
        raise ValueError("a whole number is beyond the range of floats") from error


def _is_masked(values: object) -> bool:
    """Return whether a mask hides a value; numpy would drop the mask without a warning."""
    if isinstance(values, list | tuple):
        return any(_is_masked(value) for value in values if not isinstance(value, float | int))
    return np.ma.is_masked(values)


def read_only_int(values: ArrayLike, name: str, *, ndim: int) -> IntArray:
    """Return a locked int64 array as ``read_only`` does; fractions are refused, not truncated.

    Raises
    ------
    ValueError
        If the number of dimensions differs or a value is not a whole number.
    """
    source = np.asarray(values)
    if source.size and source.dtype.kind not in "iu":
        raise ValueError(f"{name} must hold whole numbers, got {source.dtype}")
    array = _taken(source, np.int64)
    _check_ndim(array.ndim, name, ndim)
    array.flags.writeable = False
    return array


def _taken(values: ArrayLike, dtype: type[Any]) -> NDArray[Any]:
    """Return a copy of ``values``, or ``values`` if they and all their bases are locked."""
    if type(values) is np.ndarray and values.dtype == dtype and values.flags.c_contiguous:
        base: Any = values
        while isinstance(base, np.ndarray) and not base.flags.writeable:
            base = base.base
        if base is None:
            return values
    return np.array(values, dtype=dtype)


def largest_of_axes(values: FloatArray) -> FloatArray:
    """Return the largest value of each row, shape (n,), of ``values``, shape (n, axes).

    The loop runs over the axes because numpy is slow along a short inner dimension.
    """
    largest: FloatArray = values[:, 0]
    for axis in range(1, values.shape[1]):
        largest = np.maximum(largest, values[:, axis])
    return largest


def _check_ndim(ndim: int, name: str, expected: int) -> None:
    if ndim != expected:
        raise ValueError(f"{name} must have {expected} dimension(s), got {ndim}")


class Locked:
    """Base of frozen dataclasses with read-only arrays, whose unpickled copies are also read-only.

    Pickling an array drops its read-only flag; unpickling one of these classes sets it again.
    """

    __slots__ = ()

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        names = [field.name for field in fields(self)]  # type: ignore[arg-type]
        return _locked, (type(self), {name: getattr(self, name) for name in names})


def _locked(cls: type[Any], state: Mapping[str, Any]) -> Any:
    """Return an object of ``cls`` with the attributes of ``state``, every array locked."""
    restored = object.__new__(cls)
    for name, value in state.items():
        for array in value.values() if isinstance(value, Mapping) else (value,):
            if isinstance(array, np.ndarray):
                array.flags.writeable = False
        object.__setattr__(restored, name, value)
    return restored


def finite(value: float | None) -> float | None:
    """Return ``value``, or None if it is not finite: JSON cannot express infinity or NaN."""
    return value if value is not None and math.isfinite(value) else None


K = TypeVar("K")
V = TypeVar("V")


class Recent(Generic[K, V]):
    """A cache of the last results, each with its key.

    Threads that use it at the same time may lose an entry and compute it again.

    Parameters
    ----------
    most
        Number of entries kept.
    alike
        Returns whether two keys give the same result.
    """

    def __init__(self, most: int, alike: Callable[[K, K], bool]) -> None:
        self._most, self._alike = most, alike
        self._known: tuple[tuple[K, V], ...] = ()

    def of(self, key: K, make: Callable[[], V]) -> V:
        """Return the cached result for ``key`` or a key like it, else the result of ``make``."""
        for known_key, result in self._known:
            if self._alike(known_key, key):
                return result
        result = make()
        self._known = ((key, result), *self._known[: self._most - 1])
        return result
