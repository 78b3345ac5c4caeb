"""Peak memory, time and silence of inputs that are out of all proportion.

    python -m tools.memory_bounds [--only NAME] [--folder DIR]

Every case is one command of its own process. It may be refused, but in one line; it may take long,
but never says nothing for a minute; and it never holds more than 1 GB. The exit status is 1 where
a case is beyond one of the bars.
"""

from __future__ import annotations

import argparse
import os
import re
import select
import subprocess
import sys
import tempfile
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples"
MOST_MB = 1000
MOST_SILENCE_S = 60.0
MOST_S = 300.0  # of the processor: a case is ended then, and how long it would go on is not known
PLACER = "letter-placer"
SHORT = "%\nO 1;\nN 10 G91 G01 X 5 F 2160;\nN 20 M30;\n%\n"
Case = Callable[[Path], list[str]]


def slow_recording(folder: Path) -> list[str]:
    """A reversal at a speed that takes two days, recorded."""
    return [
        "prove", str(EXAMPLES / "x-180.prg"), "-m", "lathe-winder", "--interpolation", "cubic",
        "--feed", "0.0009 mm/s", "--recording", str(folder / "out.npz"),
    ]  # fmt: skip


def slow(folder: Path) -> list[str]:  # noqa: ARG001 - as the others
    """The same without a recording."""
    return [
        "prove", str(EXAMPLES / "x-180.prg"), "-m", "lathe-winder", "--interpolation", "cubic",
        "--feed", "0.0009 mm/s",
    ]  # fmt: skip


