"""Hostile input for every reader: mutated files, and programs that are grammatical but odd.

    python -m tools.fuzz --cases 1000000 --processes 2

The classes ``same-*`` change what must not matter to a verdict, and what must. A reader may refuse
anything, but only with a ``ThreadlineError`` in one line. Everything else, a
warning, a second line in the message, or more than ten seconds of the processor, is a failure; it
is printed with what repeats it, and the exit status is 1. Cases depend on seed, reader and number
only, so that ``--reader part-program --first 4711 --cases 1`` runs one of them again.

A new reader is one more entry of ``READERS``.
"""

from __future__ import annotations

import argparse
import io
import random
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from types import FrameType

import ezdxf.filemanagement
from tools.fuzz_bytes import NUMBERS, TOKENS, UNITS, mutate
from tools.fuzz_cadfil import CADFIL
from tools.fuzz_designs import fuzz_designs
from tools.fuzz_drawings import fuzz_drawings
from tools.fuzz_files import fuzz_targets
from tools.fuzz_measured import fuzz_measured
from tools.fuzz_metamorphic import fuzz_metamorphic
from tools.fuzz_programs import fuzz_programs
from tools.fuzz_recordings import fuzz_recordings
from tools.fuzz_windings import SHORT

from threadline.errors import ThreadlineError
from threadline.jobs import read_job
from threadline.jobs.winding.layers import read_layers
from threadline.machine import load_machine
from threadline.machine.par import read_parameters
from threadline.machine.quantity import parse_machine_quantity
from threadline.units import parse_exact_time_s, parse_quantity
from threadline.verdict import load_spec
from threadline.winding.other_planners import meridian_of
from threadline.winding.product import product_of_text, product_text

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples"
LIBRARY = ROOT / "src" / "threadline" / "machine" / "library"
MAX_OPERATIONS = 2000
HANG_S = 10  # of the processor: the machine may be busy with something else
_WAITING = 30  # times as long by the clock, for what waits without working
_SHOWN = 5
WINDER = load_machine("lathe-winder")
STITCHER = load_machine("stitcher")
PLACER = load_machine("letter-placer")
STITCHING = {"stitch_length": "2.5 mm", "needle_speed": "50 stitch/s"}

# --- cases ---


def odd_program(rng: random.Random) -> bytes:
    """Lines of words that are mostly right, in programs that mostly fit together."""
    lines = []
    if rng.random() < 0.5:
        lines.append("%")
    labels = rng.sample(range(1, 6), rng.randint(1, 3))
    for k, label in enumerate(labels):
        lines.append(rng.choice((f"O{label}", f"O {label};", f"O{label} G91")))
        if rng.random() < 0.9:
            lines.append("G91 G1 F100")
        for _ in range(rng.randrange(6)):
            if rng.random() < 0.2:
                lines.append(
                    f"M98 P{rng.choice(labels)} L{rng.choice((1, 2, 3, 99, 10**6, 10**9))}"
                )
            elif rng.random() < 0.1:
                lines.append(" ".join(rng.choices(TOKENS, k=rng.randint(1, 4))))
            else:
                words = [f"{n}{rng.uniform(-50, 50):.{rng.randrange(12)}f}" for n in "AXY"]
                lines.append(" ".join(words[: rng.randint(1, 3)]))
        lines.append("M30" if k == len(labels) - 1 else rng.choice(("M99", "M99", "M99", "M2", "")))
    if lines[0] == "%" and rng.random() < 0.9:
        lines.append("%")
    return rng.choice(("\n", "\n", "\r\n")).join(lines).encode()


def part_program(rng: random.Random) -> bytes:
    kind = rng.randrange(4)
    if kind == 0:
        return odd_program(rng)
    if kind == 1:
        return mutate(rng, odd_program(rng))
    return mutate(rng, rng.choice(SEEDS["part-program"]))


def parameter_file(rng: random.Random) -> bytes:
    return mutate(rng, rng.choice(SEEDS["par"]))


