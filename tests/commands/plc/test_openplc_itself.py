"""The program through OpenPLC's own compiler, run as the compiled C.

``THREADLINE_IEC2C`` names the folder of OpenPLC's matiec in which ``iec2c`` was built, beside its
``lib``. The flags are those of OpenPLC's ``compile_program.sh``.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tests.commands.plc.compiled import GLUE, Compiled
from tests.commands.plc.driving import Bench
from tests.commands.plc.texts import controller, emitted
from tests.conftest import NO_FIRMWARE

FLAGS = ("-f", "-l", "-p", "-r", "-R", "-a")
MADE = ("Config0.c", "Res0.c", "POUS.c", "POUS.h", "LOCATED_VARIABLES.h", "VARIABLES.csv")
AS_HERE = (("cell.c", "Config0.c"), ("cpu.c", "Res0.c"), ("CPU__", "RES0__"))


def through_iec2c(text: bytes, folder: Path) -> str:
    """Compile ``text`` as OpenPLC does; return the compiler's messages."""
    matiec = Path(os.environ["THREADLINE_IEC2C"]).resolve()
    (folder / "lib").symlink_to(matiec / "lib")
    (folder / "cycle.st").write_bytes(text)
    words = [str(matiec / "iec2c"), *FLAGS, "cycle.st"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_openplc_itself_runs_what_the_text_says(tmp_path: Path) -> None:
    """Its C equals blark's reading of the text: outputs at each scan, in homing and one cycle."""
    if "THREADLINE_IEC2C" not in os.environ:
        pytest.skip(f"{NO_FIRMWARE}THREADLINE_IEC2C names the folder of iec2c in OpenPLC's matiec")
    message = through_iec2c(emitted("letter-placer", "zv", "openplc")["st"], tmp_path)
    assert "warning" not in message.lower() and "error" not in message.lower(), message
    assert {file for file in MADE if (tmp_path / file).is_file()} == set(MADE), message
    glue = GLUE
    for there, here in AS_HERE:
        glue = glue.replace(there, here)
    (tmp_path / "glue.c").write_text(glue, encoding="ascii")
    include = ("-I", str(tmp_path), "-I", str(tmp_path / "lib" / "C"))
    library = str(tmp_path / "cell.so")
    subprocess.run(
        ["gcc", "-shared", "-fPIC", "-w", *include, "-o", library, str(tmp_path / "glue.c")],
        check=True,
    )
    benches = [Bench(plc, jitter=0.2, seed=3) for plc in (Compiled(tmp_path), controller())]
    scans = switched = 0
    for button in ("home_button", "start_button"):
        before, now = (bench.press(button) for bench in benches)
        assert before == now
        while benches[1].block["busy"]:
            before, now = (bench.scan() for bench in benches)
            assert before == now, scans
            switched += bool(now)
            scans += 1
        assert not benches[0].block["busy"]
        assert not benches[0].block["fault"]
    assert scans > 500
    assert switched > 300
