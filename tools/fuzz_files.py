"""Hostile tick tables and recordings: what ``tools/fuzz.py`` feeds to the readers of files."""

from __future__ import annotations

import io
import json
import random
import struct
import tempfile
import zipfile
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from itertools import islice
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard

from threadline.files import (
    Channel,
    ChannelKind,
    Clock,
    Event,
    Recording,
    RecordingBlock,
    Stream,
    TickBlock,
    TickTable,
)
from threadline.files.formats import read_recording, read_table, write_recording
from threadline.files.formats.plt import write_plt
from threadline.files.formats.tick_table import write_table_csv, write_table_npz
from threadline.files.formats.trajectory_array import write_array

Mutate = Callable[[random.Random, bytes], bytes]
Target = tuple[str, Callable[[random.Random], bytes], Callable[[Path], object], int]

MAX_BLOCKS = 20
_MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")  # kind and length
WORDS = """
0 -1 1 -0 +1 1.5 1e3 1e400 nan inf -inf NaN 9999999999999999999 2147483648 4294967296 1_0 0x1 ,
; . [] {} [[]] # #: null true time tick X Xx X.load X.laod [mm] [kg] mm deg every ticks of 5 ms
1/200 0/1 1/0 -1/2 s operation events remainder phase stop
""".split()  # noqa: SIM905 - a table of words
EVENTS = ['"[[""stop"",0,"""",0]]"', '"[[""stop"",0,"""",0,-1]]"']
CELLS = [*WORDS, *EVENTS, "", " ", '"', '""', "\t"]
NUMBERS = (True, 0, -1, 1.5, 1e308, 10**40)
VALUES: list[object] = [None, *NUMBERS, "", "X", "0/1", "1/0", "9" * 30 + "/7", [], {}]
TRACE = "# a comment\ntime [s],X [mm],A.load [deg],operation\n" + "".join(
    f"{k * 0.005:.4f},{k * 0.25},{-k},{k // 9}\n" for k in range(30)
)


