"""Embroidery designs of every format, and measured cams, damaged.

``python -m tools.fuzz_designs FILE`` damages a file of one's own.
"""

from __future__ import annotations

import io
import random
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pystitch

from threadline.errors import ThreadlineError
from threadline.jobs import Job, read_job
from threadline.jobs.embroidery.t15 import t15_bytes
from threadline.machine import load_machine
from threadline.motion.laws.cam import Triangle, read_cam

Target = tuple[str, Callable[[random.Random], bytes], Callable[[Path], object], int]
Mutate = Callable[[random.Random, bytes], bytes]
FRAME = load_machine("schiffli-frame")
EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
EXAMPLE, CAM = EXAMPLES / "rosette.dst", EXAMPLES / "schiffli-cam.csv"
WRITERS = {
    "dst": pystitch.write_dst,
    "exp": pystitch.write_exp,
    "pes": pystitch.write_pes,
    "jef": pystitch.write_jef,
    "vp3": pystitch.write_vp3,
    "xxx": pystitch.write_xxx,
    "u01": pystitch.write_u01,
}


def hus_bytes(columns: tuple[bytes, bytes, bytes]) -> bytes:
    """Return a HUS file of three columns; it has no writer elsewhere.

    All codes are of nine bits, so that the code of a symbol is the symbol; runs are copies from one
    byte back.
    """
    packed = [_packed(column) for column in columns]
    offsets, at = [], 42
    for part in packed:
        offsets.append(at)
        at += len(part)
    head = struct.pack("<3I4h3I8sH", 0x00C8FC5D, len(columns[0]), 0, 0, 0, 0, 0, *offsets, b"", 0)
    return head + b"".join(packed)


def _packed(column: bytes) -> bytes:
    symbols: list[int] = []
    at = 0
    while at < len(column):
        run = 1
        while run < 256 and column[at : at + 1] == column[at + run : at + run + 1]:
            run += 1
        symbols.append(column[at])
        if run > 3:
            symbols.append(253 + run - 1)
            at += run
        else:
            at += 1
    symbols.append(510)
    bits = ""
    for first in range(0, len(symbols), 1000):
        block = symbols[first : first + 1000]
        # Lengths are always 9 (11 less 2), of 511 symbols; the distance is always of exponent 0.
        bits += f"{len(block):016b}{0:05b}{11:05b}{511:09b}{0:05b}{0:05b}"
        bits += "".join(f"{symbol:09b}" for symbol in block)
    bits += "0" * (-len(bits) % 8)
    return int(bits, 2).to_bytes(len(bits) // 8, "big")


def hus_seed(records: int = 200) -> bytes:
    """Return a design with every command of HUS."""
    numbers = random.Random(3)
    acts = bytes(numbers.choice((0x80, 0x80, 0x80, 0x81, 0x84, 0x88)) for _ in range(records))
    ways = [bytes(numbers.randrange(256) for _ in range(records)) for _ in "XY"]
    still = bytes(40)
    return hus_bytes(
        (acts + b"\x80" * 40 + b"\x90", ways[0] + still + b"\0", ways[1] + still + b"\0")
    )


def seeds(design: pystitch.EmbPattern | None = None, records: int = 200) -> dict[str, bytes]:
    """Return a sound design in every format: that of the examples unless another is given.

    Of T15 and HUS, which have no writer elsewhere, it is one of so many records.
    """
    found = {}
    for suffix, write in WRITERS.items():
        out = io.BytesIO()
        write(pystitch.read(str(EXAMPLE)) if design is None else design.copy(), out)
        found[suffix] = out.getvalue()
    numbers = random.Random(2)
    ways = np.array([[numbers.randint(-165, 165) for _ in "XY"] for _ in range(records)])
    sewn = np.array([numbers.random() < 0.9 for _ in ways], dtype=np.int64)
    found["t15"] = t15_bytes(ways, sewn, {records // 4, records})
    found["hus"] = hus_seed(records)
    return found


def short_design() -> pystitch.EmbPattern:
    """Return all that a design may have, in few records: a case takes as long as it has records."""
    design = pystitch.EmbPattern()
    for k in range(24):
        design.add_stitch_absolute(pystitch.STITCH, 7 * k, (11 * k) % 60)
    design.trim()
    design.add_stitch_absolute(pystitch.JUMP, -150, 90)
    design.color_change()
    for k in range(8):
        design.add_stitch_absolute(pystitch.STITCH, -150 - 20 * (k % 2), 90 + k)
    design.end()
    return design


def read_cam_file(path: Path) -> None:
    """Read a cam with the triangle of the example."""
    read_cam(path, Triangle(b_m=0.165, c_m=0.135))


def damaged(rng: random.Random, data: bytes, mutate: Mutate | None = None) -> bytes:
    """Cut it off, change some bytes where records are, or treat it as any file."""
    kind = rng.randrange(8)
    if kind == 0:
        return data[: rng.randrange(len(data) + 1)]
    if kind == 1 and mutate is not None:
        return mutate(rng, data)
    if kind == 2:
        return bytes(rng.randrange(256) for _ in range(rng.randrange(2000)))
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 40))):
        at = rng.randrange(len(out)) if rng.random() < 0.6 else rng.randrange(min(len(out), 600))
        out[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    return bytes(out)


def read_design(path: Path) -> Job:
    """Read a design; of what is accepted every place is a number and on the grid of 0.1 mm."""
    job = read_job(path, FRAME)
    for run in job.runs():
        if hasattr(run, "targets"):
            assert np.isfinite(run.targets).all()
    return job


def fuzz_designs(mutate: Mutate) -> dict[str, Target]:
    """Return the readers of designs: file name, maker of cases, reader, weight."""

    def maker(data: bytes) -> Callable[[random.Random], bytes]:
        return lambda rng: damaged(rng, data, mutate)

    cam = CAM.read_bytes()
    return {
        "cam": ("a.csv", lambda rng: mutate(rng, cam), read_cam_file, 1),
        **{
            f"design-{suffix}": (f"a.{suffix}", maker(data), read_design, 1)
            for suffix, data in seeds(short_design(), 40).items()
        },
    }


def main() -> int:
    """Damage one's own file many times; print what came of it."""
    file, cases = Path(sys.argv[1]), int((sys.argv[2:] or ["1000"])[0])
    data, tally = file.read_bytes(), Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / file.name
        for index in range(cases):
            path.write_bytes(damaged(random.Random(index), data))
            try:
                read_design(path)
                tally["accepted"] += 1
            except ThreadlineError as error:
                tally["refused" if "\n" not in str(error) else "several lines"] += 1
    print(dict(tally))
    return 1 if tally["several lines"] else 0


if __name__ == "__main__":
    sys.exit(main())
