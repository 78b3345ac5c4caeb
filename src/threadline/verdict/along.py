"""The contour error along the job, for a figure: the largest in each of many stretches of time."""

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

    Distances are those of the measure ``contour_error`` from samples to chords, within the same
    lag; a programmed point that is passed at a distance is not in them. The recording is read
    once, in bounded memory.

    Parameters
    ----------
    stretches
        The job is cut into so many; each gives its largest distance, at its own time.

    Returns
    -------
    tuple or None
        None where the recording lacks a channel that the measure needs.
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
        # The largest of each stretch comes last, and what is assigned last stays.
        order = np.argsort(squared, kind="stable")
        order = order[squared[order] > worst[stretch[order]]]
        worst[stretch[order]], time_s[stretch[order]] = squared[order], block.time_s[order]
    seen = worst >= 0.0
    return time_s[seen], np.sqrt(worst[seen])