def _table() -> TickTable:
    counts = np.array([[k // 3, -k] for k in range(40)])
    events = (
        Event(tick=3, kind="output", operation=1, name='valve "a"', value=1.5),
        Event(tick=40, kind="end", operation=4),
    )
    block = TickBlock(first_tick=0, counts=counts, operation=np.arange(40) // 10, events=events)
    return TickTable(
        clock=Clock("servo", Fraction(1, 200)),
        axes=("A", "X"),
        counts_per_unit=np.array([2015.7, 55358.0]),
        start_counts=np.array([0, -5]),
        blocks=Stream.of([block]),
        job_sha256="a" * 64,
        machine_sha256="b" * 64,
    )


def _recording() -> Recording:
    clock = Clock("servo", Fraction(1, 200))
    kinds = {"X.measured": ("m", "X"), "A.measured": ("rad", "A")}
    channels = tuple(
        Channel(name=n, kind=ChannelKind.MEASURED, unit=u, clock=clock, axis=a, stride=20)
        for n, (u, a) in kinds.items()
    )
    blocks = [
        RecordingBlock(
            first_tick={"servo": 20 * first},
            samples={n: np.linspace(0.0, 0.1, 10) for n in kinds},
            events=(Event(tick=20 * first, kind="stop", operation=2),),
        )
        for first in (0, 10)
    ]
    return Recording(
        channels=channels,
        blocks=Stream.of(blocks),
        job_sha256="a" * 64,
        machine_sha256="b" * 64,
        simulated=True,
        origin={"job": "x-180.prg"},
    )


@cache
def seeds() -> dict[str, bytes]:
    """Return a good file for each reader."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "seed"
        made = {}
        for name, writer in (
            ("table-csv", write_table_csv),
            ("table-npz", write_table_npz),
            ("array", write_array),
        ):
            writer(_table(), path)
            made[name] = path.read_bytes()
        for ending in ("csv", "npz", "mcap"):
            write_recording(_recording(), path.with_suffix(f".{ending}"))
            made[f"recording-{ending}"] = path.with_suffix(f".{ending}").read_bytes()
        write_plt(_recording(), path)
        made["plt"] = path.read_bytes()
    made["trace"] = TRACE.encode()
    return made


def fuzz_targets(mutate: Mutate) -> dict[str, Target]:
    """Return, by name: the file to write, what makes a case, what reads it, and its weight."""

    def text(name: str) -> Callable[[random.Random], bytes]:
        return lambda rng: odd_text(rng, seeds()[name], mutate)

    def archive(name: str) -> Callable[[random.Random], bytes]:
        return lambda rng: odd_archive(rng, seeds()[name], mutate)

    return {
        "table-csv": ("a.csv", text("table-csv"), _read_table, 4),
        "table-npz": ("a.npz", archive("table-npz"), _read_table, 4),
        "array": ("a.ticks", text("array"), _read_table, 4),
        "recording-csv": ("a.csv", text("recording-csv"), _read_recording, 4),
        "recording-npz": ("a.npz", archive("recording-npz"), _read_recording, 4),
        "recording-mcap": ("a.mcap", lambda rng: _odd_mcap(rng, mutate), _read_recording, 4),
        "plt": ("a.plt", text("plt"), _read_recording, 4),
        "trace": ("a.csv", text("trace"), _read_recording, 8),
    }


def _read_table(path: Path) -> None:
    for _ in islice(read_table(path), MAX_BLOCKS):
        pass


def _read_recording(path: Path) -> None:
    for _ in islice(read_recording(path), MAX_BLOCKS):
        pass


def odd_text(rng: random.Random, data: bytes, mutate: Mutate) -> bytes:
    """Another cell, a line less, twice or elsewhere, another description; or bytes anywhere."""
    kind = rng.randrange(5)
    if kind == 0:
        return mutate(rng, data)
    lines = data.decode().split("\n")
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(len(lines))
        if kind == 1:
            lines.insert(rng.randrange(len(lines) + 1), lines[at])
            del lines[rng.randrange(len(lines))]
        elif kind == 2 and lines[at].startswith("# ") and ":" in lines[at]:
            key = lines[at].partition(":")[0]
            lines[at] = f"{key}: {json.dumps(rng.choice(VALUES))}"
        else:
            separator = "\t" if "\t" in lines[at] else ","
            cells = lines[at].split(separator)
            cells[rng.randrange(len(cells))] = rng.choice(CELLS)
            lines[at] = separator.join(cells)
    return "\n".join(lines).encode()


def odd_archive(rng: random.Random, data: bytes, mutate: Mutate) -> bytes:
    """Another member or description under a right check sum; or bytes of the archive anywhere."""
    if rng.randrange(4) == 0:
        return mutate(rng, data)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    names = list(members)
    kind = rng.randrange(4)
    if kind == 0:
        meta = json.loads(members["meta.json"])
        _change(rng, meta)
        members["meta.json"] = json.dumps(meta).encode()
    elif kind == 1:
        name = rng.choice(names)
        members[name] = mutate(rng, members[name])
    elif kind == 2:
        members[rng.choice(names)] = members[rng.choice(names)]
    else:
        # One number of a column: still a good file of another content, or of none.
        name = rng.choice(names[1:])
        column = bytearray(members[name])
        if len(column) > 136:
            at = 128 + 8 * rng.randrange((len(column) - 128) // 8)
            column[at : at + 8] = rng.choice(
                (rng.randbytes(8), b"\xff" * 8, b"\xff" * 7 + b"\x7f", bytes(8))
            )
        members[name] = bytes(column)
    out = io.BytesIO()
    packing = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with zipfile.ZipFile(out, "w", packing) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return out.getvalue()


def _odd_mcap(rng: random.Random, mutate: Mutate) -> bytes:
    """Records changed, lost, swapped, packed into chunks that lie; or bytes anywhere."""
    data = seeds()["recording-mcap"]
    if rng.randrange(4) == 0:
        return mutate(rng, data)
    records, at = [], len(_MAGIC)
    while at < len(data) - len(_MAGIC):
        kind, length = _RECORD.unpack_from(data, at)
        records.append((kind, data[at + _RECORD.size : at + _RECORD.size + length]))
        at += _RECORD.size + length
    at = rng.randrange(len(records))
    kind, content = records[at]
    change = rng.randrange(6)
    if change == 0:
        records[at] = (kind, mutate(rng, content))
    elif change == 1:
        del records[at]
    elif change == 2:
        records.insert(rng.randrange(len(records)), records[at])
    elif change == 3:
        records = [(k, _other_text(rng, c)) for k, c in records]
    elif change == 4:
        records[at] = (rng.choice((kind, rng.randrange(256))), content[: rng.randrange(40)])
    else:
        ends = sorted(rng.sample(range(len(records)), 2))
        records[slice(*ends)] = [(6, _chunk(rng, records[slice(*ends)]))]
    return _MAGIC + b"".join(_RECORD.pack(k, len(c)) + c for k, c in records) + _MAGIC


def _other_text(rng: random.Random, content: bytes) -> bytes:
    """Change a value of the description that is in a schema or at the head of a block."""
    begin, end = content.find(b"{"), content.rfind(b"}") + 1
    try:
        head = json.loads(content[begin:end])
    except ValueError:
        return content
    _change(rng, head)
    text = json.dumps(head).encode()
    before = content[: max(begin - 4, 0)] + struct.pack("<I", len(text))
    return before + text + content[end:]


def _chunk(rng: random.Random, records: list[tuple[int, bytes]]) -> bytes:
    """Pack records as a tool does, whole or with another size, or by a way that is none."""
    inside = b"".join(_RECORD.pack(k, len(c)) + c for k, c in records)
    if rng.random() < 0.1:
        inside += bytes(1 << 22)  # zeros pack well
    way = rng.choice(("", "lz4", "zstd", "zip"))
    pack = {"lz4": lz4.frame.compress, "zstd": zstandard.compress}
    packed = pack[way](inside) if way in pack else inside
    if rng.random() < 0.2:
        packed = packed[: rng.randrange(len(packed) + 1)]
    size = rng.choice((len(inside), len(inside), 0, 1, 1 << 40, (1 << 64) - 1))
    name = way.encode()
    head = struct.pack("<QQQII", 0, 0, size, 0, len(name)) + name
    return head + struct.pack("<Q", len(packed)) + packed


def _change(rng: random.Random, node: object) -> None:
    """Replace, take away or add one value somewhere in a description."""
    while True:
        if isinstance(node, dict) and node:
            key = rng.choice(list(node))
        elif isinstance(node, list) and node:
            key = rng.randrange(len(node))
        else:
            return
        below = node[key]
        if isinstance(below, dict | list) and below and rng.random() < 0.7:
            node = below
            continue
        if rng.random() < 0.2:
            del node[key]
        else:
            node[key] = rng.choice(VALUES)
        return
