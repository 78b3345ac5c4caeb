"""The reasons why a proof out of specification is not run: each missing criterion once."""

from __future__ import annotations

from pathlib import Path

import pytest

from threadline.errors import ProofError
from threadline.live.supervised import check_runnable
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, prove_plan
from threadline.proof.proof_file import write_proof
from threadline.verdict import load_spec

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_a_criterion_of_every_step_is_named_once(tmp_path: Path) -> None:
    """X rings too much in several steps; an optional criterion need not be measured."""
    machine = load_machine("letter-placer")
    plan = plan_job(
        open_job(EXAMPLES / "letter-cycle.toml", machine, Options()), machine, Options()
    )
    proof = prove_plan(plan, load_spec(None, machine))
    failed = [(r.name, r.axis) for r in proof.verdict.results if r.status == "failed"]
    assert len(failed) > len(set(failed))
    file = tmp_path / "p.proof.json"
    write_proof(proof, file)
    with pytest.raises(ProofError) as refused:
        check_runnable(file, plan, load_spec(None, machine), None)
    job, _, named = str(refused.value).partition(" is out of specification: ")
    assert job.endswith(f"] {plan.job.name}")  # without a proof file to name
    words = named.partition(". Shape its moves")[0].split(", ")
    assert words == [" ".join(one).strip() for one in dict.fromkeys(failed)][:4]