def machine_file(rng: random.Random) -> bytes:
    """A file of the library with one value or one line changed, or mutated anywhere."""
    data = rng.choice(SEEDS["machine"])
    kind = rng.randrange(4)
    if kind == 0:
        return mutate(rng, data)
    lines = data.decode().split("\n")
    at = rng.randrange(len(lines))
    if kind == 1:
        key, equals, _ = lines[at].partition("=")
        value = rng.choice(
            ('"', "", "[", "{}", "{ x = 1 }", "true", "1e999", "nan", "-0", '"none"')
        )
        text = f'"{rng.choice(NUMBERS)} {rng.choice(UNITS)} exact, assumed"'
        lines[at] = f"{key}{equals or '='}{rng.choice((value, text, text))}"
    elif kind == 2:
        lines[at] = mutate(rng, lines[at].encode()).decode("utf-8", "surrogateescape")
    else:
        lines.insert(rng.randrange(len(lines)), lines.pop(at))
    return "\n".join(lines).encode("utf-8", "surrogateescape")


def quantity(rng: random.Random) -> bytes:
    text = f"{rng.choice(NUMBERS)}{rng.choice((' ', '', '  '))}{rng.choice(UNITS)}"
    kind = rng.randrange(4)
    if kind == 0:
        text += rng.choice(("/", "*", " ", "^")) + rng.choice(UNITS)
    elif kind == 1:
        text += rng.choice(
            (" exact, printed", " +- 5 %, assumed: x", " +- 1 mm, checked", ", exact")
        )
    data = text.encode()
    return mutate(rng, data) if rng.random() < 0.5 else data


def seam_file(kind: str) -> Callable[[random.Random], bytes]:
    return lambda rng: mutate(rng, rng.choice(SEEDS[kind]))


def product_file(rng: random.Random, kind: str = "product") -> bytes:
    """A product with a value changed, or mutated anywhere."""
    data = rng.choice(SEEDS[kind])
    if rng.randrange(3):
        return mutate(rng, data)
    lines = data.decode().split("\n")
    at = rng.randrange(len(lines))
    key, equals, _ = lines[at].partition("=")
    text = f'"{rng.choice(NUMBERS)} {rng.choice(("mm", "m", "deg", "%", rng.choice(UNITS)))}"'
    lines[at] = f"{key}{equals or '='}{rng.choice((text, text, text, 'true', '[]', '{}', '-1'))}"
    return "\n".join(lines).encode()


# --- readers ---


def read_product(path: Path) -> None:
    """Read a product, or the meridian of one."""
    if path.suffix != ".toml":
        whole = path.with_name("p.wind.toml")
        whole.write_text(MERIDIAN.format(path.name))
        path = whole
    product = product_of_text(product_text(path))
    assert product_of_text(product_text(product.text)) is product


def read_winding(path: Path) -> None:
    """Read a product with layers, and plan their fibre and the eye's path."""
    for _ in islice(read_job(path, WINDER), MAX_OPERATIONS):
        pass


def read_program(path: Path) -> None:
    for _ in islice(read_job(path, WINDER), MAX_OPERATIONS):
        pass


def read_seam_job(path: Path) -> None:
    options = {} if path.suffix == ".toml" else STITCHING
    for _ in islice(read_job(path, STITCHER, **options), MAX_OPERATIONS):
        pass


def read_move_list(path: Path) -> None:
    for _ in islice(read_job(path, PLACER), MAX_OPERATIONS):
        pass


def read_control_file(path: Path) -> None:
    (path.parent / "made.pay").write_bytes(CADFIL["pay"][0])
    product_text(path)


def read_quantity(path: Path) -> None:
    """Read a quantity as each kind; refused when it is none of them."""
    text = path.read_bytes().decode("utf-8", "replace")
    refused: list[ThreadlineError] = []
    readers: tuple[Callable[[], object], ...] = (
        lambda: parse_quantity(text, "mm"),
        lambda: parse_quantity(text, "count/tick"),
        lambda: parse_exact_time_s(text),
        lambda: parse_machine_quantity(text, ("kg", "m/s^2", "")),
    )
    for read in readers:
        try:
            read()
        except ThreadlineError as error:
            refused.append(error)
    if len(refused) == len(readers):
        raise refused[0]


