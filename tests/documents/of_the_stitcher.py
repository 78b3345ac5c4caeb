"""The quick commands of docs/results-stitcher.md."""

from __future__ import annotations

import re
from typing import Any

from tests.documents.quick import Answer, Figures, Quick, at, contour, of

DOCUMENT = "results-stitcher.md"
SEAM = "examples/stitcher-test-path.seam.toml"
BY_PLACE = ["--nominal", "-s", "examples/stitcher-place.spec.toml"]
length = of("stitch_length_error", times=100.0)


def axis(name: str, *path: str | int, times: float = 1.0) -> Answer:
    return at("axes", name, *path, times=times)


def both(*path: str | int, times: float = 1.0) -> list[Answer]:
    return [axis("X", *path, times=times), axis("Y", *path, times=times)]


def routh_over(name: str) -> list[Answer]:
    """Sampled, continuous and Routh's gain margin of an axis, and by how many % Routh is above."""
    exact = axis(name, "continuous", "gain_margin")
    routh = axis(name, "routh_pade_gains", 0, 1)
    return [
        axis(name, "gain_margin"), exact, routh, lambda d: 100.0 * (routh(d) / exact(d) - 1.0)
    ]  # fmt: skip


def warned(pattern: str, number: int = 0) -> Answer:
    """Return what finds a number in the warnings."""

    def found(said: Any) -> float:
        return float(re.findall(pattern, " ".join(said["warnings"]))[number])

    return found


def tried(name: str, key: str, times: float = 1.0) -> Answer:
    """Return what finds a figure of an axis' experiments."""
    return axis(name, "experiments", key, times=times)


def experiment(number: int) -> list[Answer]:
    """The head's place in inches, overshoots of motor and head in %, rise of the motor in ms."""
    step = ("axes", "X", "experiments", "steps", number)
    return [
        at(*step, "load", times=1.0 / 0.0254), at(*step, "overshoot", times=100.0),
        at(*step, "load_overshoot", times=100.0), at(*step, "rise_s", times=1e3),
    ]  # fmt: skip


