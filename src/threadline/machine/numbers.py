"""Numbers of a machine by their dotted names: read, and replaced."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from fractions import Fraction
from functools import cache
from typing import Any, get_args, get_type_hints

from threadline.errors import OptionError
from threadline.escaping import toml_string
from threadline.machine.model import Machine
from threadline.machine.quantity import Quantity, Units

_PER_SECOND = 10**9


def number_at(machine: Machine, path: str) -> Quantity:
    """Return the number of ``machine`` called ``path``, such as ``"links.x_belt.stiffness"``.

    Raises
    ------
    OptionError
        If the machine has no such number.
    """
    node: Any = machine
    for key in path.split("."):
        node = node.get(key) if isinstance(node, Mapping) else getattr(node, key, None)
    if not isinstance(node, Quantity):
        raise OptionError(
            f"machine {machine.name!r} has no number {path!r}",
            remedy="Name one that its file gives.",
        )
    return node


def number_tables(texts: Mapping[str, str]) -> list[str]:
    r"""Return the lines of a machine file that set numbers, in tables that a blank line begins.

    Parameters
    ----------
    texts
        Path of each number, as ``number_at`` takes it, to its text with unit and tolerance.

    Examples
    --------
    >>> print(*number_tables({"bodies.x.inertia": "2 kg exact, assumed"}), sep="\n")
    <BLANKLINE>
    [bodies.x]
    inertia = "2 kg exact, assumed"
    """
    tables: dict[str, list[str]] = {}
    for path, text in texts.items():
        table, _, key = path.rpartition(".")
        tables.setdefault(table, []).append(f"{key} = {toml_string(text)}")
    return [line for table, rows in sorted(tables.items()) for line in ("", f"[{table}]", *rows)]


def is_whole(machine: Machine, path: str) -> bool:
    """Return whether a number must be a whole one, such as the bits of a converter."""
    node: Any = machine
    *above, last = path.split(".")
    for key in above:
        node = node.get(key) if isinstance(node, Mapping) else getattr(node, key, None)
    if isinstance(node, Mapping) or node is None:
        return False
    kind: Any = type(node)  # mypy takes a type for what cannot be hashed
    return last in _whole_numbers(kind)


@cache
def _whole_numbers(kind: Any) -> frozenset[str]:
    """Return the keys of a part of a machine that are whole numbers."""
    marked = get_type_hints(kind, include_extras=True)  # some ms: the text of every type is read
    return frozenset(
        key
        for key, hint in marked.items()
        if any(isinstance(mark, Units) and mark.whole for mark in get_args(hint))
    )


def with_numbers(machine: Machine, numbers: Mapping[str, float]) -> Machine:
    """Return ``machine`` with other numbers (in SI, by their dotted names) and a hash of its own.

    Tolerances stay the same share of the value. A time is converted to an exact fraction of a
    second, within 1e-18 s.

    Raises
    ------
    OptionError
        If the machine has no such number.
    """
    new: dict[str, Any] = {}
    for path, value in numbers.items():
        old = number_at(machine, path)
        share = 1.0 if old.si == 0.0 else abs(value / old.si)
        exact = None if old.exact_s is None else exact_time_s(value)
        *parents, last = path.split(".")
        below = new
        for key in parents:
            below = below.setdefault(key, {})
        below[last] = dataclasses.replace(
            old,
            si=float(value),
            tolerance_si=old.tolerance_si * share,
            exact_s=exact,
        )
    note = repr(sorted((path, float(value)) for path, value in numbers.items()))
    new["sha256"] = hashlib.sha256((machine.sha256 + note).encode()).hexdigest()
    # At once: of two numbers that hold together, one alone may be refused.
    made: Machine = _replaced(machine, new)
    return made


def exact_time_s(seconds: float) -> Fraction:
    """Return a time in s as a fraction with a denominator of at most 1e9."""
    return Fraction(float(seconds)).limit_denominator(_PER_SECOND)


def _replaced(node: Any, new: Mapping[str, Any]) -> Any:
    named = isinstance(node, Mapping)
    made = {}
    for key, value in new.items():
        below = node[key] if named else getattr(node, key)
        made[key] = _replaced(below, value) if isinstance(value, Mapping) else value
    return {**node, **made} if named else dataclasses.replace(node, **made)
