"""A PLC that runs what ``scan_language`` has read: standard timers, one scan after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from threadline.readback.scan_language import (
    FIRST_VALUES,
    TIMER,
    Declared,
    Statement,
    Unit,
    Variables,
)
from threadline.readback.scan_words import ScanError

_DEEPEST = 8  # blocks in one another; a sequence has two


class OnDelay:
    """The on-delay timer TON of IEC 61131-3, in microseconds."""

    def __init__(self) -> None:
        self.values: Variables = {"in": False, "pt": 0, "q": False, "et": 0}
        self._since_us: int | None = None

    def call(self, pins: Variables, now_us: int) -> None:
        """Run it once, with new values of its inputs."""
        values = self.values
        values.update(pins)
        if not values["in"]:
            self._since_us = None
            values["q"], values["et"] = False, 0
            return
        if self._since_us is None:
            self._since_us = now_us
        elapsed = now_us - self._since_us
        values["q"] = elapsed >= values["pt"]
        values["et"] = min(elapsed, values["pt"])


class Instance:
    """A function block, or the program, with its own variables."""

    def __init__(
        self, unit: Unit, units: Mapping[str, Unit], around: tuple[Unit, ...] = ()
    ) -> None:
        if unit.body is None:
            raise ScanError(f"{unit.name} has no body")
        self._body: Statement = unit.body
        self.values: Variables = {}
        for name, declared in unit.declared.items():
            self.values[name] = _first(declared, units, (*around, unit))

    def call(self, pins: Variables, now_us: int) -> None:
        """Run it once, with new values of its inputs."""
        self.values.update(pins)
        self._body(self.values, now_us)


def _first(declared: Declared, units: Mapping[str, Unit], around: tuple[Unit, ...]) -> object:
    if declared.type == TIMER:
        return OnDelay()
    if declared.type in units:
        if units[declared.type] in around:
            raise ScanError(f"{declared.name} is of a block that has it inside itself")
        if len(around) > _DEEPEST:
            raise ScanError(f"blocks stand more than {_DEEPEST} deep in one another")
        return Instance(units[declared.type], units, around)
    if declared.type not in FIRST_VALUES:
        raise ScanError(f"{declared.name} is of the unknown type {declared.type.upper()}")
    return FIRST_VALUES[declared.type] if declared.initial is None else declared.initial


class Controller:
    """The one program of a text: inputs in, outputs out.

    Parameters
    ----------
    units
        Programs and function blocks of the text.
    addresses
        Address by name of the program's variables; the text's own if not given.

    Raises
    ------
    ScanError
        If there is not one program, or a type is unknown.
    """

    def __init__(self, units: Sequence[Unit], addresses: Mapping[str, str] | None = None) -> None:
        programs = [unit for unit in units if unit.kind == "program"]
        if len(programs) != 1:
            raise ScanError(f"it has {len(programs)} programs, and 1 is expected")
        by_name = {unit.name: unit for unit in units}
        if len(by_name) != len(units):
            raise ScanError("two of its units have one name")
        own = {name: one.address for name, one in programs[0].declared.items()}
        located = {**own, **(addresses or {})}
        self.addresses = {at: name for name, at in located.items() if at}
        self._instance = Instance(programs[0], by_name)

    def scan(self, inputs: Mapping[str, bool], now_us: int) -> Callable[[str], bool]:
        """Run one scan at ``now_us``; return a function from an address to its state then.

        Parameters
        ----------
        inputs
            State by name of a variable of the program.

        Raises
        ------
        ScanError
            If the program cannot go on.
        """
        try:
            self._instance.call(dict(inputs), now_us)
        except (
            ArithmeticError, AttributeError, KeyError, MemoryError, RecursionError, TypeError,
        ) as error:  # fmt: skip
            text = f"{type(error).__name__} {error}"
            raise ScanError(f"the program cannot go on: {text}") from error
        values = self._instance.values
        return lambda address: bool(values[self.addresses[address]])
