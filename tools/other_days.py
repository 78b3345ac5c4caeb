"""Judge claims of the level *repeated* on other days than those of the program's own seed.

    python -m tools.other_days 5                    every row *repeated* of the validation pages
    python -m tools.other_days 5 winder 'x-180'     rows of a page that have a text in them
    python -m tools.other_days 5 -- 'threadline prove examples/x-180.prg -m lathe-winder'

runs each command once with its own days, then with as many other seeds, and prints the verdict, the
number of runs that it rests on, and the used share of the tightest limit.
"""

from __future__ import annotations

import contextlib
import io
import json
import shlex
import sys
from collections.abc import Iterator
from unittest.mock import patch

from tools.validation import pages, rows_of

from threadline.cli.main import main as threadline
from threadline.machine.vary import REPEAT_SEED

FIRST_SEED = 2001  # of the other days: one more for each


def claims(page: str, text: str) -> Iterator[str]:
    """Yield the commands of rows of the level *repeated* that prove one plan, each once."""
    found: dict[str, None] = {}
    for one in pages():
        for row in rows_of(one):
            last = row.command.rpartition(" && ")[2]
            wanted = page in one.name and text in f"{row.claim} {row.command}"
            if wanted and row.level == "repeated" and last.startswith("threadline prove "):
                found[row.command] = None
    yield from found


def verdict(command: str, seed: int) -> str:
    """Return what ``prove`` says when its days are drawn from ``seed``."""
    output, status = io.StringIO(), 0
    before, _, last = command.rpartition(" && ")
    if before:
        verdict(before, seed)
    with patch("threadline.proof.pipeline.REPEAT_SEED", seed), contextlib.redirect_stdout(output):
        try:
            threadline([*shlex.split(last)[1:], "--json"])
        except SystemExit as stopped:
            status = int(stopped.code or 0)
    if status > 1:
        raise ValueError(f"{last} ends with {status}")
    said = json.loads(output.getvalue())
    if "tightest" not in said:
        return ""
    shares = {
        " ".join(filter(None, (c["name"], c["axis"], c.get("step")))): c["measured"] / c["limit"]
        for c in said["criteria"]
        if c["limit"] and c["measured"] is not None and c.get("of") == "run"
    }
    most = sorted(shares, key=lambda name: -shares[name])[:3]
    parts = ", ".join(f"{100.0 * shares[name]:.1f} % of {name}" for name in most)
    return f"{'in' if said['passed'] else 'OUT OF'} spec, {said['runs']} runs: {parts}"


def main(*words: str) -> None:
    """Print the verdicts of each claim."""
    seeds = int(words[0])
    apart = words[1:2] == ("--",)
    for command in words[2:] if apart else claims(*[*words[1:], "", ""][:2]):
        print(command, flush=True)
        for seed in (REPEAT_SEED, *range(FIRST_SEED, FIRST_SEED + seeds)):
            print(f"    seed {seed}: {verdict(command, seed)}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
