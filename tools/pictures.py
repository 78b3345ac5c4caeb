"""Draw the pictures of README, start page and gallery anew: ``python -m tools.pictures``.

Run it in the root of the repository.
"""

from __future__ import annotations

import io
import shlex
import shutil
from contextlib import redirect_stdout, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Polygon, Rectangle

from threadline.base.arrays import FloatArray
from threadline.cli.main import main as main_of_the_command
from threadline.dynamics.values import Values
from threadline.identify.experiment_run import measure
from threadline.identify.frequency_domain import ResponseData
from threadline.identify.measured_response import model_response
from threadline.identify.parameter_fit import fit
from threadline.identify.planned_experiment import experiment
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.machine.numbers import number_at
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, plan_job, prove_plan
from threadline.report.animation import still
from threadline.report.scenes import scene_of
from threadline.report.style import ACTUAL, LIMIT, PLANNED, figure_style
from threadline.report.traces import Traces, collect
from threadline.verdict import load_spec

ROOT = Path(__file__).resolve().parent.parent
PICTURES = ROOT / "docs" / "pictures"
RADIUS_MM = 50.0
"""Radius of the tube that ``examples/helix.gcode`` winds."""
LIMIT_MM = 0.5
"""What the winder's specification allows of ``contour_error``."""
ERROR = LinearSegmentedColormap.from_list("error", ["#a9c4dc", "#3f7fb5", "#c04f00", "#2b0f00"])
"""From light to dark without a turn, so that a grey print says the same."""
STEEL: dict[str, Any] = {"facecolor": "0.88", "edgecolor": "0.25"}
DARK: dict[str, Any] = {"facecolor": "0.7", "edgecolor": "0.25"}
RING: dict[str, Any] = {"linestyle": "none", "color": "black", "fillstyle": "none", "zorder": 6}

OF_REPORTS = {
    "report-seam.png": (
        "prove examples/stitcher-test-path.seam.toml -m stitcher "
        "-s examples/stitcher-place.spec.toml --needle '69 stitch/s' --feed-forward",
        "report-seam.png",
    ),
    "report-placer.png": (
        "prove examples/letter-cycle.toml -m letter-placer --shaper um-zv",
        "report-residual.png",
    ),
    "learning.png": (
        "learn examples/stitcher-even.seam.toml -m stitcher --feed-forward --robust '0 %' "
        "--needle '65 stitch/s' --ends '100 %'",
        "learning-learning.png",
    ),
    "report-design.png": (
        "prove examples/rosette.dst -m schiffli-frame",
        "report-design.png",
    ),
    **{
        name: (
            "prove src/threadline/cli/projects/winding/vessel.wind.toml -m lathe-winder --nominal",
            name,
        )
        for name in ("report-winding-pattern.png", "report-winding-map.png")
    },
    "report-shaper.png": (
        "shaper --mode 3.04Hz --damping 0.009 --kind um-zvd",
        "shaper-sensitivity.png",
    ),
}
"""Pictures of the gallery: the command whose report has them, and their file in the report."""


def main() -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    with figure_style():
        save(reversal(), "reversal.png")
        save(winder(), "machine.png")
        save(animated(), "animate.png")
        save(fitted_sweep(), "fitting.png")
    for name, (words, figure) in OF_REPORTS.items():
        with TemporaryDirectory() as folder:
            with suppress(SystemExit), redirect_stdout(io.StringIO()):
                main_of_the_command([*shlex.split(words), "--report", folder])
            shutil.copyfile(Path(folder) / figure, PICTURES / name)
        print((PICTURES / name).relative_to(ROOT))


def save(figure: Figure, name: str) -> None:
    figure.savefig(PICTURES / name, dpi=130, metadata={"Software": None})
    print((PICTURES / name).relative_to(ROOT))


def proven(job: str, options: Options) -> Proof:
    """Return a proof on the winder, of one run."""
    machine = load_machine("lathe-winder")
    file = ROOT / "examples" / job
    plan = plan_job(read_job(file, machine), machine, options)
    return prove_plan(plan, load_spec(None, machine))


