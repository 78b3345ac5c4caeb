"""What makes a job slower, in the words of its kind of work."""

from __future__ import annotations

from collections.abc import Mapping

from threadline.jobs.operations import Pace

SLOWER: Mapping[Pace, str] = {
    "feed": "Lower the feed",
    "needle": "Lower the speed of the needle",
    "shaft": "Lower the speed of the shaft",
    "switchings": "Shape its moves (--shaper), or let it rest longer",
}
"""By what sets the speed of a job, see ``Job.paced_by``; each begins a remedy."""