QUICK = [
    Quick(
        DOCUMENT,
        "threadline analyse stitcher --json",
        [
            Figures(
                "natural frequency, damping | 500 rad/s, 0.7 | {} rad/s, {} | from J",
                [axis("X", "actuator", "natural_rad_s"), axis("X", "actuator", "damping")],
            ),
            Figures(
                "| actuator, Y | 400 rad/s, 0.7 | {} rad/s, {} |",
                [axis("Y", "actuator", "natural_rad_s"), axis("Y", "actuator", "damping")],
            ),
            Figures(
                "| {} rad/s/V | {} with the load's damping |",
                [axis("X", "dc_gain"), axis("X", "dc_gain_loaded")],
            ),
            Figures("| {} rad/s/V | an amplifier gain", [axis("Y", "dc_gain")]),
            Figures(
                "motor locked, X | 12 Hz | {} Hz, damping {} |",
                [axis("X", "modes_hz", 0), axis("X", "modes_damping", 0)],
            ),
            Figures(
                "motor locked, Y | 15 and 30 Hz | {} and {} Hz | damping {} and {} |",
                [
                    axis("Y", "modes_hz", 0), axis("Y", "modes_hz", 1),
                    axis("Y", "modes_damping", 0), axis("Y", "modes_damping", 1),
                ],
            ),
            Figures(
                "| X {} Hz; Y {} and {} Hz | without the motor's own damping |",
                [
                    axis("X", "modes_free_hz", 0), axis("Y", "modes_free_hz", 0),
                    axis("Y", "modes_free_hz", 1),
                ],
            ),
            Figures("| stitcher, X | {} | {} | {} ({} %) |", routh_over("X")),
            Figures("| stitcher, Y | {} | {} | {} ({} %) |", routh_over("Y")),
        ],
    ),
    Quick(
        DOCUMENT,
        "threadline analyse stitcher-rigid",
        [
            Figures(
                "bandwidth, rigid, X | 33 Hz | {} Hz | {} Hz |",
                [axis("X", "bandwidth_hz"), axis("X", "continuous", "bandwidth_hz")],
            ),
            Figures(
                "bandwidth, rigid, Y | 36 Hz | {} Hz | {} Hz |",
                [axis("Y", "bandwidth_hz"), axis("Y", "continuous", "bandwidth_hz")],
            ),
            Figures(
                "digital filter, X | - | {} Hz, {} deg | {} Hz, {} deg |",
                [
                    axis("X", "crossover_hz"), axis("X", "phase_margin_deg"),
                    axis("X", "continuous", "crossover_hz"),
                    axis("X", "continuous", "phase_margin_deg"),
                ],
            ),
            Figures(
                "digital filter, Y | - | {} Hz, {} deg | {} Hz, {} deg |",
                [
                    axis("Y", "crossover_hz"), axis("Y", "phase_margin_deg"),
                    axis("Y", "continuous", "crossover_hz"),
                    axis("Y", "continuous", "phase_margin_deg"),
                ],
            ),
            Figures("| stitcher-rigid, X | {} | {} | {} ({} %) |", routh_over("X")),
            Figures("| stitcher-rigid, Y | {} | {} | {} ({} %) |", routh_over("Y")),
        ],
    ),
    Quick(
        DOCUMENT,
        "threadline analyse stitcher-rigid-half-mass",
        [
            Figures(
                "bandwidth, half mass, X | 39 Hz | {} Hz | {} Hz |",
                [axis("X", "bandwidth_hz"), axis("X", "continuous", "bandwidth_hz")],
            ),
            Figures(
                "bandwidth, half mass, Y | 38 Hz | {} Hz | {} Hz |",
                [axis("Y", "bandwidth_hz"), axis("Y", "continuous", "bandwidth_hz")],
            ),
        ],
    ),
    Quick(
        DOCUMENT,
        'threadline analyse stitcher-rigid --axis X --lead "13.5 Hz, 65.8 deg"',
        [
            Figures(
                "and gives {}, {}, {} with the two rounded wishes",
                [axis("X", "lead", key) for key in ("gain_dac_per_count", "zero", "pole")],
            )
        ],
    ),
    Quick(
        DOCUMENT,
        "threadline prove SEAM -m stitcher",
        [Figures("-m stitcher` | contour {} mm, stitch length {} % off |", [contour, length])],
        status=1,
        more=BY_PLACE, instead=["prove", SEAM, "-m", "stitcher"],
    ),
    Quick(
        DOCUMENT,
        "threadline prove SEAM -m stitcher --feed-forward",
        [
            Figures(
                "-m stitcher --feed-forward` | contour {} mm, stitch length {} % off |",
                [contour, length],
            ),
            Figures("| 75 | 25.9 A | 27.8 A | {} %, out of spec | {} mm |", [length, contour]),
        ],
        status=1,
        more=BY_PLACE, instead=["prove", SEAM, "-m", "stitcher", "--feed-forward"],
    ),
    Quick(
        DOCUMENT,
        "threadline prove SEAM -m stitcher+cloth-on-frame --feed-forward",
        [
            Figures(
                "on-frame --feed-forward` | contour {} mm, stitch length {} % off |",
                [contour, length],
            )
        ],
        more=BY_PLACE,
        instead=["prove", SEAM, "-m", "stitcher+cloth-on-frame", "--feed-forward"],
        status=1,
    ),
    Quick(
        DOCUMENT,
        "threadline prove examples/stitcher-75.seam.toml -m examples/stitcher-75.toml "
        '--feed-forward --smoothing "24 ms"',
        [
            Figures(
                "(repeated): {} of 2 stitches to the speed, the speed {} % off, stitch length {} "
                "%, contour {} mm.",
                [
                    of("stitches_to_speed", times=1.0), of("stitch_speed_error", times=100.0),
                    length, contour,
                ],
            )
        ],
    ),
    Quick(
        DOCUMENT,
        "threadline prove examples/stitcher-test-path.seam.toml -m stitcher-rigid",
        [
            Figures("stitch length {}, 12.3 and 11.0 %", [length]),
            Figures("contour {}, 0.108 and 0.233 mm", [contour]),
        ],
        status=1,
        more=BY_PLACE,
    ),
    Quick(
        DOCUMENT,
        "threadline prove examples/yoke.seam.toml -m stitcher -s examples/stitcher-place.spec.toml "
        "--feed-forward --nominal",
        [
            Figures(
                "Contour error {} mm, largest error of a stitch's length {} %.", [contour, length]
            )
        ],
    ),
    Quick(
        DOCUMENT,
        "threadline analyse stitcher+head-feedback",
        [
            Figures(
                "critical at {} (X, {} Hz) and {} (Y, {} Hz) of the gain",
                [
                    axis("X", "gain_margin"), axis("X", "phase_crossover_hz"),
                    axis("Y", "gain_margin"), axis("Y", "phase_crossover_hz"),
                ],
            )
        ],
        status=1,
    ),
    Quick(
        DOCUMENT,
        "threadline analyse stitcher",
        [
            Figures(
                "V s/rad disagree by {} %; at 7.5 in/s the motor's own damping takes {} of 27 A on "
                "X and {} of 27 A on Y, all friction {} and {} A; 7.5 in/s together with 1092 "
                "in/s2 would need {} and {} A; the 8-bit word rounds away errors of up to {} "
                "counts ({} mm) at rest",
                [
                    warned("disagree by ([0-9.]+) %"), warned("s/rad takes ([0-9.]+) A"),
                    warned("s/rad takes ([0-9.]+) A", 1), warned("all friction ([0-9.]+) A"),
                    warned("all friction ([0-9.]+) A", 1), warned("needs ([0-9.]+) A"),
                    warned("needs ([0-9.]+) A", 1), warned("up to ([0-9]+) counts"),
                    warned("counts .([0-9.]+) mm"),
                ],
            )
        ],
    ),
    Quick(
        DOCUMENT,
        "threadline analyse stitcher+unloaded --experiments",
        [
            Figures(
                "200 Hz, actuator X | 500 rad/s, 0.7 | {} rad/s, {} |",
                [tried("X", "natural_rad_s"), tried("X", "damping")],
            ),
            Figures(
                "200 Hz, actuator Y | 400 rad/s, 0.7 | {} rad/s, {} |",
                [tried("Y", "natural_rad_s"), tried("Y", "damping")],
            ),
            Figures("| 3 ms | {} ms on both axes |", [tried("X", "delay_s", times=1e3)]),
            Figures(
                "| 42 | X {}, Y {} rad/s/V |",
                [tried("X", "gain_rad_s_v"), tried("Y", "gain_rad_s_v")],
            ),
        ],
    ),
    Quick(
        DOCUMENT,
        "threadline analyse stitcher --experiments",
        [
            Figures("| 3 pi/8 rad | 0.23 in | {} in | {} %, {} % | {} ms |", experiment(2)),
            Figures("| pi/2 | 0.30 in | {} in | {} %, {} % | {} ms |", experiment(3)),
            Figures("| 5 pi/8 | 0.38 in | {} in | {} %, {} % | {} ms |", experiment(4)),
            Figures("| 3 pi/4 | 0.45 in | {} in | {} %, {} % | {} ms |", experiment(5)),
        ],
    ),
]  # fmt: skip
