"""The quick commands of the documents on shapers, frames, cylinders, sizes and yields."""

from __future__ import annotations

from typing import Any

from tests.documents.quick import Answer, Figures, Quick, at, contour

SHAPING, EMBROIDERY, STITCHER = (
    "results-shaping.md",
    "results-embroidery.md",
    "results-stitcher.md",
)
LAWS = (
    "trapezoid", "double-parabola", "simple-harmonic", "modified-trapezoid", "modified-sine",
    "4-5-6-7",
)  # fmt: skip
BANDS = "threadline shaper --mode 3.04Hz:0.0089:20% --mode 8Hz:0.02:10% --kind si"
FRAME_SERVO = (
    'threadline size --load-mass "1150 kg" --pulley-radius "20 mm" --gear-ratio 1 '
    '--motor-inertia "0.06 kg m^2" --move "16.5 mm" --move-time "120 ms" '
    '--motor-torque "1160 N m" --torque-margin 6'
)
STITCHER_SIZE = (
    'threadline size --needle-speed "75 stitch/s" --stitch-length "0.1 in" --placement "0.02 in" '
    '--load-mass "111 kg" --pulley-radius "29 mm" --motor-inertia "4.75 kg cm^2" --gear-ratio 6 '
    '--load-damping "3330 N s/m" --motor-damping "0.24 N m s/rad" --torque-constant "0.5 N m/A" '
    '--back-emf "60 V/krpm" --resistance "0.8 ohm" --current-limit "27 A" --encoder-lines 2000'
)


def law(name: str, key: str) -> Answer:
    """Return what finds a figure of a law, in mm or ms."""

    def found(said: Any) -> float:
        (one,) = (each for each in said["laws"] if each["name"] == name)
        return 1e3 * float(one[key])

    return found


def line(name: str, times: float = 1.0) -> Answer:
    """Return what finds a quantity of ``size``."""

    def found(said: Any) -> float:
        (one,) = (each for each in said["lines"] if each["name"] == name)
        return times * float(one["value"])

    return found


def impulses(said: Any) -> float:
    return float(len(said["times_s"]))


def shaped(*modes: str, kind: str) -> list[str]:
    return ["shaper", *(word for mode in modes for word in ("--mode", mode)), "--kind", kind]


def train(row: str, *modes: str, kind: str) -> Quick:
    wanted = [at("duration_s"), impulses]
    return Quick(
        SHAPING,
        BANDS,
        [Figures(f"| {row} | {kind} | {{}} | {{}} |", wanted)],
        instead=shaped(*modes, kind=kind),
    )


ONE, TWO = "3.04 Hz +-20 %", "3.04 Hz +-20 % and 8 Hz +-10 %"
QUICK = [
    Quick(
        SHAPING,
        "threadline shaper --mode 3.04Hz --damping 0.17 --kind um-2ei",
        [
            Figures(
                "0 .0427 .1309 .2219 .2607 .3869 .3963 | {} {} {} {} {} {} {} |",
                [at("times_s", k) for k in range(7)],
            )
        ],
    ),
    train(ONE, "3.04Hz:0.0089:20%", kind="si"),
    train(ONE, "3.04Hz:0.0089:20%", kind="um-si"),
    train(TWO, "3.04Hz:0.0089:20%", "8Hz:0.02:10%", kind="si"),
    Quick(
        SHAPING,
        'threadline prove examples/x-180.prg -m lathe-winder --nominal --shaper "zv:12Hz:0.0574"',
        [Figures("is {} mm off at the reversal, and so out of spec", [contour])],
        status=1,
    ),
    Quick(
        EMBROIDERY,
        'threadline law --mode 12Hz --damping 0.02 --move "16.5 mm" --time "120 ms"',
        [
            *(
                Figures(f"| {name} | {before} | {{}} (", [law(name, "residual_m")])
                for name, before in zip(
                    LAWS,
                    (
                        "5.880 (5.9)",
                        "6.812 (6.8)",
                        "5.746 (5.8)",
                        "7.744 (7.7)",
                        "7.089 (7.1)",
                        "9.138 (9.1)",
                    ),
                    strict=True,
                )
            ),
        ],
    ),
    Quick(
        EMBROIDERY,
        'threadline law --mode 12Hz --damping 0.02 --move "16.5 mm" --time "120 ms" '
        '--limit "6.33 m/s^2" --residual "0.05 mm" --band 0.1',
        [
            Figures(
                "modified sine, every longer window too | {} (471)",
                [law("modified-sine", "still_from_s")],
            ),
            Figures("| cycloidal, likewise | {} (318)", [law("cycloidal", "still_from_s")]),
            Figures(
                "±10 %**, jerk {} m/s³ | {} (171)",
                [at("made", "jerk_m_s3"), at("made", "window_s", times=1e3)],
            ),
            Figures(
                "| bound of free levels, ±10 % | {} |", [at("made", "free_levels_s", times=1e3)]
            ),
            Figures(
                "| time-optimal, exact mode | {} (113)", [at("made", "time_optimal_s", times=1e3)]
            ),
            Figures("| rigid machine | {} |", [at("made", "rigid_s", times=1e3)]),
            Figures(
                "it leaves {} mm at 9.6 Hz and {} mm at 14.4 Hz",
                [
                    at("made", "outside", 3, "residual_m", times=1e3),
                    at("made", "outside", 7, "residual_m", times=1e3),
                ],
            ),
        ],
    ),
    Quick(
        EMBROIDERY,
        'threadline cam examples/schiffli-cam.csv --b "165 mm" --c "135 mm" --noise "0.05 mm"',
        [
            Figures(
                "as measured has Ca = {} (found before: 36), Cj = {}",
                [at("fairings", "none", "Ca", "value"), at("fairings", "none", "Cj", "value")],
            ),
            Figures("rows that are printed (Ca = {}) is no cam", [at("law", "Ca")]),
        ],
    ),
    Quick(
        EMBROIDERY,
        FRAME_SERVO,
        [
            Figures(
                "{} N m are needed, the margin is {}.",
                [line("move peak torque"), line("move torque margin")],
            )
        ],
    ),
    Quick(
        "yield.md",
        "threadline yield JOB -m MACHINE [-s SPEC] --variants 10000 --seed 1",
        [
            Figures(
                "| `examples/x-180.prg -m lathe-winder` | {}, {} to {} % | `contour_error` up to "
                "{} of 0.5 mm |",
                [
                    at("passed"),
                    at("interval", 0, times=100.0),
                    at("interval", 1, times=100.0),
                    at("criteria", 0, "quantiles", "1.0", times=1e3),
                ],
            )
        ],
        instead=[
            "yield",
            "examples/x-180.prg",
            "-m",
            "lathe-winder",
            "--variants",
            "2000",
            "--seed",
            "1",
        ],
        status=1,
    ),
    Quick(
        STITCHER,
        STITCHER_SIZE,
        [
            Figures("| head speed | 7.5 in/s | {} m/s", [line("head speed")]),
            Figures(
                "| 281 in/s2 | {} m/s2 = {} in/s2 |",
                [line("ramp acceleration"), line("ramp acceleration", 1.0 / 0.0254)],
            ),
            Figures(
                "| 546 in/s2 | {} m/s2 = {} in/s2 at",
                [line("corner acceleration"), line("corner acceleration", 1.0 / 0.0254)],
            ),
            Figures("| - | {} of 27 A (18.9", [line("cruise current")]),
            Figures("| (6:1 built) | {}:1 |", [line("matched ratio")]),
        ],
    ),
]
