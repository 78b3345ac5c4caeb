"""A PLC for the tests: instances of what was read, standard timers, one scan after the other."""

from __future__ import annotations

import copy
from typing import Any

from tests.plc.reading import Code, Unit, code_of

DEFAULTS = {"BOOL": False, "INT": 0, "DINT": 0, "TIME": 0, "STRING": ""}


class Ton:
    """The on-delay timer of IEC 61131-3, microseconds."""

    def __init__(self) -> None:
        self.v: dict[str, Any] = {"in": False, "pt": 0, "q": False, "et": 0}
        self.since: int | None = None

    def call(self, pins: dict[str, Any], now: int) -> None:
        self.v.update(pins)
        if not self.v["in"]:
            self.since = None
            self.v["q"], self.v["et"] = False, 0
            return
        if self.since is None:
            self.since = now
        elapsed = now - self.since
        self.v["q"] = elapsed >= self.v["pt"]
        self.v["et"] = min(elapsed, self.v["pt"])


class Instance:
    """An instance of a unit that was read."""

    def __init__(self, unit: Unit, units: dict[str, Unit], codes: dict[str, Code]) -> None:
        self.code = codes[unit.name]
        self.v: dict[str, Any] = {}
        for name, declared in unit.declared.items():
            if declared.type == "TON":
                self.v[name] = Ton()
            elif declared.type.lower() in units:
                self.v[name] = Instance(units[declared.type.lower()], units, codes)
            else:
                initial = declared.initial
                self.v[name] = DEFAULTS[declared.type] if initial is None else initial

    def call(self, pins: dict[str, Any], now: int) -> None:
        self.v.update(pins)
        self.code.run(self.v, now)

    def __deepcopy__(self, memo: dict[int, Any]) -> Instance:
        twin = object.__new__(Instance)
        twin.code = self.code
        twin.v = {
            k: copy.deepcopy(x) if isinstance(x, Ton | Instance) else x for k, x in self.v.items()
        }
        return twin


class Plc:
    """The one program of a text on a controller: inputs in, outputs out, at microsecond ``now``."""

    def __init__(self, units: dict[str, Unit]) -> None:
        self.units = units
        codes = {name: code_of(unit) for name, unit in self.units.items()}
        (self.program,) = [u for u in self.units.values() if u.kind == "PROGRAM"]
        self.instance = Instance(self.program, self.units, codes)
        located = self.program.declared.values()
        self.inputs = [d.name for d in located if d.address.upper().startswith("%I")]
        self.panel = {d.name: d for d in located if not d.address}
        self.outputs = [d.name for d in located if d.address.upper().startswith("%Q")]

    def scan(self, inputs: dict[str, bool], now: int) -> dict[str, bool]:
        for name in self.inputs:
            self.instance.v[name] = inputs[name]
        for name in self.panel.keys() & inputs.keys():
            self.instance.v[name] = inputs[name]
        self.instance.code.run(self.instance.v, now)
        return {name: self.instance.v[name] for name in self.outputs}

    def fork(self) -> Plc:
        twin = copy.copy(self)
        twin.instance = copy.deepcopy(self.instance)
        return twin
