"""The program as a strict compiler makes it: matiec's C, behind the face of ``machine.Plc``.

Make it by hand: ``threadline compile examples/letter-cycle.toml -m letter-placer --target st
--shaper zv --mode "3.04 Hz" --damping 0.17 -o cycle.st``, ``cat cycle.st cycle.configuration.st``
into one text, ``iec2c -I matiec/lib -T FOLDER`` on it, then write ``GLUE`` below it as
``FOLDER/glue.c`` and ``gcc -shared -fPIC -w -I matiec/lib/C -o FOLDER/cell.so FOLDER/glue.c``.
``python -m tests.commands.plc.compiled FOLDER MATIEC`` does the last two steps.
"""

from __future__ import annotations

import ctypes
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.commands.plc.driving import PANEL
from tests.commands.plc.machine import Plc
from tests.commands.plc.texts import controller

GLUE = r"""
#include "iec_std_lib.h"
#define __LOCATED_VAR(type, name, ...) type __##name; type *name = &__##name;
#include "LOCATED_VARIABLES.h"
#undef __LOCATED_VAR
TIME __CURRENT_TIME;
BOOL __DEBUG;
#include "cell.c"
#undef MACHINE
#include "cpu.c"
unsigned long state_size(void) { return sizeof CPU__MACHINE; }
void *state(void) { return &CPU__MACHINE; }
void begin(void) { config_init__(); }
void scan(long us) {
  __CURRENT_TIME.tv_sec = us / 1000000;
  __CURRENT_TIME.tv_nsec = (us % 1000000) * 1000;
  config_run__(0);
}
void panel(int continuous, int stop_at_end, int manual, int jog) {
  CPU__MACHINE.CONTINUOUS.value = continuous;
  CPU__MACHINE.STOP_AT_END.value = stop_at_end;
  CPU__MACHINE.MANUAL.value = manual;
  CPU__MACHINE.JOG.value = jog;
}
int busy(void) { return CPU__MACHINE.SEQUENCE.BUSY.value; }
int fault(void) { return CPU__MACHINE.SEQUENCE.FAULT.value; }
int fault_code(void) { return CPU__MACHINE.SEQUENCE.FAULT_CODE.value; }
int homed(void) { return CPU__MACHINE.SEQUENCE.HOMED.value; }
"""


class _Sequence:
    """Texts of the block, looked up in the compiled one."""

    def __init__(self, plc: Compiled) -> None:
        self._plc = plc

    def __getitem__(self, name: str) -> Any:
        self._plc.show()
        return getattr(self._plc.library, name)()


class _Of:
    def __init__(self, v: Any) -> None:
        self.v = v


class Compiled(Plc):
    """The compiled program; copies share the library and put their own state into it in turn."""

    def __init__(self, folder: Path) -> None:
        read = controller()
        self.inputs, self.panel, self.outputs = read.inputs, read.panel, read.outputs
        declared = read.program.declared
        self.library = ctypes.CDLL(str(folder / "cell.so"))
        self.library.state.restype = ctypes.c_void_p
        self.library.state_size.restype = ctypes.c_ulong
        self.library.scan.argtypes = [ctypes.c_long]
        self._at = {
            name: ctypes.c_uint8.in_dll(self.library, _symbol(declared[name].address))
            for name in (*self.inputs, *self.outputs)
        }
        assert set(PANEL) <= self.panel.keys()
        self.library.begin()
        self._size, self._where = self.library.state_size(), self.library.state()
        self._mine = ctypes.string_at(self._where, self._size)
        self._latest = {name: 0 for name in self._at}
        self.instance: Any = _Of({"sequence": _Of(_Sequence(self))})

    def show(self) -> None:
        """Put the state of this copy into the library."""
        ctypes.memmove(self._where, self._mine, self._size)
        for name, value in self._latest.items():
            self._at[name].value = value

    def scan(self, inputs: dict[str, bool], now: int) -> dict[str, bool]:
        self.show()
        for name in self.inputs:
            self._at[name].value = int(inputs[name])
        self.library.panel(*(int(inputs[name]) for name in PANEL))
        self.library.scan(now)
        self._mine = ctypes.string_at(self._where, self._size)
        self._latest = {name: one.value for name, one in self._at.items()}
        return {name: bool(self._latest[name]) for name in self.outputs}

    def fork(self) -> Compiled:
        twin = object.__new__(Compiled)
        twin.__dict__.update(self.__dict__)
        twin._latest = dict(self._latest)
        twin.instance = _Of({"sequence": _Of(_Sequence(twin))})
        return twin


def _symbol(address: str) -> str:
    """Return the variable of an address in ``GLUE``: ``____IX0_3`` for ``%IX0.3``."""
    match = re.fullmatch(r"%([IQ])X(\d+)\.(\d+)", address.upper())
    assert match is not None, address
    return f"____{match[1]}X{match[2]}_{match[3]}"


def main() -> None:
    folder, matiec = Path(sys.argv[1]), Path(sys.argv[2])
    (folder / "glue.c").write_text(GLUE, encoding="ascii")
    words = ["gcc", "-shared", "-fPIC", "-w", "-I", str(folder), "-I", str(matiec / "lib" / "C")]
    subprocess.run([*words, "-o", str(folder / "cell.so"), str(folder / "glue.c")], check=True)


if __name__ == "__main__":
    main()
