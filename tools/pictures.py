"""Draw the pictures of the documents anew: ``python -m tools.pictures``."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, plan_job, prove_plan
from threadline.report.style import ACTUAL, LIMIT, PLANNED, figure_style
from threadline.report.traces import collect
from threadline.verdict import load_spec

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "docs" / "pictures" / "reversal.png"


def main() -> None:
    machine = load_machine("lathe-winder")
    job = read_job(ROOT / "examples" / "x-180.prg", machine)
    spec = load_spec(None, machine)
    with figure_style():
        figure = Figure(figsize=(8.6, 3.9))
        panels = figure.subplots(1, 2, sharey=True)
        for panel, name in zip(panels, ("linear", "b-spline-pulled"), strict=True):
            options = Options(interpolation=name, feed=parse_feed("80 count/tick"))
            draw(panel, prove_plan(plan_job(job, machine, options), spec), name)
        panels[0].set_ylabel("X [mm]")
        panels[0].legend(loc="lower center")
        OUT.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(OUT, dpi=130, metadata={"Software": None})
    print(OUT.relative_to(ROOT))


def draw(panel, proof: Proof, name: str) -> None:  # type: ignore[no-untyped-def]
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


if __name__ == "__main__":
    main()
