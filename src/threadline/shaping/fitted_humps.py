"""Published fits of the two- and three-hump EI shapers at 5 %, as firmwares have them.

Source: Singhose, Seering and Singer, "Input shaping for vibration reduction with specified
insensitivity to modeling errors" (1996), curve fits; valid to damping ratios of 0.3 and 0.2.
"""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray

# Times in periods and amplitudes as polynomials of the damping ratio, constant first.
_FITTED = {
    2: (
        (
            (0.0, 0.0, 0.0, 0.0),
            (0.49890, 0.16270, -0.54262, 6.16180),
            (0.99748, 0.18382, -1.58270, 8.17120),
            (1.49920, -0.09297, -0.28338, 1.85710),
        ),
        (
            (0.16054, 0.76699, 2.26560, -1.22750),
            (0.33911, 0.45081, -2.58080, 1.73650),
            (0.34089, -0.61533, -0.68765, 0.42261),
            (0.15997, -0.60246, 1.00280, -0.93145),
        ),
    ),
    3: (
        (
            (0.0, 0.0, 0.0, 0.0),
            (0.49974, 0.23834, 0.44559, 12.4720),
            (0.99849, 0.29808, -2.36460, 23.3990),
            (1.49870, 0.10306, -2.01390, 17.0320),
            (1.99960, -0.28231, 0.61536, 5.40450),
        ),
        (
            (0.11275, 0.76632, 3.29160, -1.44380),
            (0.23698, 0.61164, -2.57850, 4.85220),
            (0.30008, -0.19062, -2.14560, 0.13744),
            (0.23775, -0.73297, 0.46885, -2.08650),
            (0.11244, -0.45439, 0.96382, -1.46000),
        ),
    ),
}


def fitted_humps(humps: int, damping_ratio: float) -> tuple[FloatArray, FloatArray]:
    """Return times in periods and amplitudes of the shaper with 2 or 3 humps, 4 or 5 of each."""
    powers = damping_ratio ** np.arange(4)
    periods, weights = (np.array(table) @ powers for table in _FITTED[humps])
    return periods, weights
