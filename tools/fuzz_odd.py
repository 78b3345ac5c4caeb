"""Odd files wherever a command line takes one, and numbers of all sizes where something is studied.

What ``tools/fuzz_commands.py`` runs as the classes ``odd-files`` and ``studies``.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable

Words = list[str]
Files = dict[str, str | bytes]
Number = Callable[[random.Random, str, str], str]

ODD: dict[str, bytes] = {
    "empty": b"",
    "newline": b"\n",
    "nul": bytes(4096),
    "bom": b"\xef\xbb\xbf",
    "utf16": "name = 'a'\n".encode("utf-16"),
    "latin": "name = 'Käfig'\n".encode("latin-1"),
    "binary": bytes(range(256)) * 8,
    "one-line": b"X1 " * 100_000,
    "digits": b"9" * 100_000,
    "brackets": b"[" * 20_000,
    "braces": b"a = " + b"{a=" * 5_000,
    "quotes": b'"' * 9_999,
    "zip": b"PK\x05\x06" + bytes(18),
    "gzip": b"\x1f\x8b\x08" + bytes(40),
    "percent": b"%\n%\n",
    "crlf": b"x [mm],y [mm]\r\n10,10\r\n30,10\r\n",
    "cr": b"x [mm],y [mm]\r10,10\r30,10\r",
    "xml": b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>',
    "json": b'{"a": NaN, "b": 1e999}',
    "toml": b'name = "a"\nbase = "a.toml"\n',
    "dates": b"name = 1979-05-27T07:32:00Z\nx = 0x1F\ny = inf\n",
    "header": b"time [s],X [mm]\n",
    "one-row": b"time [s],X [mm]\n0,0\n",
    "columns": b",".join(b"X%d [mm]" % k for k in range(3000)) + b"\n" + b"1," * 2999 + b"1\n",
    "cam": b"alpha [deg],h [mm]\n"  # a cycloidal rise of 20 mm over 90 degrees
    + b"".join(
        b"%.1f,%.3f\n" % (2.5 * k, 50 + 20 * (k / 36 - math.sin(k / 18 * math.pi) / math.tau))
        for k in range(37)
    ),
    "cam-noise": b"alpha [deg],h [mm]\n"
    + b"".join(b"%d,%d\n" % (10 * k, (k * 7919) % 13) for k in range(37)),
}
ENDINGS = (
    ".prg", ".nc", ".toml", ".seam.toml", ".csv", ".svg", ".dxf", ".npz", ".plt", ".par", "",
    ".spec.toml", ".ticks", ".PRG", ".html",
)  # fmt: skip
PLACES: tuple[Words, ...] = (
    ["prove", "@", "-m", "lathe-winder"],
    ["prove", "@", "-m", "stitcher", "--feed", "10 mm/s"],
    ["prove", "@", "-m", "letter-placer"],
    ["prove", "short.prg", "-m", "@"],
    ["prove", "short.prg", "-m", "lathe-winder", "-s", "@"],
    ["prove", "short.prg", "-m", "lathe-winder", "--par", "@"],
    ["prove", "short.prg", "-m", "lathe-winder", "--actual", "@"],
    ["prove", "short.prg", "-m", "lathe-winder+@"],
    ["compare", "@", "-m", "lathe-winder", "--interpolation", "linear"],
    ["compare", "short.prg", "-m", "@", "--interpolation", "linear"],
    ["fastest", "@", "-m", "letter-placer"],
    ["fastest", "short.prg", "-m", "lathe-winder", "-s", "@", "--interpolation", "linear"],
    ["design", "short.prg", "-m", "@", "-s", "@"],
    ["design", "@", "-m", "lathe-winder", "-s", "lathe-winder.spec.toml"],
    ["compile", "@", "-m", "lathe-winder", "--target", "csv", "-o", "out.x"],
    ["compile", "short.toml", "-m", "@", "--target", "st", "-o", "out.x"],
    ["compile", "short.prg", "-m", "lathe-winder", "--target", "@", "-o", "out.x"],
    ["judge", "@"],
    ["judge", "@", "--job", "short.prg", "-m", "lathe-winder"],
    ["judge", "@", "--job", "short.toml", "-m", "letter-placer"],
    ["judge", "@", "--job", "short.seam.toml", "-m", "stitcher"],
    ["judge", "@", "@"],
    ["analyse", "@"],
    ["analyse", "lathe-winder", "--data", "@"],
    ["analyse", "letter-placer+@"],
    ["machines", "--show", "@"],
    ["verify", "@"],
    ["cam", "@", "--b", "60 mm", "--c", "100 mm"],
    ["cam", "@"],
    ["new", "winder", "@"],
    ["new", "@", "fresh"],
    ["new", "grbl", "fresh", "--from", "@"],
    ["run", "@", "-m", "lathe-winder", "--link", "sim"],
    ["yield", "@", "-m", "lathe-winder", "--variants", "2"],
    ["yield", "short.prg", "-m", "lathe-winder", "--variants", "2", "--resume", "@"],
    ["yield", "--merge", "@"],
    ["prove", "short.prg", "-m", "lathe-winder", "--nominal", "--law", "@"],
    ["law", "@"],
    ["@"],
    ["prove", "@", "@", "@"],
)


def odd_file(rng: random.Random) -> tuple[Words, Files]:
    """Put a file that is none, or of another kind, where one is read."""
    words = list(rng.choice(PLACES))
    files: Files = {}
    known = ("short.prg", "short.seam.toml", "line.csv", "short.toml", "lathe-winder.spec.toml")
    special = (
        ".", "..", "/", "", " ", "-", "--", "folder.csv", "loop.csv", "dangling.csv", "fifo.csv",
        "kept.csv", "no/such", "/dev/null", "/dev/zero", "/dev/full", "/proc/self/mem", "~", "*",
        "a\x00b", "\udcff.prg", "x" * 5000, "lathe-winder", "stitcher+", "+", "http://a/b.prg",
    )  # fmt: skip
    for at, word in enumerate(words):
        if "@" not in word:
            continue
        kind = rng.random()
        if kind < 0.6:
            name = "odd" + rng.choice(ENDINGS)
            files[name] = ODD[rng.choice(sorted(ODD))]
            if rng.random() < 0.2:
                data = bytearray(files[name])  # type: ignore[arg-type]
                for _ in range(rng.choice((1, 5, 50))):
                    if data:
                        data[rng.randrange(len(data))] = rng.randrange(256)
                files[name] = bytes(data)
        else:
            name = rng.choice((*known, *special))
        words[at] = word.replace("@", name)
    if rng.random() < 0.3 and len(words) > 1:
        words.append("--json")
    return words, files


LAWS = (
    "trapezoid", "modified-sine", "cubic", "quintic", "3-4-5", "cycloidal", "seventh",
    "modified-trapezoid", "harmonic", "bang-bang",
)  # fmt: skip


def study(rng: random.Random, number: Number) -> tuple[Words, Files]:
    """Ask ``law``, ``size``, ``cam`` and ``analyse`` with numbers of all sizes."""
    verb = rng.choice(("law", "law", "size", "size", "cam", "analyse"))
    units = {
        "law": {
            "--mode": ("Hz", "12"), "--damping": ("", "0.02"), "--move": ("mm", "50"),
            "--time": ("s", "0.2"), "--mass": ("kg", "0.3"), "--residual": ("mm", "0.1"),
            "--limit": ("mm", "0.5"), "--jerk": ("m/s^3", "100"), "--band": ("%", "10"),
        },
        "size": {
            "--needle-speed": ("stitch/s", "40"), "--stitch-length": ("mm", "2.5"),
            "--speed": ("mm/s", "100"), "--ramp-stitches": ("", "3"), "--placement": ("mm", "0.5"),
            "--turn": ("deg", "90"), "--acceleration": ("m/s^2", "5"), "--load-mass": ("kg", "3"),
            "--load-damping": ("N s/m", "1"), "--friction": ("N", "5"), "--gear-ratio": ("", "2"),
            "--pulley-radius": ("mm", "11"), "--motor-inertia": ("kg m^2", "1e-4"),
            "--motor-damping": ("N m s/rad", "1e-4"), "--torque-constant": ("N m/A", "0.1"),
            "--back-emf": ("V s/rad", "0.1"), "--resistance": ("ohm", "1"),
            "--current-limit": ("A", "10"), "--move": ("mm", "10"), "--move-time": ("ms", "50"),
            "--dwell": ("ms", "20"), "--ramp": ("%", "30"), "--encoder-lines": ("", "1000"),
            "--count-rate": ("kHz", "500"),
        },
        "cam": {
            "--b": ("mm", "60"), "--c": ("mm", "100"), "--roller": ("mm", "8"),
            "--noise": ("mm", "0.05"), "--fairing": ("", "1e-3"), "--start": ("deg", "10"),
            "--end": ("deg", "200"), "--passes": ("", "2"), "--epsilon": ("mm", "0.02"),
        },
        "analyse": {},
    }[verb]  # fmt: skip
    first = {
        "law": ["law", rng.choice(LAWS)],
        "size": ["size"],
        "cam": ["cam", "cam.csv"],
        "analyse": ["analyse", rng.choice(("lathe-winder", "stitcher", "letter-placer"))],
    }[verb]
    words = list(first)
    if verb == "analyse":
        words += rng.choice(([], ["--lead"], ["--experiments"], ["--axis", rng.choice("AXYZQ")]))
    many = rng.choice((0, 1, 2, 3, len(units)))
    for name in rng.sample(sorted(units), min(many, len(units))):
        words += [name, number(rng, *units[name])]
    if verb == "size" and rng.random() < 0.3:
        words += ["--profile", rng.choice((*LAWS, "x"))]
    if rng.random() < 0.3:
        words.append("--json")
    return words, {"cam.csv": ODD[rng.choice(("cam", "cam-noise"))]}
