"""Trees of blark, each text parsed once for all workers of the tests.

blark takes a third of a second for a statement. What it has read lies beside pytest's own notes,
by a digest of the text, the rule and the versions of blark and lark.
"""

from __future__ import annotations

import hashlib
import os
import pickle
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from blark.parse import parse_source_code
from lark import Tree

KEPT = Path(__file__).parents[2] / ".pytest_cache" / "blark"


@cache
def parsed(text: str, rule: str | None = None) -> Tree[Any]:
    """Return the tree of ``text``, which nobody may change."""
    words = repr((text, rule, version("blark"), version("lark")))
    file = KEPT / hashlib.sha256(words.encode()).hexdigest()
    if file.exists():
        found: Tree[Any] = pickle.loads(file.read_bytes())
        return found
    result = parse_source_code(text, **({} if rule is None else {"starting_rule": rule}))
    assert result.exception is None, (text, result.exception)
    KEPT.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(f".{os.getpid()}")
    part.write_bytes(pickle.dumps(result.tree))
    part.replace(file)  # whole, or not there
    return result.tree
