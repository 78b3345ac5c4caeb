"""Long tests: ``make test`` leaves them to ``make test-all``, and its last lines say how many.

A long test goes into the breadth of a behaviour that a shorter test shows. Its mark names what
stays in ``make test``: another test (``@pytest.mark.long(shown_by="test_x")``, or
``shown_by="tests/search/test_x.py::test_x"``), or other cases of its own: all but these are long
(``@pytest.mark.long(but="few")``) or only these are (``@pytest.mark.long(only=("some", "many"))``).
"""

from __future__ import annotations

from typing import Any

import pytest

LEFT = pytest.StashKey[int]()
UNSHOWN = pytest.StashKey[list[str]]()
"""How many tests a run leaves out; the long tests of the suite that nothing shorter stands for."""


def is_long(item: pytest.Item) -> bool:
    """Return whether a test, or this case of it, is long."""
    mark = item.get_closest_marker("long")
    if mark is None:
        return False
    case = getattr(item, "callspec", None)
    if case is None or "shown_by" in mark.kwargs:
        return True
    if "only" in mark.kwargs:
        return case.id in _ids(mark.kwargs["only"])
    return case.id not in _ids(mark.kwargs["but"])


def _ids(worker_output: str | tuple[str, ...]) -> tuple[str, ...]:
    return (worker_output,) if isinstance(worker_output, str) else worker_output


def _plain(item: pytest.Item) -> str:
    return item.nodeid.partition("[")[0]


def unshown(items: list[pytest.Item]) -> list[str]:
    """Return the long tests whose mark is wrong.

    The named test does not exist or is long itself, no case stays, or no case has a named id.
    """
    shorter = {_plain(item) for item in items if not is_long(item)}
    names = {item.nodeid for item in items}
    found = set()
    for item in items:
        mark = item.get_closest_marker("long")
        if mark is None:
            continue
        own = _plain(item)
        for case in _ids(mark.kwargs.get("only", mark.kwargs.get("but", ()))):
            if f"{own}[{case}]" not in names:
                found.add(f"{own} has no case {case!r}")
        shown_by = mark.kwargs.get("shown_by")
        if shown_by is None:
            expected = own
        elif "::" in shown_by:
            expected = shown_by
        else:
            expected = f"{own.partition('::')[0]}::{shown_by}"
        if expected not in shorter:
            found.add(f"{own} is long, and no shorter {expected} stays in make test")
    return sorted(found)


def leave_out(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect the long tests if the run excludes them, and keep their number.

    Only a run of the whole suite checks that every long test has a shorter one.
    """
    part = config.args_source is pytest.Config.ArgsSource.ARGS
    part = part or bool(config.option.keyword or config.option.markexpr)
    config.stash[UNSHOWN] = [] if part else unshown(items)
    if not config.getoption("without_long", False):
        return
    long = [item for item in items if is_long(item)]
    config.stash[LEFT] = len(long)
    config.hook.pytest_deselected(items=long)
    items[:] = [item for item in items if not is_long(item)]
    worker_output: dict[str, Any] | None = getattr(config, "workeroutput", None)
    if worker_output is not None:
        worker_output["left_long"] = len(long)


class CountLong:
    """Reports at the end how many long tests were left out; under xdist a worker knows it."""

    def __init__(self) -> None:
        self._left = 0

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Take the number from a worker; each has left out the same tests."""
        self._left = max(self._left, getattr(node, "workeroutput", {}).get("left_long", 0))

    def pytest_terminal_summary(self, terminalreporter: Any, config: pytest.Config) -> None:
        """Write one line if a test was left out."""
        left = config.stash.get(LEFT, self._left)
        if left:
            tests = "long test was" if left == 1 else "long tests were"
            terminalreporter.write_line(f"{left} {tests} left to `make test-all`.")
