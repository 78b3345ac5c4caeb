"""What a corner takes whose spline is smoother: cubic, quartic and quintic within one tolerance.

``python -m tools.smoother_corners`` prints, for corners of several angles and limits, how long the
fastest motion along two chords takes, from rest to rest. A vertex is a control point of a cubic
and of a quintic, and a knot of a quartic, as in the paths of ``auto`` and ``retime``. A spline of
a higher degree with even spacing cuts a vertex more, so that its points stand nearer to the
vertex: at ``cut`` of their distance times the turn, 1/6, 7/24 and 7/30. Below the table stand what
the timing itself costs of the processor, and into how many elements it cuts a corner.
"""

from __future__ import annotations

from time import process_time

import numpy as np
from scipy.interpolate import BSpline

from threadline.motion.path.greville import CUT
from threadline.motion.timing.optimal.elements import RunPieces, elements_of
from threadline.motion.timing.optimal.in_time import in_time
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.optimal.solve import fastest

CUTS = {3: 1 / 6, 4: CUT, 5: 7 / 30}
TOLERANCE_M = 1e-4
LEG_M = 0.02


def pieces(degree: int, angle_deg: float) -> tuple[np.ndarray, float]:
    """Return (n, degree + 1, 2) pieces along two chords that turn, and the spacing of points."""
    angle = np.radians(angle_deg)
    tangents = np.array([[1.0, 0.0], [np.cos(angle), np.sin(angle)]])
    turn = float(np.linalg.norm(tangents[1] - tangents[0]))
    spacing = TOLERANCE_M / (CUTS[degree] * turn)
    if degree % 2:
        steps = np.arange(-2 * degree, 2 * degree + 1)[:, None] * spacing
    else:
        steps = (np.arange(-2 * degree, 2 * degree) + 0.5)[:, None] * spacing
    points = np.where(steps < 0.0, steps * tangents[0], steps * tangents[1])
    spline = BSpline(np.arange(len(points) + degree + 1.0), points, degree)
    begins = np.arange(degree, len(points), dtype=np.float64)
    powers = [
        spline(begins + 1e-9, order) / float(np.prod(np.arange(1, order + 1)))
        for order in range(degree + 1)
    ]
    c = np.stack(powers, axis=1)
    c[:, 2:][np.abs(c[:, 2:]) < 1e-6 * spacing] = 0.0
    # Straight to both ends of the chords.
    ends = np.zeros((2, degree + 1, 2))
    ends[0, 0] = -LEG_M * tangents[0]
    ends[0, 1], ends[1, 0] = c[0, 0] - ends[0, 0], c[-1].sum(axis=0)
    ends[1, 1] = LEG_M * tangents[1] - ends[1, 0]
    return np.concatenate([ends[:1], c, ends[1:]]), spacing


def time_s(degree: int, angle_deg: float, limits: Limits) -> tuple[float, int]:
    """Return how long the fastest motion takes, and in how many elements it was found."""
    c, spacing = pieces(degree, angle_deg)
    n = len(c)
    ratio = np.ones(n - 1)
    ratio[0] = spacing / np.linalg.norm(c[0, 1])
    ratio[-1] = 1.0 / (spacing / np.linalg.norm(c[-1, 1]))
    elements = elements_of(
        RunPieces(c, ratio, np.zeros(n), np.zeros(n, int), 1.0), from_rest=True, to_rest=True
    )
    solution = fastest(elements, limits, 1e-4)
    return in_time(solution, limits).end_s, len(solution.y)


def main() -> None:
    """Print the table."""
    print("turn  jerk m/s^3  cubic s  quartic s  quintic s")
    spent, cuts, corners = dict.fromkeys(CUTS, 0.0), dict.fromkeys(CUTS, 0), 0
    time_s(3, 90.0, _limits(2000.0))  # so that nothing is compiled or read by the clock
    for jerk in (200.0, 2000.0, 20000.0):
        for angle in (30.0, 90.0, 150.0):
            found = []
            for degree in CUTS:
                begun = process_time()
                taken_s, count = time_s(degree, angle, _limits(jerk))
                spent[degree] += process_time() - begun
                cuts[degree] += count
                found.append(taken_s)
            corners += 1
            print(f"{angle:4.0f}  {jerk:10.0f}  " + "  ".join(f"{value:.5f}" for value in found))
    for degree in CUTS:
        each_ms, mean = 1e3 * spent[degree] / corners, cuts[degree] / corners
        print(f"degree {degree}: {each_ms:.0f} ms and {mean:.0f} elements for a corner")


def _limits(jerk: float) -> Limits:
    return Limits(velocity=np.full(2, 0.5), acceleration=np.full(2, 10.0), jerk=np.full(2, jerk))


if __name__ == "__main__":
    main()
