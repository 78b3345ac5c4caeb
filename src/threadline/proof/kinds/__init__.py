"""The table of kinds of work: how each kind plans, simulates, varies, measures and writes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module

from threadline.files import Commands, StepPlay, SwitchSchedule, TickTable
from threadline.machine import Machine
from threadline.proof.kinds.kind import Kind

_COMMANDS: dict[str, type[Commands]] = {
    "ticks": TickTable,
    "switches": SwitchSchedule,
    "steps": StepPlay,
}


class _Kinds(Mapping[str, Kind]):
    """The rows by their name; the module of a row is imported when the row is first read."""

    def __getitem__(self, name: str) -> Kind:
        if name not in _COMMANDS:
            raise KeyError(name)
        found: Kind = import_module(f"{__name__}.{name}").KIND
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(_COMMANDS)

    def __len__(self) -> int:
        return len(_COMMANDS)


KINDS: Mapping[str, Kind] = _Kinds()
"""Every kind of work, by its value of ``Machine.commanded_by``."""


def kind_of(machine: Machine) -> Kind:
    """Return the kind of work that a machine does."""
    return KINDS[machine.commanded_by]


def kind_of_commands(commands: Commands) -> Kind:
    """Return the kind of work that commands belong to."""
    return next(KINDS[name] for name, taken in _COMMANDS.items() if isinstance(commands, taken))


__all__ = ["KINDS", "Kind", "kind_of", "kind_of_commands"]