def reversal() -> Figure:
    """The carriage at its turning point, with two interpolations."""
    figure = Figure(figsize=(8.6, 3.9))
    panels = figure.subplots(1, 2, sharey=True)
    for panel, name in zip(panels, ("linear", "b-spline-pulled"), strict=True):
        options = Options(interpolation=name, feed=parse_feed("80 count/tick"))
        draw_reversal(panel, proven("x-180.prg", options), name)
    panels[0].set_ylabel("X [mm]")
    panels[0].legend(loc="lower center")
    return figure


def draw_reversal(panel: Axes, proof: Proof, name: str) -> None:
    traces = collect(proof)
    error = proof.verdict.result("turning_point_error", "X").measured or 0.0
    panel.plot(traces.time_s, traces.planned["X"][:, 0] * 1e3, label="planned", **PLANNED)
    panel.plot(traces.time_s, traces.actual["X"] * 1e3, label="carriage", **ACTUAL)
    for side in (-0.5, 0.5):
        label = "180 ± 0.5 mm" if side > 0 else None
        panel.axhline(180.0 + side, label=label, **(LIMIT | {"linewidth": 0.9}))
    turn_s = float(traces.time_s[traces.actual["X"].argmax()])
    panel.set_xlim(turn_s - 0.16, turn_s + 0.16)
    panel.set_ylim(165.0, 182.0)
    panel.set_xlabel("time [s]")
    verdict = "in spec" if proof.verdict.passed else "out of spec"
    panel.set_title(f"{name}: turning point off by {abs(error) * 1e3:.2f} mm, {verdict}")


OFF_BY_30 = """base = "stitcher"
name = "off"
[links.x_belt]
stiffness = "4.4e5 N/m +- 30 %, assumed"
[bodies.x_head]
inertia = "144 kg +- 30 %, assumed"
damping = "2331 N s/m +- 30 %, assumed"
[bodies.x_motor]
inertia = "6.2e-4 kg m^2 +- 30 %, assumed"
damping = "0.17 N m s/rad +- 30 %, assumed"
[drives.x]
delay = "3.9 ms +- 30 %, assumed"
[drives.x.amplifier]
gain = "28 +- 30 %, assumed"
"""
"""The file of ``docs/fitting.md`` before the fit."""


def fitted_sweep() -> Figure:
    """Two sweeps of the stitcher's X, and the file before and after the fit of both."""
    names = ("links.x_belt.stiffness", "bodies.x_head.inertia", "bodies.x_head.damping",
             "drives.x.delay", "bodies.x_motor.inertia", "bodies.x_motor.damping",
             "drives.x.amplifier.gain")  # fmt: skip
    figure = Figure(figsize=(8.6, 5.6))
    panels = figure.subplots(2, 2, sharex=True, sharey="row")
    with TemporaryDirectory() as folder:
        file = Path(folder) / "off.toml"
        file.write_text(OFF_BY_30, "utf-8")
        before, data, measured = load_machine(str(file)), [], []
        for overlay in ("+unloaded", ""):
            machine = load_machine(str(file) + overlay)
            found = measure(
                machine,
                experiment(machine, "X", "sweep"),
                actual=load_machine("stitcher" + overlay),
            )
            assert found.response is not None, found.why
            measured.append(found.response)
            data.append(ResponseData(machine=machine, measured=found.response))
        after = fit(before, data, names).fitted
    for column, (one, response, title) in enumerate(
        zip(data, measured, ("motor without its belt", "motor, belt and load"), strict=True)
    ):
        hertz = np.geomspace(response.frequency_hz[0], response.frequency_hz[-1], 300)
        for machine, style, label in (
            (before, {"linestyle": "--", "color": "0.45"}, "file, 30 % off"),
            (after, {"linestyle": "-", "color": "black"}, "fitted file"),
        ):
            values = Values.of(
                one.machine,
                {
                    name: np.array([number_at(machine, name).si])
                    for name in names
                    if column or "motor" in name or "drives" in name
                },
            )
            model = model_response(one.machine, values, one.path, 2 * np.pi * hertz)[0]
            speed = model * 2j * np.pi * hertz * 2 * np.pi / 8000
            panels[0, column].loglog(hertz, np.abs(speed), label=label, **style)
            panels[1, column].semilogx(hertz, np.degrees(np.unwrap(np.angle(speed))), **style)
        found_speed = response.value * 2j * np.pi * response.frequency_hz * 2 * np.pi / 8000
        dots = {"linestyle": "none", "marker": "o", "fillstyle": "none", "color": "#c04f00"}
        panels[0, column].loglog(
            response.frequency_hz, np.abs(found_speed), label="measured", **dots
        )
        panels[1, column].semilogx(
            response.frequency_hz, np.degrees(np.unwrap(np.angle(found_speed))), **dots
        )
        panels[0, column].set_title(title)
        panels[1, column].set_xlabel("frequency [Hz]")
    panels[0, 0].set_ylabel("speed of the motor [rad/s/V]")
    panels[1, 0].set_ylabel("phase [deg]")
    panels[0, 0].legend(loc="lower left")
    return figure


