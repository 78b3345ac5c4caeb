"""Equations of motion of a machine, their analysis, and control design."""

from __future__ import annotations

from threadline.dynamics.feedforward import FeedForward, SmoothMotion, feed_forward, smooth_motion
from threadline.dynamics.inverse import Followed, Inverse, Motion, inverse_of
from threadline.dynamics.lead import LeadDesign, design_lead, lead_deg, lead_from_response
from threadline.dynamics.loop_ticks import InverseOutput
from threadline.dynamics.preview import AxisPreview, Demand, Timing, timing_of
from threadline.dynamics.table_ends import CHOSEN, EARLIEST, AxisEnds, TableEnd

__all__ = [
    "CHOSEN",
    "EARLIEST",
    "AxisEnds",
    "AxisPreview",
    "Demand",
    "FeedForward",
    "Followed",
    "Inverse",
    "InverseOutput",
    "LeadDesign",
    "Motion",
    "SmoothMotion",
    "TableEnd",
    "Timing",
    "design_lead",
    "feed_forward",
    "inverse_of",
    "lead_deg",
    "lead_from_response",
    "smooth_motion",
    "timing_of",
]
