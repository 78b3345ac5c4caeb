"""Gains and filters designed from the plant, and feed-forward through its exact inverse."""

from threadline.control.feedforward import FeedForward, feed_forward
from threadline.control.inverse import Followed, Inverse, Motion, inverse_of
from threadline.control.lead import LeadDesign, design_lead, lead_deg, lead_from_response
from threadline.control.preview import AxisPreview, Demand, Timing, timing_of
from threadline.control.smooth import SmoothMotion, smooth_motion
from threadline.control.table_ends import CHOSEN, EARLIEST, AxisEnds, TableEnd
from threadline.control.told_ticks import Told

__all__ = [
    "CHOSEN",
    "EARLIEST",
    "AxisEnds",
    "AxisPreview",
    "Demand",
    "FeedForward",
    "Followed",
    "Inverse",
    "LeadDesign",
    "Motion",
    "SmoothMotion",
    "TableEnd",
    "Timing",
    "Told",
    "design_lead",
    "feed_forward",
    "inverse_of",
    "lead_deg",
    "lead_from_response",
    "smooth_motion",
    "timing_of",
]
