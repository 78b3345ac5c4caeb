"""What a calculation gives: every line with its formula, where that stands, and its value."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SizeLine:
    """One result.

    Parameters
    ----------
    name
        Unique within a sizing.
    value, unit
        SI.
    formula
        In the names of the demands and of the lines above.
    source
        Where the formula stands.
    """

    name: str
    value: float
    unit: str
    formula: str
    source: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizing:
    """The results in order, and what is suspicious about the demands."""

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
