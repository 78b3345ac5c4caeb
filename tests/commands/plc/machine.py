"""A PLC for the tests: instances of the parsed units, standard timers, one scan after the other."""

from __future__ import annotations

import copy
from typing import Any

from tests.commands.plc.reading import Code, Unit, code_of


class Ton:
    """The on-delay timer of IEC 61131-3, microseconds."""

    def __init__(self) -> None:
        self.v: dict[str, Any] = {"in": False, "pt": 0, "q": False, "et": 0}
        self.since: int | None = None

    def call(self, pins: dict[str, Any], now: int) -> None:
        v = self.v
        v.update(pins)
        if not v["in"]:
            self.since = None
            v["q"] = False
            v["et"] = 0
            return
        if self.since is None:
            self.since = now
        elapsed, expected = now - self.since, v["pt"]
        v["q"] = over = elapsed >= expected
        v["et"] = expected if over else elapsed

    def fork(self) -> Ton:
        twin = Ton.__new__(Ton)
        twin.v, twin.since = self.v.copy(), self.since
        return twin


class Instance:
    """An instance of a parsed unit."""

    def __init__(self, unit: Unit, units: dict[str, Unit], codes: dict[str, Code]) -> None:
        self.code = codes[unit.name]
        self.v: dict[str, Any] = {}
        for name, declared in unit.declared.items():
            if declared.type == "TON":
                self.v[name] = Ton()
            elif declared.type.lower() in units:
                self.v[name] = Instance(units[declared.type.lower()], units, codes)
            else:
                self.v[name] = declared.first
        self.inner = [name for name, x in self.v.items() if isinstance(x, Ton | Instance)]

    def call(self, pins: dict[str, Any], now: int) -> None:
        self.v.update(pins)
        self.code.run(self.v, now)

    def fork(self) -> Instance:
        twin = Instance.__new__(Instance)
        twin.code, twin.inner = self.code, self.inner
        twin.v = self.v.copy()
        for name in self.inner:
            twin.v[name] = self.v[name].fork()
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
        v = self.instance.v
        for name in self.inputs:
            v[name] = inputs[name]
        for name in self.panel.keys() & inputs.keys():
            v[name] = inputs[name]
        self.instance.code.run(v, now)
        return {name: v[name] for name in self.outputs}

    def fork(self) -> Plc:
        twin = copy.copy(self)
        twin.instance = self.instance.fork()
        return twin
