"""Random short programs: valid blocks, and blocks of random words."""

from __future__ import annotations

import random

_NUMBERS = ("0", "1", "-2", "5", "10", "-7.5", "0.125", ".5", "3.", "12.25", "-.25", "4")
_LOOSE = (
    "G0", "G1", "G2", "G3", "G4", "G17", "G18", "G19", "G20", "G21", "G28", "G28.1", "G40", "G49",
    "G53", "G54", "G61", "G80", "G90", "G91", "G91.1", "G92", "G92.1", "G92.2", "G92.3", "G93",
    "G94", "M0", "M3", "M5", "M7", "M8", "M9", "M1", "G64",
)  # fmt: skip
_LETTERS = "XYZXYZXYZFPIJKRSNLQ"


def _block(rng: random.Random) -> str:
    """Return a block that most controls accept."""
    n = lambda: rng.choice(_NUMBERS)  # noqa: E731
    kind = rng.randrange(14)
    x = rng.choice((2, 5, 8, 10, 20))
    if kind < 4:
        axes = "".join(f" {a}{n()}" for a in rng.sample("XYZ", rng.randint(1, 3)))
        return f"{rng.choice(('G0', 'G1', '', 'G1'))}{axes}"
    return (
        f"G1 X{n()} F{rng.choice((60, 500, 1200))}",
        f"G91 G{rng.choice((2, 3))} X{x} R{rng.choice((x, x * 0.75, -x, x / 2, x * 0.4))}",
        f"G91 G{rng.choice((2, 3))} X{x} I{x / 2} J0{rng.choice(('', ' P2', ' Z3', ' K0'))}",
        f"G{rng.choice((2, 3))} I{n()} J{n()}",
        f"G4 P{rng.choice(('0', '.5', '2'))}",
        f"G92 {rng.choice('XYZ')}{n()}",
        rng.choice(("G28", "G28 X1", "G28.1", "G92.1", f"G92.1 Y{n()}", f"G28.1 X{n()}")),
        rng.choice(("G90", "G91", "G20", "G21", "G17", "G80", "G54")),
        rng.choice(("G93", "G94", f"G93 G1 Y{n()} F2", f"G94 G1 Y{n()} F300")),
        rng.choice(("M3 S100", "M5", "M8", "M9", "M0", "N30 G1 X2", "G53 G0 X1")),
    )[kind - 4]


def _loose(rng: random.Random) -> str:
    words = [rng.choice(_LOOSE) for _ in range(rng.randint(0, 2))]
    words += [rng.choice(_LETTERS) + rng.choice(_NUMBERS) for _ in range(rng.randint(0, 4))]
    rng.shuffle(words)
    line = " ".join(words)
    odd = rng.random()
    if odd < 0.04:
        line = line.lower()
    elif odd < 0.08:
        line = f"{line} ({rng.choice(('X5', 'a;b', 'what'))}) Y1"
    elif odd < 0.1:
        line = f"{line} ; comment, with nothing in it"
    elif odd < 0.12:
        line = f"G1 X1.{'0' * rng.randint(40, 90)}1 Y2"
    return line


def random_blocks(seed: int, loose: float = 0.35) -> list[str]:
    """Return the lines of a program; a share ``loose`` of them has random words."""
    rng = random.Random(seed)
    lines = ["G21 G90 G94 G17 G40", "G1 X1 F600"]
    lines += [
        _loose(rng) if rng.random() < loose else _block(rng) for _ in range(rng.randint(1, 5))
    ]
    return [*lines, "G90 G1 X3 Y4 F100"]


def random_commands(seed: int, loose: float = 0.35, *, klipper: bool = False) -> list[str]:
    """Return the lines of a program for a firmware that runs one command per line.

    For ``klipper`` more lines have small letters, I and J, and numbers in front.
    """
    rng = random.Random(seed)
    n = lambda: rng.choice(_NUMBERS)  # noqa: E731
    lines = ["G21", "G90", "G1 X1 F600"]
    if klipper and rng.random() < 0.3:
        lines[2] = "G1 X1"
    for _ in range(rng.randint(1, 6)):
        x = rng.choice((2, 5, 8, 10, 20))
        if rng.random() < loose:
            line = _loose(rng)
        else:
            axes = "".join(f" {a}{n()}" for a in rng.sample("XYZ", rng.randint(1, 3)))
            line = rng.choice(
                (
                    f"G0{axes}",
                    f"G1{axes}",
                    f"G1{axes} F{rng.choice((60, 500, 1200))}",
                    f"G{rng.choice((2, 3))} "
                    + (f"I{n()} J2" if klipper else f"X{x} Y{n()} R{rng.choice((30, -30, 14.5))}"),
                    f"G{rng.choice((2, 3))} I{n()} J{n()}{rng.choice(('', ' Z3', ' P2', ' K1'))}",
                    f"G4 P{rng.choice(('0', '.5', '2', '150.9'))}",
                    f"G4 S{rng.choice(('0', '.5', '2'))} P7",
                    f"G92 {rng.choice('XYZ')}{n()}",
                    rng.choice(("G28", "G28 X", "G28 X0 Y", "G28 X Z1")),
                    rng.choice(("G90", "G91", "G21", "G17", "G20", "G92.1", "G90 X4", "M400")),
                    rng.choice(("G90 G1 X5", "M3 S9", "M84", "M106 S9", "M117 G1 X5", "G21 F50")),
                )
            )
        if klipper and rng.random() < 0.9:
            line = line.replace("G4 S", "G4 P").replace(" P7", "")
        odd = rng.random()
        if odd < 0.02:
            line = line.replace(" ", "\t", 1)
        elif odd < 0.04:
            line = f"\t{line}"
        elif odd < 0.06:
            line = f" {line.replace(' ', '')}; X9"
        elif odd < 0.08:
            line = f"N{rng.choice((1, 1, 2))} {line}"
        elif odd < 0.1:
            line = line.replace("G", "G+")
        elif klipper and odd < 0.2:
            line = rng.choice((line.lower(), f"n7 {line}", f"{line}*{rng.randint(0, 99)}"))
        lines.append(line)
    lines = [f"{one}*{_checksum(one)}" if one.startswith("N1 ") else one for one in lines]
    return [*lines, "G90", "G1 X3 Y4 F100"]


def _checksum(line: str) -> int:
    checksum = 0
    for byte in line.encode():
        checksum ^= byte
    return checksum
