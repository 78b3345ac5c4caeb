"""Results of a sizing: each with its value, its formula and the source of the formula."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SizeLine:
    """One result.

    Parameters
    ----------
    name
        Name of the result, unique within a sizing.
    value, unit
        In SI; the unit is empty for a ratio.
    formula
        Written with the names of the demands and of earlier results.
    source
        Thesis, paper or field that the formula is from.
    """

    name: str
    value: float
    unit: str
    formula: str
    source: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizing:
    """The results in order, and warnings about suspicious demands."""

    lines: tuple[SizeLine, ...]
    warnings: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> SizeLine:
        """Return the line called ``name``; a KeyError lists those that there are."""
        for line in self.lines:
            if line.name == name:
                return line
        raise KeyError(f"no line {name!r}; there are {', '.join(x.name for x in self.lines)}")

    def __contains__(self, name: object) -> bool:
        return any(line.name == name for line in self.lines)
