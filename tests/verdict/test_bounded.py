"""Memory does not grow with the length of the job."""

from __future__ import annotations

import tracemalloc

import pytest

from threadline.verdict import judge, load_spec

from .long_jobs import CHUNK, long_job


def peak_and_verdict(chunks: int):
    plan, recording = long_job(chunks)
    spec = load_spec(None, plan.machine)
    tracemalloc.start()
    verdict = judge([recording], plan, spec)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak, verdict


def test_ten_times_the_job_needs_no_more_memory() -> None:
    """A judge that kept the samples would need ten times as much; a quarter allows for the heap."""
    peak_and_verdict(4)  # compiles, fills caches
    short, _ = peak_and_verdict(4)
    long, verdict = peak_and_verdict(40)
    assert long < 1.25 * short
    # The fault in the middle chunk is found, with its place.
    found = verdict.result("contour_error")
    # X is 0.2 mm aside for a chunk: at its turning point no part of the path is nearer.
    assert found.measured == pytest.approx(2e-4, abs=1e-12)
    assert found.operation == pytest.approx(20 * CHUNK, abs=CHUNK)
    assert verdict.result("tracking_error", "X").measured == pytest.approx(2e-4, abs=1e-12)