def _bomb(folder: Path, parts: int, *, text: bool) -> list[str]:
    """An archive whose columns end in ``parts`` times 16 MB of zeros, packed a thousand-fold.

    Where ``outcomes``, the heads of the columns count them too, and all check sums are right.
    """
    path = folder / f"bomb-{parts}-{text}.npz"
    small = folder / "seed.npz"
    subprocess.run(
        [sys.executable, "-m", "threadline", "prove", str(EXAMPLES / "x-180.prg"), "-m",
         "lathe-winder", "--interpolation", "linear", "--nominal", "--recording", str(small)],
        check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    with zipfile.ZipFile(small) as seed, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as made:
        channels = [n for n in seed.namelist() if n.endswith((".load.npy", ".commanded.npy"))]
        for name in seed.namelist():
            count = parts // len(channels) if name in channels else 0
            content = seed.read(name)
            if text and count:
                content = _longer(content, count * len(_ZEROS) // 8)
            with made.open(name, "w", force_zip64=True) as member:
                member.write(content)
                _write_zeros(member, count)
    return ["judge", str(path)]


_ZEROS = bytes(1 << 24)


def _longer(column: bytes, rows: int) -> bytes:
    """Return a column of numpy whose head promises so many rows more."""
    size = 12 + int.from_bytes(column[8:12], "little")
    head = re.sub(rb"\((\d+),\), \}", lambda m: b"(%d,), }" % (int(m[1]) + rows), column[12:size])
    head = head.rstrip(b" \n").ljust(size - 13) + b"\n"
    return column[:8] + len(head).to_bytes(4, "little") + head + column[size:]


def _write_zeros(member: Any, count: int) -> None:
    """Add ``count`` times ``_ZEROS`` that were packed once: the check sum is linear in itself."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = packer.compress(_ZEROS) + packer.flush(zlib.Z_FULL_FLUSH)
    none = zlib.crc32(_ZEROS, 0)
    bits = [zlib.crc32(_ZEROS, 1 << k) ^ none for k in range(32)]
    before = member._compressor.flush(zlib.Z_FULL_FLUSH)
    member._fileobj.write(before)
    member._compress_size += len(before)
    for _ in range(count):
        member._fileobj.write(packed)
        member._compress_size += len(packed)
        member._file_size += len(_ZEROS)
        crc = none
        for k in range(32):
            crc ^= bits[k] if member._crc >> k & 1 else 0
        member._crc = crc


def _moves(folder: Path, name: str, count: int, *rows: str) -> str:
    path = folder / f"{name}.toml"
    body = "\n".join(f"[[operation]]\n{row}\n" for row in rows)
    path.write_text(
        f'name = "{name}"\n[[operation]]\nstep = "start"\nvalve = "main_air"\n' + body * count
    )
    return str(path)


def moves_800(folder: Path) -> list[str]:
    """An on/off list of 800 moves."""
    rows = ('step = "down"\nmove = { Z = "100 mm" }', 'wait = "z_is_down"')
    back = ('step = "up"\nmove = { Z = "0 mm" }', 'wait = "z_is_up"')
    return ["prove", _moves(folder, "moves", 400, *rows, *back), "-m", PLACER]


def operations_1e5(folder: Path) -> list[str]:
    """An on/off list of 100 000 operations."""
    return ["prove", _moves(folder, "many", 100_000, 'dwell = "10 ms"'), "-m", PLACER]


def dwell_30_min(folder: Path) -> list[str]:
    """An on/off machine that stands for half an hour."""
    return ["prove", _moves(folder, "stands", 1, 'dwell = "30 min"'), "-m", PLACER]


def _delay(folder: Path, delay: str) -> list[str]:
    path = folder / f"delay-{delay}.toml"
    path.write_text(f'base = "{PLACER}"\ncylinders.Z.delay = "{delay} s exact, assumed"\n')
    return ["prove", str(EXAMPLES / "letter-cycle.toml"), "-m", str(path)]


def _sewn(drawing: Path) -> list[str]:
    seam = drawing.with_suffix(".seam.toml")
    seam.write_text(
        f'[drawing]\nfile = "{drawing.name}"\n\n[stitching]\nstitch_length = "2.5 mm"\n'
        'needle_speed = "20 stitch/s"\n'
    )
    return ["prove", str(seam), "-m", "stitcher"]


def short_lines(folder: Path) -> list[str]:
    """A drawing of 64 000 lines of 0.1 mm."""
    path = folder / "short.dxf"
    rows = ["0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n"]
    rows.append("0\nSECTION\n2\nENTITIES\n")
    for k in range(64_000):
        x, y = 0.1 * (k % 800), 1.0 * (k // 800)
        rows.append(f"0\nLINE\n8\nA\n10\n{x:.3f}\n20\n{y:.3f}\n11\n{x + 0.1:.3f}\n21\n{y:.3f}\n")
    path.write_text("".join(rows) + "0\nENDSEC\n0\nEOF\n")
    return _sewn(path)


def long_text(folder: Path) -> list[str]:
    """A drawing with a text of 1 MB."""
    path = folder / "text.dxf"
    text = "collar " * 150_000
    path.write_text(
        "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n"
        "0\nSECTION\n2\nENTITIES\n"
        "0\nLINE\n8\nA\n10\n10\n20\n10\n11\n30\n21\n10\n"
        f"0\nTEXT\n8\nA\n10\n0\n20\n0\n40\n5\n1\n{text}\n0\nENDSEC\n0\nEOF\n"
    )
    return _sewn(path)


def blocks_in_blocks(folder: Path) -> list[str]:
    """Nine levels of ten copies each: a thousand million lines."""
    path = folder / "blocks.dxf"
    rows = ["0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n"]
    rows.append("0\nSECTION\n2\nBLOCKS\n")
    for k in range(10):
        rows.append(f"0\nBLOCK\n8\n0\n2\nB{k}\n70\n0\n10\n0\n20\n0\n")
        if k == 0:
            rows.append("0\nLINE\n8\nA\n10\n0\n20\n0\n11\n1\n21\n0\n")
        for j in range(10 if k else 0):
            rows.append(f"0\nINSERT\n8\nA\n2\nB{k - 1}\n10\n{j}\n20\n0\n")
        rows.append("0\nENDBLK\n8\n0\n")
    rows.append("0\nENDSEC\n0\nSECTION\n2\nENTITIES\n0\nINSERT\n8\nA\n2\nB9\n10\n0\n20\n0\n")
    path.write_text("".join(rows) + "0\nENDSEC\n0\nEOF\n")
    return _sewn(path)


def crawling(folder: Path) -> list[str]:
    """An axis that may move at 1e-12 m/s."""
    (folder / "crawl.toml").write_text(
        'base = "lathe-winder"\naxes.X.velocity = "1e-12 m/s exact, assumed"\n'
    )
    (folder / "short.prg").write_text(SHORT)
    return ["prove", str(folder / "short.prg"), "-m", str(folder / "crawl.toml")]


def _modes(*words: str) -> Case:
    return lambda _: ["shaper", *words]


CASES: dict[str, Case] = {
    "x-180, cubic, 0.0009 mm/s": slow,
    "x-180, cubic, 0.0009 mm/s, --recording": slow_recording,
    "judge an npz of 5 MB that unpacks to 5 GB": lambda f: _bomb(f, 300, text=False),
    "judge an npz of 48 MB that unpacks to 48 GB": lambda f: _bomb(f, 2880, text=False),
    "the same with all counts and check sums right": lambda f: _bomb(f, 2880, text=True),
    "on/off list of 800 moves": moves_800,
    "on/off list of 100 000 operations": operations_1e5,
    "on/off list with a dwell of 30 min": dwell_30_min,
    "on/off, delay of 0.123456 s": lambda folder: _delay(folder, "0.123456"),
    "on/off, delay of 0.1234567 s": lambda folder: _delay(folder, "0.1234567"),
    "DXF of 64 000 short lines": short_lines,
    "DXF with a text of 1 MB": long_text,
    "DXF of nine levels of ten blocks": blocks_in_blocks,
    "axis velocity of 1e-12 m/s": crawling,
    "shaper, zv, 452.6 Hz and 1e9 Hz": _modes(
        "--kind", "zv", "--mode", "452.6 Hz", "--mode", "1e9 Hz"
    ),
    "shaper, si, 0.7, 270 and 645 Hz": _modes(
        "--kind", "si", "--mode", "270 Hz", "--mode", "645 Hz", "--mode", "0.7 Hz"
    ),
    "shaper, si, 0.1 and 25 Hz": _modes("--kind", "si", "--mode", "0.1 Hz", "--mode", "25 Hz"),
    "shaper, zv, 3 and 7.5 Hz, --tick 10 ms": _modes(
        "--kind", "zv", "--mode", "3 Hz", "--mode", "7.5 Hz", "--tick", "10 ms"
    ),
}


def used_s(process: int) -> float:
    """Return the processor time of a process so far, in s."""
    words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def measure(words: list[str]) -> tuple[int, float, float, float, float, str]:
    """Run one command; return status, MB, s by the clock and of the processor, silence, and end."""
    began = heard = time.monotonic()
    child = subprocess.Popen(
        [sys.executable, "-m", "threadline", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    assert child.stdout is not None
    output, silence = b"", 0.0
    while True:
        ready, _, _ = select.select([child.stdout], [], [], 1.0)
        now = time.monotonic()
        silence = max(silence, now - heard)
        if ready:
            part = os.read(child.stdout.fileno(), 1 << 16)
            if not part:
                break
            output, heard = output + part, now
        if used_s(child.pid) > MOST_S:
            child.terminate()
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    lines = output.decode("utf-8", "replace").strip().splitlines()
    return (
        child.returncode, used.ru_maxrss / 1024, time.monotonic() - began,
        used.ru_utime + used.ru_stime, silence, lines[-1] if lines else "",
    )  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", help="cases whose name contains this")
    parser.add_argument("--folder", type=Path, help="keep what is made here")
    given = parser.parse_args()
    beyond = 0
    print(
        "| case | status | peak memory | processor time | longest silence |\n|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or Path(temporary)
        folder.mkdir(exist_ok=True)
        for name, case in CASES.items():
            if given.only and given.only not in name:
                continue
            status, mb, took_s, cpu_s, silence_s, last = measure(case(folder))
            row = f"| {name} | {status} | {mb:.0f} MB | {cpu_s:.1f} s | {silence_s:.0f} s |"
            print(row, flush=True)
            print(f"  {took_s:.0f} s by the clock: {last[:300]}", file=sys.stderr, flush=True)
            beyond += mb > MOST_MB or silence_s > MOST_SILENCE_S or status not in {0, 1, 2}
    return 1 if beyond else 0


if __name__ == "__main__":
    sys.exit(main())
