"""Refusals before and at LinuxCNC's HAL, one line each."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.live.bench import winder
from tests.live.hal_bench import awake, hal_alone, left_samples, refuse_slept
from tests.live.test_hal import winder_at_1_ms
from threadline.errors import LinkFaultError, OptionError
from threadline.files import RunEnd
from threadline.live.hal_link import check_hal
from threadline.live.hal_session import HalSession
from threadline.live.links import link_of
from threadline.machine import load_machine

ZERO = np.zeros(3, np.int64)


@pytest.fixture(autouse=True)
def hal_lock(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Run one test of HAL at a time."""
    with hal_alone(monkeypatch):
        yield


def test_refusals(monkeypatch: pytest.MonkeyPatch) -> None:
    """One line each, before anything is started."""
    for name in ("letter-placer", "schiffli-frame"):
        with pytest.raises(OptionError, match="not driven by tables of ticks"):
            link_of("hal:loopback", load_machine(name), 1.0, None)
    with pytest.raises(OptionError, match="hal:loopback or hal:plant"):
        link_of("hal:mill", winder(), 1.0, None)
    with pytest.raises(OptionError, match="no encoders"):
        link_of("hal:plant", load_machine("stepper-winder"), 1.0, None)
    with pytest.raises(OptionError, match="need the simulated machine"):
        link_of("hal:plant", winder(), 2.0, None)
    hal = HalSession(winder(), ZERO, plant=False)
    try:
        with pytest.raises(OptionError, match="runs on this computer already"):
            check_hal(winder())
    finally:
        hal.close()
    with monkeypatch.context() as other:
        other.delenv("SUDO_UID", raising=False)
        other.setattr("os.geteuid", lambda: 0)
        with pytest.raises(OptionError, match="refuses to run as root"):
            check_hal(winder())
        other.setenv("PATH", "")
        with pytest.raises(OptionError, match="is not installed"):
            check_hal(winder())


def test_another_layout_of_the_fifo_is_refused(tmp_path: Path) -> None:
    """Nothing is written into memory with another layout than expected."""
    hal = HalSession(winder(), ZERO, plant=False)
    try:
        with pytest.raises(LinkFaultError, match="differs from LinuxCNC"):
            left_samples(winder_at_1_ms(tmp_path))
    finally:
        hal.close()


def test_a_run_for_which_nobody_had_the_processor_is_begun_again() -> None:
    """This works for a long reason, too: a failed comparison shows only the begin of it."""
    reason = f"the machine was to go {'on ' * 200}, and the refills came too late"
    begun = []

    @awake
    def once(ended: RunEnd) -> None:
        begun.append(ended)
        if len(begun) == 1:
            refuse_slept((ended, reason))
        assert len(begun) == 2

    once(RunEnd.FAULT)
    begun.clear()
    with pytest.raises(AssertionError):
        once(RunEnd.STOPPED)