@dataclass(frozen=True)
class Reader:
    """A reader to be fuzzed.

    Attributes
    ----------
    file
        Name of the file that a case is written to.
    weight
        Share of the cases; slow readers have a small one.
    """

    file: str
    make: Callable[[random.Random], bytes]
    read: Callable[[Path], object]
    weight: int


READERS: dict[str, Reader] = {
    "part-program": Reader("a.nc", part_program, read_program, 60),
    **{name: Reader(*target) for name, target in fuzz_programs(mutate).items()},
    "par": Reader("fw-cnc.par", parameter_file, lambda p: read_parameters(p, WINDER), 12),
    "units": Reader("unit.txt", quantity, read_quantity, 24),
    "machine": Reader("a.toml", machine_file, load_machine, 4),
    "spec": Reader("a.toml", seam_file("spec"), lambda p: load_spec(p, WINDER), 4),
    "moves": Reader("a.toml", seam_file("moves"), read_move_list, 4),
    "product": Reader("a.wind.toml", product_file, read_product, 4),
    "winding": Reader("a.wind.toml", partial(product_file, kind="winding"), read_winding, 1),
    "layers": Reader("a.wind.toml", partial(product_file, kind="layers"), read_layers, 4),
    "meridian-csv": Reader("a.csv", seam_file("meridian-csv"), read_product, 2),
    "meridian-dxf": Reader("a.dxf", seam_file("meridian-dxf"), read_product, 1),
    "seam-toml": Reader("a.seam.toml", seam_file("seam-toml"), read_seam_job, 1),
    "seam-csv": Reader("a.csv", seam_file("seam-csv"), read_seam_job, 1),
    "seam-svg": Reader("a.svg", seam_file("seam-svg"), read_seam_job, 1),
    "seam-dxf": Reader("a.dxf", seam_file("seam-dxf"), read_seam_job, 1),
    "wind": Reader("a.wind", seam_file("wind"), product_text, 4),
    "fib": Reader("a.fib", seam_file("fib"), meridian_of, 8),
    "pay": Reader("a.pay", seam_file("pay"), product_text, 4),
    "ctl": Reader("a.ctl", seam_file("ctl"), read_control_file, 4),
    "mnd": Reader("a.mnd", seam_file("mnd"), read_product, 4),
    **{name: Reader(*target) for name, target in fuzz_targets(mutate).items()},
    **{name: Reader(*target) for name, target in fuzz_measured(mutate).items()},
    **{name: Reader(*target) for name, target in fuzz_recordings().items()},
    **{name: Reader(*target) for name, target in fuzz_metamorphic().items()},
    **{name: Reader(*target) for name, target in fuzz_drawings().items()},
    **{name: Reader(*target) for name, target in fuzz_designs(mutate).items()},
}

MERIDIAN = '[[part]]\nfile = "{}"\n[band]\nwidth = "4 mm"\n[friction]\nvalue = "0.3"\n'
_MERIDIAN_CSV = b"x_mm,radius_mm\n" + b"".join(b"%d,%d\n" % (9 * k, 20 + k % 5) for k in range(12))


def _half_section() -> bytes:
    document = ezdxf.filemanagement.new("R2000", units=4)
    space = document.modelspace()
    space.add_arc((0, 0), 50, 90, 160)
    space.add_line((0, 50), (60, 50))
    space.add_spline([(60, 50), (80, 45), (100, 20)])
    out = io.StringIO()
    document.write(out)
    return out.getvalue().encode()


