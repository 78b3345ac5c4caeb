"""Tick-exact simulation: commands and machine in, recording out; batches of variants."""

from threadline.twin.batch import (
    BatchOptions,
    BatchResult,
    simulate_batch,
    simulate_position_runs,
)
from threadline.twin.session import Session
from threadline.twin.simulate import fastest_rates, session_of, simulate, simulate_runs

__all__ = [
    "BatchOptions", "BatchResult", "Session", "fastest_rates", "session_of", "simulate",
    "simulate_batch", "simulate_position_runs", "simulate_runs",
]  # fmt: skip
