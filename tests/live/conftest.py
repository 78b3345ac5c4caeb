"""What several tests of live machines need."""

from __future__ import annotations

import pytest

from tests.live.kill_bench import forked_link
from threadline.live import sim_process


@pytest.fixture
def forked_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have simulated machines as forks of the test's process, which has imported all they need.

    For what such a machine does; ``test_checked`` and ``test_rehearsed`` start one anew.
    """
    monkeypatch.setattr(sim_process, "process_link", forked_link)