_ENTITIES = """0 SECTION 2 HEADER 9 $ACADVER 1 AC1009 9 $INSUNITS 70 4 0 ENDSEC 0 SECTION 2 ENTITIES
0 ARC 8 0 10 0.0 20 0.0 40 50.0 50 90.0 51 160.0 0 LINE 8 0 10 0.0 20 50.0 11 60.0 21 50.0
0 LINE 8 0 10 60.0 20 50.0 11 100.0 21 20.0 0 ENDSEC 0 EOF"""
_BARE_SECTION = "\n".join([*_ENTITIES.split(), ""]).encode()  # read faster, and hit more often
_PRODUCT = b"""[mandrel]
at = "100 mm +- 0.5 mm"
shaft = "6 mm"
slip = "0 deg +- 0.1 deg"
[[part]]
kind = "nose"
radius = "50 mm"
height = "90 mm"
opening = "8 mm"
pole = "left"
[[part]]
kind = "cone"
radius = "50 mm"
end_radius = "45 mm"
length = "80 mm"
[[part]]
kind = "ellipsoid"
radius = "45 mm"
height = "20 mm"
opening = "9 mm"
pole = "right"
[[boss]]
at = "-9 mm"
length = "10 mm"
radius = "12 mm"
[[pin]]
at = "80 mm"
radius = "60 mm"
diameter = "3 mm"
[band]
width = "4 mm +- 5 %"
thickness = "0.2 mm"
tex = 600
[friction]
value = "0.25 +- 0.05"
[fibre]
tied = "30 mm"
take_up = "50 mm"
clearance = "2 mm"
[coverage]
begin = "95 mm"
end = "150 mm"
gap = "0.1 mm"
"""
_PAR = b"""FW-CNC.PAR
comment
comment
20  ; Initial feed rate for manual control
10  ; Normal feed rate
30  ; Feed rate limit
20  ; Number of interrupts after which actual positions are recorded
4   ; Number of knot points to be interpolated between two points
"""
_WIND = (
    b'{"schemaVersion": "1.3", "mandrelParameters": {"diameter": 98.0, "windLength": 120, %s}, '
    b'"towParameters": {"width": 6, "thickness": 0.5}, "defaultFeedRate": 9000, "layers": '
    b'[{"windType": "helical", "windAngle": 30, "patternNumber": 3}, {"windType": "hoop"}]}'
)
SEEDS: dict[str, list[bytes]] = {
    "wind": [
        _WIND % more
        for more in (b'"endDiameter": 54', b'"profile": {"type": "vonKarman"}', b'"other": 1')
    ],
    "fib": CADFIL["fib"],
    "pay": CADFIL["pay"],
    "ctl": CADFIL["ctl"],
    "mnd": CADFIL["mnd"],
    "part-program": [p.read_bytes() for p in sorted((ROOT / "examples").glob("*.prg"))]
    + [
        b"N1 G21\nN2 G90\nN3 G94\nN4 G1 A0.5 X50.0 F500.0 ; tension_N=25.0\nG28 X1\nG4 P.5\nM5\nM30"
    ],
    "par": [_PAR, _PAR + b"3 ; axes\n2 ; Kp\n4 ; Kd\n"],
    "machine": [p.read_bytes() for p in sorted(LIBRARY.glob("*.toml")) if ".spec." not in p.name],
    "spec": [p.read_bytes() for p in sorted(LIBRARY.glob("*.spec.toml"))],
    "winding": SHORT
    + [(EXAMPLES / f"{name}.wind.toml").read_bytes() for name in ("vessel", "tube")],
    "layers": [
        p.read_bytes()
        for p in sorted(ROOT.glob("*/**/*.wind.toml"))
        if b"[[layer" in p.read_bytes()
    ],
    "product": [_PRODUCT] + [p.read_bytes() for p in sorted(EXAMPLES.glob("*.wind.toml"))],
    "meridian-csv": [_MERIDIAN_CSV],
    "meridian-dxf": [_half_section(), *[_BARE_SECTION] * 9],
    "moves": [(EXAMPLES / "letter-cycle.toml").read_bytes()],
    "seam-toml": [p.read_bytes() for p in sorted(EXAMPLES.glob("*.seam.toml"))],
    **{
        f"seam-{kind}": [p.read_bytes() for p in sorted(EXAMPLES.glob(f"*.{kind}"))]
        for kind in ("csv", "svg", "dxf")
    },
}

