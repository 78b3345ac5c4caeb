"""A scheduler and its workers on this computer, as processes of a test."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).parents[2]
_WAIT_S = 120.0
_OF_WORKER = ("--nthreads", "1", "--no-nanny", "--death-timeout", "60")


class Fleet:
    """A scheduler with workers of one thread each; without nannies, a dead worker stays dead."""

    def __init__(self, folder: Path, workers: int, tls: Mapping[str, str] | None = None) -> None:
        self.folder = folder
        self._env = {
            **os.environ,
            "PYTHONPATH": f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}",
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
            **(tls or {}),
        }
        self._way = "tls" if tls else "tcp"
        self.scheduler, self.address = self._scheduled("scheduler", 0)
        self.workers = [self.with_worker() for _ in range(workers)]

    def begin_again(self) -> None:
        """Kill scheduler and workers, and start new ones at the same address."""
        self.end()
        port = int(self.address.rpartition(":")[2])
        self.scheduler, _ = self._scheduled("scheduler-again", port)
        self.workers = [self.with_worker()]

    def _scheduled(self, name: str, port: int) -> tuple[subprocess.Popen[bytes], str]:
        host = f"{self._way}://127.0.0.1"
        begun = self._started(
            name, "scheduler", "--host", host, "--port", str(port), "--idle-timeout", "900"
        )
        return begun, self._said(name, rf"Scheduler at: +({self._way}://[0-9.]+:[0-9]+)")

    def with_worker(self, *words: str) -> subprocess.Popen[bytes]:
        """Start another worker; it joins a moment later."""
        own = f"worker-{time.monotonic_ns()}"
        return self._started(own, "worker", self.address, *_OF_WORKER, *words)

    def _started(self, name: str, which: str, *words: str) -> subprocess.Popen[bytes]:
        with (self.folder / f"{name}.log").open("wb") as log:
            return subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.dask_{which}", *words, "--no-dashboard"],
                cwd=self.folder, env=self._env, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            )  # fmt: skip

    def _said(self, name: str, pattern: str) -> str:
        end_s = time.monotonic() + _WAIT_S
        while time.monotonic() < end_s:
            if found := re.search(pattern, (self.folder / f"{name}.log").read_text("utf-8")):
                return found[1]
            time.sleep(0.05)
        raise TimeoutError((self.folder / f"{name}.log").read_text("utf-8"))

    def end(self) -> None:
        """End all processes, and wait until they have ended."""
        own = [*self.workers, self.scheduler]
        for one in own:
            if one.poll() is None:
                one.send_signal(signal.SIGKILL)
        for one in own:
            one.wait()
