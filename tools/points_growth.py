"""Time per point and memory of ``optimal`` along paths of more and more points.

``python -m tools.points_growth 3 6`` measures 10^3, 10^4 ... 10^6 points, 0.1 mm apart and each up
to 2 um beside a curve, streamed through smoothing and timing. Each number of points has a process
of its own: seconds of the processor for each point, its largest memory, and the motion's time.
What is compiled was compiled, and every kernel was used, before the clock begins.
``--every-point`` follows each of them, as jobs are followed; without it chords pass many, as in
``retime``. ``--picture FILE`` draws both against the number of points.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from time import process_time

import numpy as np

from threadline.files import Stream
from threadline.motion.path.auto import auto_pieces
from threadline.motion.path.polygon import QUARTIC
from threadline.motion.path.types import PlannedPath, ProgrammedPath, Timing, VertexBlock
from threadline.motion.timing.optimal.fastest_motion import limited_blocks
from threadline.motion.timing.optimal.motion_limits import Limits

CHUNK = 5000
STEP_M = 1e-4
TOLERANCE_M = 1e-4
BESIDE_M = 2e-6
LIMITS = Limits(velocity=np.full(3, 1.0), acceleration=np.full(3, 10.0), jerk=np.full(3, 1000.0))


def vertices(count: int) -> Iterator[VertexBlock]:
    """Yield the points in blocks."""
    for first in range(0, count, CHUNK):
        own = np.arange(first, min(first + CHUNK, count))
        t = 2.0 * STEP_M * own
        curve = np.stack([0.3 * np.sin(t), 0.3 * np.cos(1.3 * t), 0.1 * np.sin(2.1 * t)], axis=1)
        beside = np.random.default_rng([5, first]).uniform(-BESIDE_M, BESIDE_M, curve.shape)
        rest = (own == count - 1).astype(np.int64)
        zero = np.zeros(len(own))
        yield VertexBlock(
            positions=curve + beside, operation=own, nominal_s=zero, rest=rest, dwell_s=zero,
            line=own,
        )  # fmt: skip


def planned(count: int, *, thin: bool) -> tuple[float, float]:
    """Return the seconds of the processor, and of the motion."""
    programmed = ProgrammedPath(
        axes=("X", "Y", "Z"), radius_m=np.ones(3), blocks=Stream(vertices, count)
    )
    path = PlannedPath(
        axes=programmed.axes,
        radius_m=programmed.radius_m,
        interpolation="optimal",
        timing=Timing.FASTEST,
        historical=False,
        blocks=Stream(
            auto_pieces,
            programmed,
            0.99 * TOLERANCE_M,
            0.01 * TOLERANCE_M,
            degree=QUARTIC,
            thin=thin,
        ),
    )
    begun, end_s = process_time(), 0.0
    for block in limited_blocks(path, LIMITS):
        end_s = block.end_s
    return process_time() - begun, end_s


def measured(power: int, *, thin: bool) -> tuple[float, float, float]:
    """Return us of the processor a point, MB of memory and s of motion, in a process of its own."""
    output = subprocess.run(
        [
            *(sys.executable, "-m", "tools.points_growth", str(power)),
            *(() if thin else ("--every-point",)),
        ],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    ).stdout
    each_us, memory_mb, motion_s = map(float, output.split())
    print(
        f"10^{power} points: {each_us:.1f} us each, {memory_mb:.0f} MB, motion {motion_s:.3f} s",
        flush=True,
    )
    return each_us, memory_mb, motion_s


def draw(powers: range, rows: list[tuple[float, float, float]], out: Path) -> None:
    """Draw time a point and memory, each with the bar that it is held to."""
    from matplotlib.figure import Figure  # what is measured does without it

    from threadline.report.style import ACTUAL, LIMIT, figure_style

    with figure_style():
        figure = Figure(figsize=(8.6, 3.2))
        points = [10**power for power in powers]
        for panel, column, name, bar in zip(
            figure.subplots(1, 2),
            (0, 1),
            ("processor time a point [us]", "memory of the process [MB]"),
            (1.5, 1.2),
            strict=True,
        ):
            values = [row[column] for row in rows]
            panel.semilogx(points, values, marker="o", **ACTUAL)
            panel.axhline(bar * values[0], label=f"{bar:g} of the first", **LIMIT)
            panel.set_ylim(0.0, 1.3 * bar * values[0])
            panel.set_xlabel("points")
            panel.set_ylabel(name)
            panel.legend(loc="lower right")
        figure.savefig(out, dpi=130, metadata={"Software": None})


def main() -> None:
    """Measure one number of points, or every power of ten from one to another."""
    parser = argparse.ArgumentParser(prog="python -m tools.points_growth", description=__doc__)
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int, nargs="?", help="without it: the three numbers alone")
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--every-point", action="store_true")
    options = parser.parse_args()
    thin = not options.every_point
    if options.last is None:
        planned(2000, thin=False)  # in windows
        planned(4000, thin=thin)
        seconds, motion_s = planned(10**options.first, thin=thin)
        memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(1e6 * seconds / 10**options.first, memory_mb, motion_s)
        return
    powers = range(options.first, options.last + 1)
    rows = [measured(power, thin=thin) for power in powers]
    if options.picture is not None:
        draw(powers, rows, options.picture)


if __name__ == "__main__":
    main()
