"""Random programs with parameters, expressions and O words that LinuxCNC or FluidNC accepts."""

from __future__ import annotations

import random
import re
from dataclasses import dataclass, field

_NAMES = ("a", "b", "_g", "_h")
_OPERATORS = "+ - * + - * / ** MOD and OR xor eq NE gt LT ge le".split()  # noqa: SIM905 - a table
_FUNCTIONS = (
    "ABS{0}", "COS{0}", "SIN{0}", "FIX{0}", "FUP{0}", "ROUND{0}", "ATAN{0}/{1}", "sqrt[abs{0}]",
    "EXISTS[#<b>]", "EXISTS[#<zz>]", "ACOS[sin{0}]", "ASIN[sin{0}]", "exp[sin{0}]",
    "ln[1+abs{0}]", "tan[30*sin{0}]",
)  # fmt: skip


@dataclass
class Maker:
    """Makes a program; nearly all programs end, and have a value wherever one is read.

    FluidNC has no subroutines and no names as labels, and the machine of its tests has no A.
    """

    rng: random.Random
    fluidnc: bool = False
    lines: list[str] = field(default_factory=list)
    subs: list[str] = field(default_factory=list)
    labels: int = 100
    room: int = 0

    def number(self) -> str:
        """Return a number as people write them."""
        rng = self.rng
        short = f"{rng.uniform(-9, 9):.{rng.randint(0, 4)}f}"
        return rng.choice((str(rng.randint(-5, 9)), short, f".{rng.randint(1, 9)}"))

    def atom(self, depth: int) -> str:
        """Return a value without an operator."""
        rng = self.rng
        kind = rng.random()
        if kind < 0.35 or depth > 3:
            return self.number() if rng.random() < 0.5 else f"#{rng.choice((1, 2, 3, 31, 32))}"
        if kind < 0.5:
            return f"#<{rng.choice(_NAMES)}>"
        if kind < 0.55:
            return f"#[{rng.choice((1, 30))}+{rng.randint(1, 2)}]"
        if kind < 0.75:
            return self.expression(depth + 1)
        if kind < 0.8:
            return "-" + self.atom(depth + 1).lstrip("+-")
        work = rng.choice(_FUNCTIONS)
        return work.format(*(self.expression(depth + 1) for _ in range(work.count("{"))))

    def expression(self, depth: int = 0) -> str:
        """Return an expression in brackets."""
        rng, text = self.rng, self.atom(depth)
        for _ in range(rng.choice((0, 1, 1, 2))):
            operator = rng.choice(_OPERATORS)
            if operator == "/":
                right = f"[1+abs{self.expression(depth + 2)}]"
            elif operator in {"**", "MOD"}:
                right = str(rng.randint(0, 2) if operator == "**" else rng.randint(2, 9))
            else:
                right = self.atom(depth + 1)
            text += f" {operator} {right}"
        return f"[{text}]"

    def small(self) -> str:
        """Return an expression of at most 20."""
        return f"[{self.expression()} MOD 20]"

    def label(self) -> str:
        """Return a label that no other block has."""
        self.labels += 1
        named = self.rng.random() >= 0.7 and not self.fluidnc
        return f"<l {self.labels}>" if named else str(self.labels)

    def counted(self, word: str, depth: int, loops: list[str]) -> None:
        """Add a loop with a counter."""
        label, most = self.label(), self.rng.randint(0, 3)
        count = f"#<c{self.labels}>"
        test = f"while [{count} lt {most}]"
        self.lines += [f"{count}=0", f"o{label} {test if word == 'while' else 'do'}"]
        self.lines.append(f"{count}=[{count}+1]")
        self.block(depth + 1, [*loops, label])
        self.lines.append(f"o{label} {'endwhile' if word == 'while' else test}")

    def branched(self, depth: int, loops: list[str]) -> None:
        """Add an if."""
        label = self.label()
        self.lines.append(f"o{label} if {self.expression()}")
        self.block(depth + 1, loops)
        if self.rng.random() < 0.4:
            self.lines.append(f"o{label} elseif {self.expression()}")
            self.block(depth + 1, loops)
        if self.rng.random() < 0.5:
            self.lines.append(f"o{label} else")
            self.block(depth + 1, loops)
        self.lines.append(f"o{label} endif (end)")

    def block(self, depth: int, loops: list[str]) -> None:
        """Add a few lines and blocks."""
        rng = self.rng
        for _ in range(rng.randint(1, 4)):
            self.room -= 1
            if self.room < 0:
                return
            kind = rng.random() if depth <= 3 else rng.uniform(0.0, 0.5)
            if kind < 0.3:
                also = f" #{rng.choice((1, 2, 3, 31))}={self.small()}" if rng.random() < 0.3 else ""
                axes = "XYZ" if self.fluidnc else "XYZA"
                self.lines.append(f"G{rng.choice('01')} {rng.choice(axes)}{self.small()}{also}")
            elif kind < 0.5:
                to = rng.choice(("1", "2", "3", "31", "32", "<a>", "<b>", "<_g>"))
                self.lines.append(f"#{to} = {self.small()}")
            elif kind < 0.62:
                self.branched(depth, loops)
            elif kind < 0.78:
                self.counted(rng.choice(("while", "do")), depth, loops)
            elif kind < 0.85:
                label = self.label()
                self.lines.append(f"o{label} repeat [{rng.choice(('0', '1', '2', '2.5', '-1'))}]")
                self.block(depth + 1, loops)
                self.lines.append(f"o{label} endrepeat")
            elif kind < 0.9 and loops:
                label, word = self.label(), rng.choice(("break", "continue"))
                self.lines += [f"o{label} if {self.expression()}", f" o{rng.choice(loops)} {word}"]
                self.lines.append(f"o{label} endif")
            elif self.subs and rng.random() < 0.8:
                given = " ".join(self.small() for _ in range(rng.randint(0, 3)))
                self.lines += [f"o{rng.choice(self.subs)} call {given}", "G1 Y[#<_value> MOD 20]"]
            else:
                at = "#31 / 3" if self.fluidnc else "#5420 / 3 + #<_y>/4 + #5423/7"
                self.lines.append(f"G0 Z[{at}]")


def random_parametric(seed: int, fluidnc: bool = False) -> str:
    """Return a program; a line may be too long for the control, or a loop without an end.

    FluidNC keeps no values in #1 to #30: those of its programs are #41 to #43.
    """
    maker = Maker(random.Random(seed), fluidnc)
    lines = maker.lines
    lines += ["G21 G90 G94 F600", "#1=1 #2=2 #3=3 #31=4 #32=5", "#<_g>=2 #<_h>=0.5 #<a>=1 #<b>=2"]
    for k in range(0 if fluidnc else maker.rng.randint(0, 2)):
        name = str(k + 1) if maker.rng.random() < 0.5 else f"<s u b{k}>"
        lines += [f"o{name} sub", "#<a>=#1 #<b>=[#2+1]"]
        maker.room = 15
        maker.block(1, [])
        if maker.rng.random() < 0.3:
            label = maker.label()
            lines += [f"o{label} if {maker.expression()}", f"o{name} return {maker.small()}"]
            lines.append(f"o{label} endif")
        maker.block(1, [])
        lines.append(f"o{name} endsub {maker.small() if maker.rng.random() < 0.5 else ''}")
        maker.subs.append(name)
    maker.room = 40
    maker.block(0, [])
    text = "\n".join([*lines, "G1 X1", "M2"]) + "\n"
    return re.sub(r"(#\[?)(?=[123]\b)", r"\g<1>4", text) if fluidnc else text
