"""Machines of random parts: two axes of bodies in a chain, on a common frame or separate."""

from __future__ import annotations

import numpy as np

FEATURES = (
    "preload", "play", "damped play", "friction", "stiction", "coil", "output limit", "current amp",
    "supply limit", "current limit", "delay", "frame", "switch", "head feedback", "reversal",
    "encoder floor", "encoder truncate", "dac floor", "dac truncate",
)  # fmt: skip
FILTERS = {
    "p": "kp = {p}",
    "pd": "kp = {p}\nkd = {d}",
    "pi": "kp = {p}\nki = {i}",
    "pid": "kp = {p}\nki = {i}\nkd = {d}",
    "lead": 'gain = {d}\nzero = "0.8 exact, assumed"\npole = "0.25 exact, assumed"',
    "proportional-velocity": "gain = {d}",
}


def number(value: float, unit: str = "") -> str:
    """Return a value as text of a machine file."""
    return f'"{value!r} {unit} exact, assumed"'.replace("  ", " ")


class Maker:
    """Writes a machine file; ``used`` names its features."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.roundings = np.random.default_rng(1000 + seed)
        self.used: set[str] = set()
        self.lines: list[str] = []

    def among(self, low: float, high: float) -> float:
        return float(round(np.exp(self.random.uniform(np.log(low), np.log(high))), 12))

    def has(self, feature: str, chance: float = 0.4) -> bool:
        if self.random.random() < chance:
            self.used.add(feature)
            return True
        return False

    def rounding(self, of: str) -> str:
        way = str(self.roundings.choice(["nearest", "floor", "truncate"]))
        if way != "nearest":
            self.used.add(f"{of} {way}")
        return f'rounding = "{way}"'

    def table(self, header: str, *lines: str) -> None:
        self.lines += [f"[{header}]", *(line for line in lines if line)]

    def body(self, name: str, kind: str, inertia: float, damping: float, friction: float) -> None:
        newton, rate = ("N", "N s/m") if kind == "linear" else ("N m", "N m s/rad")
        rubs = friction if self.has("friction", 0.35) else 0.0
        sticks = f"stiction = {number(rubs * self.among(1.05, 1.8), newton)}"
        self.table(
            f"bodies.{name}",
            f'kind = "{kind}"',
            f"inertia = {number(inertia, 'kg' if kind == 'linear' else 'kg m^2')}",
            f"damping = {number(damping, rate)}",
            f"friction = {number(rubs, newton)}" if rubs else "",
            sticks if rubs and self.has("stiction", 0.5) else "",
        )

    def link(self, name: str, weights: str, stiffness: float, damping: float) -> None:
        kind = self.random.choice(["plain", "preload", "play", "damped play"])
        if kind != "plain":
            self.used.add(str(kind))
        damping = 0.0 if kind == "play" else damping
        self.table(
            f"links.{name}",
            f"stretch = {{ {weights} }}",
            f"stiffness = {number(stiffness, 'N/m')}",
            f"damping = {number(damping, 'N s/m')}",
            f"preload = {number(self.among(1.0, 8.0), 'N')}" if kind == "preload" else "",
            f"first_run = {number(self.among(0.2, 0.8))}" if kind == "preload" else "",
            f"play = {number(self.among(5e-5, 4e-4), 'm')}" if "play" in kind else "",
        )

    def drive(self, name: str, axis: str) -> None:
        current = self.has("current amp", 0.25)
        coil = not current and self.has("coil", 0.5)
        limited = self.has("current limit", 0.6)
        mode = "current" if current else "voltage"
        gain = number(self.among(0.3, 1.0), "A/V" if current else "")
        output = coil and limited and self.has("output limit", 0.5)
        parts = [f'mode = "{mode}"', f"gain = {gain}"]
        if limited:
            parts.append(f"current_limit = {number(self.among(1.0, 4.0), 'A')}")
        if self.has("supply limit", 0.4):
            parts.append(f"voltage_limit = {number(self.among(2.0, 6.0), 'V')}")
        if output:
            parts.append('limits = "output"')
        late = self.has("delay", 0.5)
        self.table(
            f"drives.{name}",
            'kind = "dc-motor"',
            f"acts_on = {{ {axis}_motor = {number(1.0)} }}",
            f"torque_constant = {number(0.1, 'N m/A')}",
            f"back_emf = {number(0.1, 'V s/rad')}",
            f"resistance = {number(self.among(0.4, 1.0), 'ohm')}",
            f"inductance = {number(self.among(5e-4, 4e-3), 'H')}" if coil else "",
            f"amplifier = {{ {', '.join(parts)} }}",
            f"delay = {number(round(float(self.random.integers(1, 60)) * 50e-6, 9), 's')}"
            if late
            else "",
        )

    def axis(self, letter: str, frame: bool) -> None:
        name, radius = letter.lower(), self.among(0.008, 0.02)
        self.body(f"{name}_motor", "rotary", self.among(1e-4, 4e-4), 1e-3, 0.02)
        self.body(f"{name}_head", "linear", self.among(0.5, 3.0), self.among(1.0, 8.0), 4.0)
        on_frame = f", frame = {number(-1.0)}" if frame else ""
        weights = (
            f"{name}_motor = {number(radius, 'm/rad')}, {name}_head = {number(-1.0)}{on_frame}"
        )
        self.link(f"{name}_belt", weights, self.among(8e3, 4e4), self.among(5.0, 30.0))
        self.drive(name, name)
        # An encoder behind a play would limit-cycle; unstable loops prove nothing.
        at_head = self.has("head feedback", 0.15)
        counts = 500.0 / radius
        read = (
            f"{name}_head = {number(counts, 'count/m')}"
            if at_head
            else f"{name}_motor = {number(500.0, 'count/rad')}"
        )
        self.table(
            f"sensors.{name}", 'kind = "encoder"', f"reads = {{ {read} }}", self.rounding("encoder")
        )
        filtered = str(self.random.choice(list(FILTERS)))
        gains = {
            "p": number(self.among(0.4, 2.0), "dac/count"),
            "i": number(self.among(0.005, 0.03), "dac/count"),
            "d": number(self.among(1.0, 5.0), "dac/count"),
        }
        swap = "true" if self.has("reversal", 0.3) else "false"
        bits = int(self.random.choice([8, 10, 12]))
        fast = bool(self.random.random() < 0.5)
        self.table(
            f"controllers.{name}",
            f'kind = "{filtered}"',
            'clock = "fast"' if fast else 'clock = "servo"',
            'reference_clock = "servo"' if fast else "",
            f'sensor = "{name}"',
            f'drive = "{name}"',
            FILTERS[filtered].format(**gains),
            f"dac = {{ bits = {number(bits, 'bit')}, range = {number(10.0, 'V')}, "
            f"zero_on_reversal = {swap}, {self.rounding('dac')} }}",
        )
        self.table(
            f"axes.{letter}",
            'kind = "linear"',
            f'controller = "{name}"',
            f"counts = {number(counts, 'count/m')}",
            f"velocity = {number(1.0, 'm/s')}",
            f"acceleration = {number(10.0, 'm/s^2')}",
            "endless = true",
            f"load = {{ {name}_head = {number(1.0)} }}",
            f"frame = {{ frame = {number(1.0)} }}" if frame else "",
        )
        if self.has("switch", 0.2):
            self.table(
                f"inputs.{name}_high",
                'kind = "limit-switch"',
                f'axis = "{letter}"',
                f"at = {number(self.among(0.005, 0.015), 'm')}",
                'beyond = "above"',
                f'cuts = "{name}"',
            )

    def text(self) -> str:
        head = [
            'name = "random"',
            'title = "random parts"',
            'sources = ["made for a test"]',
            f"tick_budget = {number(1e9, 'tick')}",
        ]
        self.table("clocks", 'servo = "2 ms exact, assumed"', 'fast = "400 us exact, assumed"')
        frame = self.has("frame", 0.5)
        if frame:
            self.body("frame", "linear", self.among(4.0, 20.0), 5.0, 2.0)
            self.link(
                "frame_mount", f"frame = {number(1.0)}", self.among(4e4, 4e5), self.among(30, 200)
            )
        for letter in "XY":
            self.axis(letter, frame)
        return "\n".join(head + self.lines) + "\n"
