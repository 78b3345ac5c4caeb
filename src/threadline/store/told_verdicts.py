"""The verdicts of kept runs in the words that a verdict itself begins with.

The index knows only whether a run has passed. Whether one that has not is out of specification or
not proven is in its folder.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from threadline.store.index import REFUSED, RunRecord
from threadline.store.run_store import PROOF, VERDICT
from threadline.verdict.rendering import word_of_json

NOT_JUDGED = "not judged"


def verdict_of_run(record: RunRecord, folder: Path) -> str:
    """Return the verdict of a run in a word or two; ``folder`` is that of the run."""
    if record.ended == REFUSED:
        return REFUSED
    if record.passed is None:
        return NOT_JUDGED
    return _word(folder / VERDICT, record.passed)


def verdict_of_proof(record: RunRecord, folder: Path) -> str:
    """Return the verdict of the proof that a run began with, without its level."""
    return _word(folder / PROOF, record.proof_passed)


def _word(file: Path, passed: bool) -> str:
    """Return the word of what a file holds, or of what the index says where it cannot be read."""
    try:
        content: Mapping[str, Any] = json.loads(file.read_bytes())
        told = content.get("verdict", content)  # a proof has a verdict, and its level beside it
        return word_of_json({**told, "level": content.get("level")})
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return "in spec" if passed else "not passed"