def winder() -> Figure:
    """The machine at work: a tube that was wound with two interpolations at 200 mm/s."""
    figure = Figure(figsize=(9.4, 5.4))
    rows = figure.subplots(2, 2, width_ratios=(2.6, 1.0))
    for (machine, detail), name in zip(rows, ("linear", "optimal"), strict=True):
        options = Options(interpolation=name, feed=parse_feed("200 mm/s"), radius="A=50 mm")
        proof = proven("helix.gcode", options)
        traces = collect(proof)
        error_mm = 1e3 * np.interp(traces.time_s, *contour(traces))
        worst = int(error_mm.argmax())
        found_mm = 1e3 * (proof.verdict.result("contour_error").measured or 0.0)
        verdict = "in spec" if proof.verdict.passed else "out of spec"
        machine.set_title(
            f"{name}: {proof.plan.duration_s:.2f} s, worst error {found_mm:.2f} mm "
            f"of {LIMIT_MM} mm, {verdict}"
        )
        fibre = draw_machine(machine, traces, error_mm, worst)
        draw_detail(detail, traces, error_mm, worst)
    rows[0, 1].legend(loc="best")
    bar = figure.colorbar(fibre, ax=rows[:, 0], location="bottom", shrink=0.7, aspect=45, pad=0.01)
    bar.set_label("distance of the carriage's actual path from its programmed path [mm]")
    bar.ax.axvline(LIMIT_MM, color="black", linewidth=2.0)
    bar.ax.text(LIMIT_MM, 1.25, "limit", ha="center", transform=bar.ax.get_xaxis_transform())
    return figure


def animated() -> Figure:
    """A frame of the animation of a winder."""
    options = Options(interpolation="linear", feed=parse_feed("200 mm/s"), radius="A=50 mm")
    scene = scene_of(proven("helix.gcode", options))
    return still(scene, round(0.9 * scene.frames))


def contour(traces: Traces) -> tuple[FloatArray, FloatArray]:
    assert traces.contour is not None
    return traces.contour


