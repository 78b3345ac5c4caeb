"""What a plan makes of the nine machines at the ends of the tolerances of loads and springs.

    python -m tools.robust_corners SEAM SPEC "100 %" 45 42

Stitches a second, and the largest share of each limit that one of the nine uses, each in one run,
with the robust plan of that share of the tolerances; with ``none`` in its place, with plain
feed-forward.
"""

from __future__ import annotations

import sys
from pathlib import Path

from threadline.errors import ThreadlineError
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.machine.vary import corners
from threadline.proof.options import options_of
from threadline.proof.pipeline import NOMINAL, plan_job, try_plan
from threadline.verdict import load_spec

MACHINE = "stitcher"


def shares(seam: Path, spec: Path, robust: str | None, speed_hz: float) -> dict[str, float]:
    """Return the largest share of every limit that is used on the nine machines."""
    machine = load_machine(MACHINE)
    options = options_of("auto", None, "0.1 mm", feed_forward=True, robust=robust)
    plan = plan_job(
        read_job(seam, machine, needle_speed=f"{speed_hz!r} stitch/s"), machine, options
    )
    found: dict[str, float] = {}
    for actual in corners(machine):
        verdict = try_plan(plan, load_spec(spec, machine), NOMINAL, actual).verdict
        for result in verdict.results:
            if result.limit and result.measured is not None:
                used = result.measured / result.limit
                found[result.name] = max(found.get(result.name, 0.0), used)
    return found


def main() -> None:
    seam, spec, robust = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    for speed in sys.argv[4:]:
        try:
            found = shares(seam, spec, None if robust == "none" else robust, float(speed))
        except ThreadlineError as error:
            print(f"{speed}: {error}")
            continue
        word = "in spec on all nine" if max(found.values()) <= 1.0 else "out"
        told = ", ".join(f"{name} {used:.1%}" for name, used in found.items() if used > 0.5)
        print(f"{speed}: {word}: {told}", flush=True)


if __name__ == "__main__":
    main()
