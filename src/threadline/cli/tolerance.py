"""What is said when the chosen interpolation does not keep the tolerance that was asked for."""

from __future__ import annotations

from threadline.cli.told import warning
from threadline.options import parse_tolerance_m
from threadline.path.plan import KEEPING_TOLERANCE, on_chords
from threadline.pipeline import Proof
from threadline.plan import Plan
from threadline.verdict.deviation import measure_path_deviation
from threadline.verdict.registry import MEASURES

_ROUNDING = 1e-6  # relative: of what is measured on points of the path


def tolerance_warnings(plan: Plan) -> list[str]:
    """Return a line if the planned path leaves the programmed one by more than the tolerance."""
    if MEASURES["path_deviation"].of_plan(plan) is None or _keeps(plan):
        return []
    (worst,) = measure_path_deviation(plan)
    return _told(plan, worst.value, worst.job_line)


def warn_tolerance(plan: Plan) -> None:
    """Print the line of ``tolerance_warnings`` on standard error, where there is one."""
    for said in tolerance_warnings(plan):
        warning(said)


def proof_warnings(proof: Proof) -> list[str]:
    """Return the line of ``tolerance_warnings`` for a proof, whose verdict has the deviation."""
    found = [r for r in proof.verdict.results if r.name == "path_deviation"]
    if not found or found[0].measured is None or _keeps(proof.plan):
        return []
    return _told(proof.plan, found[0].measured, found[0].job_line)


def _keeps(plan: Plan) -> bool:
    name = plan.motion.path.interpolation
    return name in KEEPING_TOLERANCE or on_chords(name)


def _told(plan: Plan, deviation_m: float | None, line: int | None) -> list[str]:
    tolerance_m = parse_tolerance_m(plan.options["tolerance"])
    if deviation_m is None or deviation_m <= tolerance_m * (1.0 + _ROUNDING):
        return []
    at = f" at line {line}" if line else ""
    return [
        f"{plan.motion.path.interpolation} does not keep the tolerance of "
        f"{tolerance_m * 1e3:g} mm: the planned path is "
        f"{deviation_m * 1e3:.3g} mm off the programmed one{at}; "
        f"{', '.join(KEEPING_TOLERANCE[:-1])} and {KEEPING_TOLERANCE[-1]} keep it"
    ]
