"""The plan and the specification for the tests of the yield."""

from __future__ import annotations

import pytest

from tests.search.plans import JOB
from threadline.commands.plan import Plan
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.verdict import Spec, load_spec


@pytest.fixture(scope="module")
def asked() -> tuple[Plan, Spec]:
    machine = load_machine("lathe-winder")
    plan = plan_job(open_job(JOB, machine, Options()), machine, Options())
    return plan, load_spec(None, machine)
