"""Gains and filters designed from the plant, and feed-forward through its exact inverse."""

from threadline.control.feedforward import FeedForward, feed_forward
from threadline.control.inverse import Followed, Inverse, Motion, inverse_of
from threadline.control.lead import LeadDesign, design_lead, lead_deg, lead_from_response
from threadline.control.preview import AxisPreview, Demand, Timing, timing_of
from threadline.control.smooth import SmoothMotion, smooth_motion

__all__ = [
    "AxisPreview",
    "Demand",
    "FeedForward",
    "Followed",
    "Inverse",
    "LeadDesign",
    "Motion",
    "SmoothMotion",
    "Timing",
    "design_lead",
    "feed_forward",
    "inverse_of",
    "lead_deg",
    "lead_from_response",
    "smooth_motion",
    "timing_of",
]