def draw_machine(panel: Axes, traces: Traces, error_mm: FloatArray, worst: int) -> LineCollection:
    """Draw bed, head, tube and carriage from the side, as they are at the worst place."""
    x_mm, angle = 1e3 * traces.actual["X"], traces.actual["A"]
    turned = angle - angle[worst] - np.deg2rad(60.0)  # the worst place is below, in front
    y_mm = RADIUS_MM * np.sin(turned)
    front = np.cos(turned) > 0.0

    panel.add_patch(Rectangle((-95, -118), 500, 10, **DARK))  # the bed
    panel.add_patch(FancyBboxPatch((-88, -105), 42, 170, boxstyle="round,pad=3", **STEEL))
    panel.add_patch(Rectangle((-44, -24), 16, 48, **DARK))  # the chuck
    panel.add_patch(FancyBboxPatch((358, -105), 30, 135, boxstyle="round,pad=3", **STEEL))
    panel.add_patch(Polygon([(356, -12), (356, 12), (330, 0)], **DARK))  # the centre
    panel.add_patch(
        Rectangle((-28, -RADIUS_MM), 356, 2 * RADIUS_MM, facecolor="0.97", edgecolor="0.25")
    )
    panel.axhline(0.0, color="0.6", linewidth=0.7, dashes=(12, 3, 2, 3))

    at = float(x_mm[worst])
    panel.add_patch(Rectangle((at - 26, -106), 52, 20, zorder=4, **DARK))  # the carriage
    panel.add_patch(Rectangle((at - 4, -88), 8, 12, zorder=4, facecolor="0.4", edgecolor="0.25"))
    panel.plot([at, at], [-76, y_mm[worst]], color="0.35", linewidth=1.2, zorder=2)
    panel.plot(at, y_mm[worst], marker="o", markersize=15, **RING)

    seen = front[:-1] & front[1:]
    behind = pieces(x_mm, y_mm)[~seen]
    panel.add_collection(LineCollection(list(behind), colors="0.75", linewidths=0.6, zorder=1))
    fibre = coloured(pieces(x_mm, y_mm)[seen], error_mm[:-1][seen])
    panel.add_collection(fibre)

    for text, x, y in (
        ("head: turns A", -67, 74),
        ("tube (mandrel)", 150, 55),
        ("carriage: moves X", at - 36, -104),
    ):
        side = "right" if "X" in text else "center"
        panel.text(x, y, text, ha=side, va="bottom", fontsize=8)
    panel.set_xlim(-98, 408)
    panel.set_ylim(-122, 88)
    panel.set_aspect("equal")
    panel.axis("off")
    return fibre


def pieces(x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return (n - 1, 2, 2) the straight pieces between n points."""
    points = np.column_stack([x_mm, y_mm])
    return np.stack([points[:-1], points[1:]], axis=1)


def coloured(ends: FloatArray, error_mm: FloatArray) -> LineCollection:
    """Return a line that is darker and wider where the error is larger."""
    widths = (1.8 + 5.0 * error_mm).tolist()
    line = LineCollection(list(ends), linewidths=widths, cmap=ERROR, capstyle="round")
    line.set_zorder(3)
    line.set_array(error_mm)
    line.set_clim(0.0, 1.8 * LIMIT_MM)
    return line


def draw_detail(panel: Axes, traces: Traces, error_mm: FloatArray, worst: int) -> None:
    """Draw the path about its worst place, on the unrolled tube."""
    around = np.abs(traces.time_s - traces.time_s[worst]) < 0.35
    x_m, angle = traces.actual["X"][worst], traces.actual["A"][worst]
    actual = (
        1e3 * (traces.actual["X"][around] - x_m),
        RADIUS_MM * (traces.actual["A"][around] - angle),
    )
    panel.add_collection(coloured(pieces(*actual), error_mm[around][:-1]))
    panel.plot(
        1e3 * (traces.planned["X"][around, 0] - x_m),
        RADIUS_MM * (traces.planned["A"][around, 0] - angle),
        label="planned",
        **(PLANNED | {"zorder": 4, "color": "black", "linewidth": 1.1}),
    )
    panel.plot(0.0, 0.0, marker="o", markersize=9, label="worst place", **RING)
    panel.set_xlim(-8.0, 3.0)
    panel.set_ylim(-8.0, 8.0)
    panel.set_xlabel("along the tube [mm]")
    panel.set_ylabel("around the tube [mm]")
    panel.set_title("there, on the unrolled tube")


if __name__ == "__main__":
    main()
