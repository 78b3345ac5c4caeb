"""How far the search for the worst machine depends on the seed of its corners.

    python -m tools.worst_seeds 4 examples/stitcher-test-path.seam.toml stitcher \
        spec=examples/stitcher-place.spec.toml feed_forward=yes "needle=22 stitch/s"

prints, for each seed, the largest used share of a limit in the searched machines in one run, and in
the machine that counts on 20 and on 200 days.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from threadline.machine import load_machine
from threadline.machine.vary import REPEAT_SEED, drawn_days
from threadline.proof.option_form import Door, Word
from threadline.proof.options import options_of
from threadline.proof.pipeline import open_job, plan_job
from threadline.proof.request import Words
from threadline.proof.worst_machine import WithinTolerances, shares_of
from threadline.proof.worst_search import WorstSearch


def main(seeds: str, job: str, reference: str, *pairs_given: str) -> None:
    """Print a line for each seed."""
    pairs = (one.split("=", 1) for one in pairs_given)
    given: dict[str, Word] = {word: True if text == "yes" else text for word, text in pairs}
    words, machine = Words.of("prove", Door.PYTHON, given), load_machine(reference)
    options = options_of(**words.planning())
    plan = plan_job(open_job(Path(job), machine, options), machine, options)
    within = WithinTolerances(plan, words.spec(machine), threads=1)
    for seed in range(1, int(seeds) + 1):
        search = WorstSearch(within, seed=seed)
        search.begin()
        search.go_on()
        shares = [shares_of(search.found)[0].max()]
        few = drawn_days(20, len(plan.axes), np.random.default_rng(REPEAT_SEED))
        parts = search.parts[[search.worst_of_days(few)]]
        for count in (20, 200):
            days = drawn_days(count, len(plan.axes), np.random.default_rng(REPEAT_SEED))
            shares.append(shares_of(within.in_days(parts, days))[0].max())
        share_texts = ", ".join(f"{share * 100.0:.1f} %" for share in shares)
        print(f"seed {seed}: {search.searched} machines, {share_texts}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
