"""How fast a schiffli frame can be moved, law by law: the table and the figure of the results.

    python -m tools.schiffli_claim

16.5 mm, at most 0.05 mm left swinging over +-10 % of a mode of damping ratio 0.02, for modes from
6 to 40 Hz, at the peak acceleration of modified sine in 120 ms and at 1.5 times that. A law that is
not made for the mode takes the window from which on every longer one will do, for a frame's shaft
is slowed and stopped. It writes docs/pictures/schiffli-claim.png.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from threadline.motion.laws import Law, law
from threadline.motion.laws.cam import Triangle, read_cam
from threadline.motion.laws.cam_study import study_cam
from threadline.motion.shaping import FlexibleMode
from threadline.motion.shaping.law_residual import lasting_windows_s
from threadline.motion.shaping.mode_law import Demand, made_law, usual_jerk_m_s3
from threadline.motion.shaping.shaped_law import shaped_windows
from threadline.report.style import AXES, LIMIT, PLANNED, figure_style

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "docs" / "pictures" / "schiffli-claim.png"
MOVE_M, RESIDUAL_M, BAND, DAMPING, WINDOW_S = 0.0165, 5e-5, 0.1, 0.02, 0.12
MODES = (
    6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 18.0, 20.0, 22.0, 25.0, 28.0,
    32.0, 36.0, 40.0,
)  # fmt: skip
PRINTED = (6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 20.0, 25.0, 32.0, 40.0)
TICKS = (6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 32.0, 40.0)
FACTORS = (1.0, 1.5)
SLOW = 16.0  # modes up to here are what is claimed of ours
PLAIN = ("trapezoid", "double-parabola", "jerk-limited", "simple-harmonic", "modified-sine")


def cam_law() -> Law:
    """Return the law of the nine rows that are printed, smoothed for 0.05 mm of noise."""
    cam = read_cam(ROOT / "examples" / "schiffli-cam.csv", Triangle(b_m=0.165, c_m=0.135))
    return study_cam(cam, noise_m=5e-5, draws=1).law


def still_periods(motion: Law) -> float:
    """Return the window, in periods, from which on every longer one keeps the residual.

    A law that is not made for a mode leaves the same on every mode in as many periods.
    """
    windows = [
        lasting_windows_s(motion, FlexibleMode(ratio, DAMPING), np.array([MOVE_M]), RESIDUAL_M)
        for ratio in np.linspace(1.0 - BAND, 1.0 + BAND, 9)
    ]
    return float(np.max(windows))


def case(hertz: float, factor: float, plain: dict[str, tuple[Law, float]]) -> dict[str, float]:
    """Return the window of every law, s, for a mode and a factor of the acceleration."""
    acceleration = factor * law("modified-sine").acceleration * MOVE_M / WINDOW_S**2
    found = {
        name: max(periods / hertz, float(np.sqrt(motion.acceleration * MOVE_M / acceleration)))
        for name, (motion, periods) in plain.items()
    }
    demand = Demand(
        mode=FlexibleMode(hertz, DAMPING), band=BAND, move_m=MOVE_M, residual_m=RESIDUAL_M,
        acceleration_m_s2=acceleration, jerk_m_s3=usual_jerk_m_s3(MOVE_M, acceleration),
    )  # fmt: skip
    shaped = shaped_windows(law("modified-sine"), demand)
    found["modified-sine, shaped"] = min((w.window_s for w in shaped), default=np.nan)
    made = made_law(demand)
    found["made for the mode"] = made.window_s
    found["bound: free levels"] = made.free_levels_s
    found["bound: rigid"] = demand.rigid_s
    return found


def main() -> None:
    laws = {name: law(name) for name in PLAIN} | {"cam, nine rows": cam_law()}
    plain = {name: (motion, still_periods(motion)) for name, motion in laws.items()}
    cases = {(hertz, f): case(hertz, f, plain) for f in FACTORS for hertz in MODES}
    names = list(next(iter(cases.values())))
    for factor in FACTORS:
        print(f"\nWindows in ms at {factor:g} times the acceleration\n")
        print("| law | " + " | ".join(f"{hertz:g} Hz" for hertz in PRINTED) + " |")
        print("|---|" + "---|" * len(PRINTED))
        for name in names:
            cells = [f"{1e3 * cases[hertz, factor][name]:.0f}" for hertz in PRINTED]
            print(f"| {name} | " + " | ".join(cells) + " |")
        gain = [
            f"{cases[h, factor]['modified-sine'] / cases[h, factor]['made for the mode']:.2f}"
            for h in PRINTED
        ]
        print("| speed of ours over modified sine's | " + " | ".join(gain) + " |")
        gains = {
            h: cases[h, factor]["modified-sine"] / cases[h, factor]["made for the mode"]
            for h in MODES
            if h <= SLOW
        }
        least = min(gains, key=lambda h: gains[h])
        print(f"\nup to {SLOW:g} Hz at least {gains[least]:.2f} times as fast, at {least:g} Hz")
    draw(cases, names)
    print(OUT.relative_to(ROOT))


def draw(cases: dict[tuple[float, float], dict[str, float]], names: list[str]) -> None:
    styles = [dict(style) for style in AXES]
    with figure_style():
        figure = Figure(figsize=(9.0, 4.8))
        panels = figure.subplots(1, 2, sharey=True)
        for panel, factor in zip(panels, FACTORS, strict=True):
            for k, name in enumerate(names):
                style = styles[k % len(styles)] | {"marker": "osv^Dxp"[k % 7], "markersize": 3}
                if name.startswith("bound"):
                    style = PLANNED | ({"color": "black"} if "rigid" in name else {})
                elif name.endswith("shaped"):
                    style |= {"color": "#5D3A9B", "linestyle": "-", "linewidth": 1.6}
                elif name == "made for the mode":
                    style = {"color": "#D55E00", "linewidth": 2.4, "marker": "o", "markersize": 4}
                turns = [60.0 / (3.0 * cases[hertz, factor][name]) for hertz in MODES]
                panel.plot(MODES, turns, label=name, **style)
            panel.axhline(1.3 * 60.0 / 0.36, label="claimed: + 30 %", **LIMIT)
            panel.set_xscale("log")
            panel.set_xticks(TICKS, [f"{hertz:g}" for hertz in TICKS])
            panel.minorticks_off()
            panel.set_xlabel("mode of the frame, Hz")
            panel.set_title(f"peak acceleration {6.334 * factor:.2f} m/s²")
        panels[0].set_ylabel("stitches a minute, 16.5 mm each")
        panels[0].set_ylim(bottom=0.0)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
        figure.savefig(OUT, dpi=130, metadata={"Software": None})


if __name__ == "__main__":
    main()
