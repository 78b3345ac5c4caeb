"""Programs with parameters, expressions and O words for ``fuzz.py``."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

Mutate = Callable[[random.Random, bytes], bytes]

_GOOD, _GOOD_STEPS = 13, 5  # of the values and steps, those that are right nearly everywhere
_VALUES = (
    "#1", "#2", "#<a>", "#5420", "#<_x>", "[#1 + 1]", "[{n} * #<a>]", "[#1 LT 3]", "SIN[{n}]",
    "{n}", "[ATAN[#1]/[#2]]", "[[{n}]]", "[#1 MOD 3 AND #2]", "[SQRT[#2] / #1]", "#[#1+1]", "#40",
    "#<_g>", "EXISTS[#<a>]", "[1 / 0]", "[2 ** #2 ** 9]", "-#1", "[EXP[#1]]", "#5221",
    "#99999", "[", "#<", "]",
)  # fmt: skip
_STEPS = (
    "#1 = {v}", "#<a> = {v} #2 = {v}", "#<_g> = {v}", "G0 X{v}", "G1 X{v} A{v} F100",
    "G2 X{v} Y{v} R{v}", "G[{v}] X1", "G91", "G90", "G20", "G55", "G92 X{v}", "M2", "(a", "; #1",
    "M98 P2", "O5", "G4 P{v}",
    "o{l} break", "o{l} continue", "o{l} return [{v}]", "o{l} call [{v}] [{v}]", "o[{v}] call",
    "o{l} what", "o{l} error [1]", "X{v}", "%", "#{v} = {v}",
)  # fmt: skip
_PAIRS = (
    ("o{l} if [{v}]", "o{l} endif"), ("o{l} while [{v} EQ 7]", "o{l} endwhile"),
    ("o{l} do", "o{l} while [{v} EQ 7]"), ("o{l} repeat [{v}]", "o{l} endrepeat"),
    ("o{l} sub", "o{l} endsub [{v}]"), ("o{l} while [{v}]", "o{l} endwhile"),
    ("o{l} if [{v}]", "o{l} else"),
)  # fmt: skip


def parametric_program(rng: random.Random, mutate: Mutate) -> bytes:
    """Blocks in blocks with parameters, sometimes without their ends, sometimes mutated."""
    lines = ["#1=1 #2=2 #<a>=3", "G21 G90 F100"]

    def filled(text: str, label: str) -> str:
        while "{v}" in text and len(text) < 300:
            values = _VALUES if rng.random() < 0.1 else _VALUES[:_GOOD]
            text = text.replace("{v}", rng.choice(values), 1)
        number = rng.choice(("0", "2", "-2.5", "1e3", ".5"))
        return text.replace("{n}", number).replace("{v}", "1").replace("{l}", label)

    def block(depth: int) -> None:
        for _ in range(rng.randint(1, 3)):
            label = rng.choice(("1", "2", "3", "<w>", str(rng.randint(10, 99))))
            if depth < 4 and rng.random() < 0.4:
                begin, end = rng.choice(_PAIRS)
                lines.append(filled(begin, label))
                block(depth + 1)
                if rng.random() < 0.95:
                    lines.append(filled(end, label))
            else:
                steps = _STEPS if rng.random() < 0.15 else _STEPS[:_GOOD_STEPS]
                lines.append(filled(rng.choice(steps), label))

    block(0)
    data = "\n".join([*lines, "G0 X1", "M30"]).encode()
    return mutate(rng, data) if rng.random() < 0.3 else data


def fluidnc_program(rng: random.Random, mutate: Mutate) -> bytes:
    """The same with #41 and #42: FluidNC reads no parameter below #31."""
    return re.sub(rb"#(?=[12]\b)", b"#4", parametric_program(rng, mutate))
