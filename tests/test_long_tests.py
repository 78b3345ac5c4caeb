"""The tests that ``make test`` leaves out: counted, and each with a shorter test in its place."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.long_tests import UNSHOWN
from tests.test_core_types import suite

SUITE = (
    "import pytest\n"
    "@pytest.mark.long(shown_by='test_short')\ndef test_whole(): pass\n"
    "def test_short(): pass\n"
    "@pytest.mark.long(but='few')\n"
    "@pytest.mark.parametrize('n', [2, 20, 30], ids=['few', 'some', 'many'])\n"
    "def test_some(n): pass\n"
)


def test_each_long_test_has_a_shorter_one(request: pytest.FixtureRequest) -> None:
    """Only if the whole suite is collected: a part of it lacks some of the named tests."""
    one_by_one = request.config.stash[UNSHOWN]
    assert not one_by_one, "\n".join(one_by_one)


@pytest.mark.long(only="workers")
@pytest.mark.parametrize("words", [("-n", "1"), ()], ids=["workers", "alone"])
def test_long_tests_are_left_out_and_counted(tmp_path: Path, words: tuple[str, ...]) -> None:
    (tmp_path / "test_all.py").write_text(SUITE)
    short = suite(tmp_path, "", "-rp", "--without-long", *words)
    assert set(re.findall(r"PASSED \S+::(\S+)", short.stdout)) == {"test_short", "test_some[few]"}
    assert "3 long tests were left to `make test-all`." in short.stdout
    whole = suite(tmp_path, "", *words)
    assert "5 passed" in whole.stdout and "left to" not in whole.stdout


def test_a_long_test_that_nothing_stands_for_is_named(tmp_path: Path) -> None:
    """A mark must not name a missing case either, or it would choose nothing."""
    text = SUITE.replace("'few')", "'fewer')").replace("'test_short'", "'x'")
    (tmp_path / "test_all.py").write_text(text)
    (tmp_path / "test_rule.py").write_text(
        "from tests.test_long_tests import test_each_long_test_has_a_shorter_one\n"
    )
    done = suite(tmp_path, "")
    assert done.returncode == 1
    for name in ("test_whole", "test_some"):
        assert f"test_all.py::{name} is long, and no shorter" in done.stdout
    assert "test_all.py::test_some has no case 'fewer'" in done.stdout
