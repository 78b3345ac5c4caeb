"""Trees of blark, each text parsed once for all workers of the tests.

blark takes a third of a second for a statement. Its trees lie in pytest's own cache, by a digest of
the text, the rule and the versions of blark and lark.
"""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from blark.parse import parse_source_code
from lark import Tree
from lark.parsers.earley import Parser

KEPT = Path(__file__).parents[3] / ".pytest_cache" / "blark"


@cache
def parsed(text: str, rule: str | None = None) -> Tree[Any]:
    """Return the tree of ``text``, which nobody may change."""
    words = repr((text, rule, version("blark"), version("lark")))
    file = KEPT / hashlib.sha256(words.encode()).hexdigest()
    if file.exists():
        found: Tree[Any] = pickle.loads(file.read_bytes())
        return found
    with pytest.MonkeyPatch.context() as patched:
        _quicker(patched)
        result = parse_source_code(text, **({} if rule is None else {"starting_rule": rule}))
    assert result.exception is None, (text, result.exception)
    KEPT.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(f".{os.getpid()}")
    part.write_bytes(pickle.dumps(result.tree))
    part.replace(file)  # whole, or not there
    return result.tree


class _Once(dict[Any, Any]):
    """The rules of each symbol and of every symbol with which it begins, by first request."""

    def __init__(self, rules: Mapping[Any, Any]) -> None:
        super().__init__()
        self._rules = rules

    def __missing__(self, symbol: Any) -> Any:
        found = self._rules[symbol]
        self.update((rule.origin, ()) for rule in found)
        return found


def _quicker(patched: pytest.MonkeyPatch) -> None:
    """Let lark predict the beginnings of a symbol once for each place in the text.

    It does so for every item that awaits the symbol there, or a symbol that begins with it, and
    finds each time that it has all of them: nine tenths of its work. The trees are the same.
    """
    predict = Parser.predict_and_complete

    def predict_once(self: Any, *place: Any) -> None:
        rules = self.predictions
        self.predictions = _Once(rules)
        try:
            predict(self, *place)
        finally:
            self.predictions = rules

    patched.setattr(Parser, "predict_and_complete", predict_once)
