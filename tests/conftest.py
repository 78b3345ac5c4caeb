"""Fixtures that every folder of tests shares."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "fixed",
    derandomize=True,
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("fixed")

ROOT = Path(__file__).resolve().parent.parent
SHARED_SAMPLES = ROOT.parent / "shared" / "samples"


@pytest.fixture
def examples() -> Path:
    """The folder of jobs that come with the project."""
    return ROOT / "examples"


@pytest.fixture
def shared_samples() -> Path:
    """The folder of files that others wrote; absent outside the project's own machines."""
    if not SHARED_SAMPLES.is_dir():
        if os.environ.get("CI") == "true" and SHARED_SAMPLES.parent.is_dir():
            pytest.fail(f"{SHARED_SAMPLES} is missing")
        pytest.skip("no folder of sample files beside this checkout")
    return SHARED_SAMPLES
