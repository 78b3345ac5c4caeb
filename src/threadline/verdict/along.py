"""The contour error over time, for a figure: the largest value in each of many time intervals."""

from __future__ import annotations

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.files import Recording
from threadline.verdict.blocks import find_first, judged_blocks, setting_of
from threadline.verdict.registry import MEASURES
from threadline.verdict.tracking import as_intended
from threadline.verdict.window import PathWindow


def contour_along(
    recording: Recording, plan: Plan, lag_s: float, stretches: int = 2000
) -> tuple[FloatArray, FloatArray] | None:
    """Return times, s, and distances of the tool from the programmed path, m, both (n,).

    Distances are measured from samples to chords, as in ``contour_error`` and with the same lag;
    missed programmed points are not included. The recording is read once, in bounded memory.

    Parameters
    ----------
    stretches
        Number of time intervals; each gives its largest distance, at the time of that distance.

    Returns
    -------
    tuple or None
        None if the recording lacks a channel that the measure needs.
    """
    recording = as_intended(recording, plan)
    axes = plan.axes
    actual, operation = MEASURES["contour_error"].needs
    if find_first(recording, operation, "") is None:
        return None
    if any(find_first(recording, actual, axis) is None for axis in axes):
        return None
    setting = setting_of(plan, recording, lag_s)
    width_s = max(plan.motion.trajectory.duration_s + lag_s, setting.interval_s) / stretches
    worst = np.full(stretches + 1, -1.0)
    time_s = np.zeros(stretches + 1)
    window = PathWindow(plan.motion.programmed)
    lag, resolution = setting.lag_samples, setting.resolution
    for block in judged_blocks(recording, axes, lag, window, resolution):
        squared = block.nearest_on_surface[0][:, 0]
        stretch = np.minimum((block.due_s / width_s).astype(np.int64), stretches)
        # The largest distance of each interval is assigned last, and so it stays.
        order = np.argsort(squared, kind="stable")
        order = order[squared[order] > worst[stretch[order]]]
        worst[stretch[order]], time_s[stretch[order]] = squared[order], block.time_s[order]
    seen = worst >= 0.0
    return time_s[seen], np.sqrt(worst[seen])
