"""Changes that must not matter to a verdict, and changes that must.

Four classes. ``same-recording``: a run with noise below any resolution, cut into other blocks,
with channels permuted or renamed, at twice the rate, written to a file and read again.
``same-program``: comments, inches, other words for the same moves, a move split in two, a dwell of
0 where the machine rests, a mirrored or a shifted path, axes renamed and in another order.
``same-winding``: the same for a fibre on its mandrel, with eye, chuck and pins beside it.
``same-machine``: other units, tables and keys in another order. The changed one must be judged as
the one before, value by value; and a limit a thousandth below what was measured must fail, while
one a thousandth above it must pass.

Of most programs and machines the path, or each number, is compared; every ``WHOLE``th is proved.
``tools/fuzz_every_kind.py`` makes each change to each kind of machine equally often.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from tools.fuzz_read_works import hold_machines, numbers_of
from tools.fuzz_rewritten import in_another_order, in_other_units
from tools.fuzz_runs import seeds
from tools.fuzz_same_programs import WHOLE, check_program, loaded, outcomes_of_proof, same_verdicts
from tools.fuzz_same_recordings import check_recording, pool, recording_of
from tools.fuzz_same_windings import check_winding

from threadline.errors import ThreadlineError
from threadline.machine import load_machine
from threadline.machine.load import library_file
from threadline.proof.pipeline import prove
from threadline.verdict import Judge, Status, load_spec

CLASSES = ("same-recording", "same-program", "same-winding", "same-machine")


def check_machine(path: Path) -> None:
    """Write a machine of the library in another way, and compare its numbers, or its verdict.

    Raises
    ------
    AssertionError
        If they differ.
    """
    rng = random.Random(path.read_bytes())
    if rng.randrange(4) == 0:
        _check_limit(rng)
        return
    seed = rng.choice(seeds())
    machine = seed.proof.plan.machine
    name, *overlays = machine.reference.split("+")
    text = library_file(name).read_text(encoding="utf-8")
    for change in rng.sample((in_other_units, in_another_order), rng.randint(1, 2)):
        text = change(rng, text)
    file = path.with_name("mine.toml")
    file.write_text(text)
    other = load_machine("+".join([str(file), *overlays]))
    hold_machines(numbers_of(machine), numbers_of(other))
    if rng.randrange(2 * WHOLE) == 0:
        proof = prove(seed.file, other, load_spec(None, other), seed.options)
        same_verdicts(outcomes_of_proof(seed.proof), outcomes_of_proof(proof), text)


def _check_limit(rng: random.Random) -> None:
    """Move a limit of the machine to a thousandth below, or above, what a plan asks of an axis."""
    kept = rng.choice([one for one in pool() if one.runs > 1])
    plan = kept.seed.proof.plan
    name, axis = rng.choice(("velocity", "acceleration", "jerk")), rng.choice(plan.axes)
    value = kept.measured[name, axis, ""]
    factor = rng.choice((0.998, 1.001))  # a thousandth is allowed for rounding
    own = plan.machine.axes[axis]
    limit = replace(getattr(own, name), si=factor * value)
    axes = {**plan.machine.axes, axis: replace(own, **{name: limit})}
    machine = replace(plan.machine, axes=axes)
    verdict = Judge(replace(plan, machine=machine), load_spec(None, machine)).verdict(
        [recording_of(kept.seed, kept.samples)]
    )
    found = {(r.name, r.axis): r.status for r in verdict.results}[name, axis]
    wanted = Status.FAILED if factor < 1.0 else Status.PASSED
    assert found is wanted, f"{name} {axis} of {factor} times its limit {found.value}"


def fuzz_metamorphic() -> dict[str, tuple[str, Callable[..., bytes], Callable[[Path], None], int]]:
    """Return the readers of this module for the table of ``fuzz.py``."""
    checks = (check_recording, check_program, check_winding, check_machine)
    made_before = {check_recording: pool, check_program: loaded, check_machine: pool}
    return {
        name: (
            "case.seed",
            partial(case, made_before.get(check)),
            partial(_not_refused, check),
            1 if check is check_winding else 7,
        )
        for name, check in zip(CLASSES, checks, strict=True)
    }


def _not_refused(check: Callable[[Path], None], path: Path) -> None:
    """Count a refusal as a difference: what is changed was taken before."""
    try:
        check(path)
    except ThreadlineError as error:
        raise AssertionError(f"refused: {error}") from error


def case(made_before: Callable[[], object] | None, rng: random.Random) -> bytes:
    """Return the seed of a case; what all need is made before the first, while none is timed."""
    if made_before is not None:
        made_before()
    return rng.randbytes(16)
