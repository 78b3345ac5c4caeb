"""Batches that threads of this computer answer."""

from __future__ import annotations

import time

from threadline.base.workers import Done, answers


class Slow:
    """Answers in a hundred steps; the first item answers at once."""

    def __init__(self) -> None:
        self.steps: list[int] = []

    def answer(self, item: int, done: Done | None = None) -> int:
        for _ in range(100 if item else 0):
            self.steps.append(item)
            time.sleep(0.02)
            assert done is not None
            done(0.01)
        return item


def test_answers_that_nobody_waits_for_end_at_their_next_step() -> None:
    """An interrupt closes the generator: a part of a long winding would take a minute."""
    work = Slow()
    found = answers(work, range(6), threads=2)  # type: ignore[arg-type]
    assert next(found) == 0
    began = time.monotonic()
    found.close()  # type: ignore[attr-defined]
    assert time.monotonic() - began < 1.0
    assert len(work.steps) < 50
