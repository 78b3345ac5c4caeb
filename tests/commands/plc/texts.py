"""The tested texts, written and read once; everything else in this folder uses only the text."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from typer.testing import CliRunner

from tests.commands.plc.machine import Plc
from tests.commands.plc.parts import read_in_parts
from tests.commands.plc.reading import Unit
from threadline.cli.main import app

ROOT = Path(__file__).resolve().parents[3]
PAPER = ("--mode", "3.04 Hz", "--damping", "0.17")


@cache
def emitted(machine: str, shaper: str, target: str) -> dict[str, bytes]:
    """Return the files of the program, by the part of the name after its first dot."""
    with TemporaryDirectory() as folder:
        out = Path(folder) / "cycle.st"
        job = ROOT / "examples" / "letter-cycle.toml"
        words = ["compile", str(job), "-m", machine, "--target", target, "-o", str(out)]
        mode = () if shaper == "none" else PAPER
        result = CliRunner().invoke(app, [*words, "--shaper", shaper, *mode])
        assert result.exit_code == 0, result.output
        return {f.name.split(".", 1)[1]: f.read_bytes() for f in Path(folder).iterdir()}


def text_of(machine: str, shaper: str) -> str:
    return emitted(machine, shaper, "st")["st"].decode("ascii")


@cache
def units_of(machine: str, shaper: str) -> dict[str, Unit]:
    """Return the units, read by blark."""
    return read_in_parts(text_of(machine, shaper))


@cache
def _controller(machine: str, shaper: str) -> Plc:
    return Plc(units_of(machine, shaper))


def controller(machine: str = "letter-placer", shaper: str = "zv") -> Plc:
    """Return a fresh controller with the text for ``machine``."""
    return _controller(machine, shaper).fork()