# --- running ---


@dataclass
class Tally:
    """What came of a share of the cases."""

    cases: Counter[str] = field(default_factory=Counter)
    accepted: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    slowest_s: float = 0.0
    slowest: str = ""

    def add(self, other: Tally) -> None:
        self.cases += other.cases
        self.accepted += other.accepted
        self.failures += other.failures
        if other.slowest_s > self.slowest_s:
            self.slowest_s, self.slowest = other.slowest_s, other.slowest


class HangError(Exception):
    """A case took too long."""


def _on_alarm(_signal: int, _frame: FrameType | None) -> None:
    raise HangError(f"more than {HANG_S} s")


def run(seed: int, name: str, first: int, count: int) -> Tally:
    """Run the cases ``first`` to ``first + count`` of a reader."""
    reader, tally = READERS[name], Tally()
    if name == "winding":
        read_winding(EXAMPLES / "vessel.wind.toml")  # its code is compiled outside the watch
    for watch in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(watch, _on_alarm)
    warnings.simplefilter("error")
    with tempfile.TemporaryDirectory(dir=_fast_folder()) as folder:
        path = Path(folder) / reader.file
        for index in range(first, first + count):
            path.write_bytes(reader.make(random.Random(f"{seed}/{name}/{index}")))
            began = time.process_time()
            signal.setitimer(signal.ITIMER_PROF, HANG_S)
            signal.alarm(_WAITING * HANG_S)
            problem = ""
            try:
                reader.read(path)
                tally.accepted[name] += 1
            except ThreadlineError as error:
                if "\n" in str(error):
                    problem = f"a message of several lines: {str(error)!r}"
            except Exception:
                problem = traceback.format_exc(limit=-3)
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
                signal.alarm(0)
            took_s = time.process_time() - began
            if took_s > tally.slowest_s:
                tally.slowest_s, tally.slowest = took_s, f"--reader {name} --first {index}"
            if problem:
                repeat = f"--seed {seed} --reader {name} --first {index} --cases 1"
                tally.failures.append(f"{repeat}\n{problem}")
        tally.cases[name] += count
    return tally


def _fast_folder() -> str | None:
    memory = Path("/dev/shm")
    return str(memory) if memory.is_dir() else None


def shares(cases: int, only: str | None) -> dict[str, int]:
    """Split the cases among the readers by weight."""
    if only is not None:
        return {only: cases}
    total = sum(reader.weight for reader in READERS.values())
    parts = {name: cases * reader.weight // total for name, reader in READERS.items()}
    parts["part-program"] += cases - sum(parts.values())
    return parts


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=20_000, help="cases in all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--reader", choices=sorted(READERS), help="only this one")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    began, tally, chunk = time.perf_counter(), Tally(), 500
    tasks = [
        (options.seed, name, options.first + at, min(chunk, count - at))
        for name, count in shares(options.cases, options.reader).items()
        for at in range(0, count, chunk)
    ]
    if options.processes == 1:
        for task in tasks:
            tally.add(run(*task))
    else:
        with ProcessPoolExecutor(options.processes) as pool:
            for part in pool.map(run, *zip(*tasks, strict=True)):
                tally.add(part)
    for failure in tally.failures[:_SHOWN]:
        print(failure, file=sys.stderr)
    took_s = time.perf_counter() - began
    for name, count in sorted(tally.cases.items()):
        print(f"{name}: {count} cases, {tally.accepted[name]} of them accepted")
    print(f"slowest: {tally.slowest_s:.3f} s, {tally.slowest}")
    print(f"{tally.cases.total()} cases in {took_s:.0f} s, {len(tally.failures)} tracebacks")
    return 1 if tally.failures else 0


if __name__ == "__main__":
    sys.exit(main())
