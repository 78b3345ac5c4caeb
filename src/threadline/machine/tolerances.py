"""The ``[tolerances]`` table of a machine file, and the numbers that it names.

``+-`` is the half width of the interval that holds a number. Unless this table says otherwise,
numbers are distributed uniformly over their intervals and independent of each other.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from fnmatch import fnmatchcase
from typing import Annotated, Any

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.parts import STRICT
from threadline.machine.quantity import Quantity

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")]
NumberPattern = Annotated[
    str, Field(pattern=r"^[A-Za-z_]+(\.(\*|[A-Za-z0-9_-]+))+$", max_length=200)
]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Tolerances:
    """How the numbers of a machine vary within their ``+-``.

    Numbers are named by their dotted names in the file, such as ``"links.x_belt.stiffness"``; ``*``
    stands for any text in a name.

    Parameters
    ----------
    normal
        Numbers that are distributed normally: ``+-`` is two standard deviations.
    exclude
        Numbers that do not vary.
    groups
        Numbers that vary together, all at the same place in their tolerances.
    """

    normal: tuple[NumberPattern, ...] = ()
    exclude: tuple[NumberPattern, ...] = ()
    groups: dict[Name, tuple[NumberPattern, ...]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _each_in_one_group(self) -> Tolerances:
        for name, members in self.groups.items():
            if not members:
                raise ValueError(f"groups.{name}: a group without numbers moves nothing")
        return self

    def named(self) -> Iterator[tuple[str, str]]:
        """Yield the key of each pattern in the file, and the pattern."""
        for key, patterns in (("normal", self.normal), ("exclude", self.exclude)):
            yield from ((f"tolerances.{key}", pattern) for pattern in patterns)
        for name, members in self.groups.items():
            yield from ((f"tolerances.groups.{name}", pattern) for pattern in members)


def matches(path: str, patterns: tuple[str, ...]) -> bool:
    """Return whether one of ``patterns`` names the number ``path``."""
    return any(fnmatchcase(path, pattern) for pattern in patterns)


def check_named(tolerances: Tolerances, paths: Sequence[str]) -> None:
    """Refuse patterns that name none of the numbers ``paths``, and a number in two groups.

    Raises
    ------
    ValueError
        Beginning with the key in the file.
    """
    for where, pattern in tolerances.named():
        if not any(matches(path, (pattern,)) for path in paths):
            close = difflib.get_close_matches(pattern, paths, n=1)
            hint = f"did you mean {close[0]!r}?" if close else "name it by its place in the file."
            raise ValueError(f"{where} names the number {pattern!r}, which does not exist; {hint}")
    taken: dict[str, str] = {}
    for name, members in tolerances.groups.items():
        for path in (path for path in paths if matches(path, members)):
            if path in taken:
                raise ValueError(
                    f"tolerances.groups.{name}: {path} is in the group {taken[path]!r} already"
                )
            taken[path] = name


def quantities(part: Any, path: str = "") -> Iterator[tuple[str, Quantity]]:
    """Yield every number below ``part`` with its dotted name, in the order of the file's parts."""
    if isinstance(part, Quantity):
        yield path, part
    elif isinstance(part, Mapping):
        for key, value in part.items():
            yield from quantities(value, f"{path}.{key}" if path else str(key))
    elif isinstance(part, tuple):
        for index, value in enumerate(part):
            yield from quantities(value, f"{path}.{index}")
    elif is_dataclass(part):
        for field in fields(part):
            where = f"{path}.{field.name}" if path else field.name
            yield from quantities(getattr(part, field.name), where)
