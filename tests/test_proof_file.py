"""A proof is a file: what each of its hashes is of, and what is said when one of them differs."""

from __future__ import annotations

import hashlib
import io
import json
import re
import shutil
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.machine.test_par import PRINTED
from threadline.cli.main import main
from threadline.errors import ProofError
from threadline.machine import load_machine
from threadline.option_words import parse_feed
from threadline.options import Options
from threadline.pipeline import REPEATED, Trials, open_job, plan_job, prove
from threadline.proof_file import check_proof, read_proof, spec_sha256, verify_proof, write_proof
from threadline.verdict import load_spec

EXAMPLES = Path(__file__).parents[1] / "examples"
PARTS = ("job", "machine", "actual", "options", "spec", "commands")


@pytest.fixture
def shop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with jobs of both kinds, a machine on a base, an overlay, and a specification."""
    for name in ("x-180.prg", "letter-cycle.toml"):
        shutil.copy(EXAMPLES / name, tmp_path / name)
    (tmp_path / "mine.toml").write_text(
        'base = "base.toml"\nname = "mine"\n'
        '[overlays.slow.axes.X]\nvelocity = "100 mm/s exact, assumed"\n'
    )
    (tmp_path / "base.toml").write_text('base = "lathe-winder"\nname = "base"\n')
    (tmp_path / "asked.toml").write_text(
        'name = "asked"\n[[criteria]]\nname = "contour_error"\nlimit = "2 mm"\n'
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*words: str) -> tuple[object, str]:
    """Return exit status and what was told on standard error."""
    told = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(told), pytest.raises(SystemExit) as left:
        main([*words])
    return left.value.code, told.getvalue().strip()


def proved(shop: Path, *more: str, job: str = "x-180.prg", machine: str = "mine.toml+slow") -> Path:
    file = shop / "x.proof.json"
    status, said = run("prove", job, "-m", machine, "--proof", str(file), "--json", *more)
    assert status in {0, 1}, said
    return file


WINDER = ("--interpolation", "linear", "--feed", "10 count/tick", "-s", "asked.toml")


def test_the_file_says_all_that_the_proof_is_made_from(shop: Path) -> None:
    file = proved(shop, *WINDER)
    content = json.loads(file.read_text())
    machine = load_machine("mine.toml+slow")
    assert content["format"] == "threadline proof 1"
    assert content["level"] == "repeated"
    assert (content["runs"], content["machines"]) == (20, 0)
    assert content["job"]["sha256"] == hashlib.sha256(Path("x-180.prg").read_bytes()).hexdigest()
    assert content["machine"]["sha256"] == machine.sha256
    assert content["machine"]["reference"] == "mine.toml+slow"
    assert content["options"]["given"]["feed"] == "10.0 count/tick"
    assert content["spec"]["sha256"] == spec_sha256(load_spec("asked.toml", machine))
    options = Options(interpolation="linear", feed=parse_feed("10 count/tick"))
    plan = plan_job(open_job(Path("x-180.prg"), machine, options), machine, options)
    assert content["commands"] == {"kind": "ticks", "sha256": plan.commands.rows_sha256()}
    names = {criterion["name"] for criterion in content["verdict"]["criteria"]}
    assert {"contour_error", "path_deviation", "velocity"} <= names
    # By another program's means: JSON with sorted keys and no blanks, without the hash itself.
    rest = {key: value for key, value in content.items() if key != "sha256"}
    canonical = json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    assert content["sha256"] == hashlib.sha256(canonical.encode()).hexdigest()
    assert list(content) == sorted(content)
    # Equal proofs give equal bytes.
    assert proved(shop, *WINDER).read_bytes() == file.read_bytes()


def test_two_feeds_of_one_job_differ(shop: Path) -> None:
    slow = json.loads(proved(shop, *WINDER).read_text())
    fast = json.loads(proved(shop, *WINDER[:3], "12 count/tick", *WINDER[4:]).read_text())
    differing = {part for part in PARTS if slow[part] != fast[part]}
    assert differing == {"options", "commands"}


CHANGES: dict[str, tuple[Callable[[Path], Any], str]] = {
    "job": (
        lambda shop: (shop / "x-180.prg").write_text(
            (shop / "x-180.prg").read_text() + "(another line)\n"
        ),
        r"job 'x-180\.prg' has the sha256 [0-9a-f]{12}, the proof has [0-9a-f]{12}",
    ),
    "base of the machine": (
        lambda shop: (shop / "base.toml").write_text(
            'base = "lathe-winder"\nname = "base"\n'
            '[bodies.x]\ninertia = "4e-4 kg m^2 exact, assumed"\n'
        ),
        r"machine 'mine\+slow' has the sha256",
    ),
    "overlay of the machine": (
        lambda shop: (shop / "mine.toml").write_text(
            (shop / "mine.toml").read_text().replace("100 mm/s", "90 mm/s")
        ),
        r"machine 'mine\+slow' has the sha256",
    ),
    "spec": (
        lambda shop: (shop / "asked.toml").write_text(
            (shop / "asked.toml").read_text().replace("2 mm", "3 mm")
        ),
        r"spec 'asked' has the sha256",
    ),
}


@pytest.mark.parametrize("what", CHANGES)
def test_verify_names_what_changed(shop: Path, what: str) -> None:
    """A comment of the machine or the specification is no change; of a job its bytes count."""
    file = proved(shop, *WINDER)
    mine = shop / "mine.toml"
    mine.write_text("# a comment\n" + mine.read_text())
    assert verify_proof(file) == ()
    status, said = run("verify", str(file))
    assert (status, said) == (0 if read_proof(file).passed else 1, "")
    change, message = CHANGES[what]
    change(shop)
    status, said = run("verify", str(file))
    assert status == 2
    assert "\n" not in said
    assert said.startswith("error: [PROOF] x.proof.json: it is no proof of what there is now: ")
    assert re.search(message, said)


def test_a_proof_is_verified_from_any_folder(
    shop: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The names in it count from its own folder: a project can be moved as a whole."""
    file = proved(shop, *WINDER)
    moved = tmp_path_factory.mktemp("elsewhere") / "project"
    shutil.copytree(shop, moved)
    monkeypatch.chdir(moved.parent)
    assert verify_proof(moved / file.name) == ()


def test_parameters_and_the_actual_machine_are_part_of_it(shop: Path) -> None:
    par = shop / "FW-CNC.PAR"
    par.write_text(PRINTED)
    file = proved(shop, *WINDER, "--par", str(par), "--actual", "mine.toml")
    content = json.loads(file.read_text())
    assert content["machine"]["par"] == "FW-CNC.PAR"
    assert content["actual"]["name"] == "mine"
    assert verify_proof(file) == ()
    par.write_text(PRINTED + "\n")
    assert {found.what for found in verify_proof(file)} == {"machine", "actual"}


def test_an_executor_is_told_what_is_not_what_was_proved(shop: Path) -> None:
    file = proved(shop, *WINDER)
    machine = load_machine("mine.toml+slow")
    options = Options(interpolation="linear", feed=parse_feed("10 count/tick"))
    spec = load_spec("asked.toml", machine)
    plan = plan_job(open_job(Path("x-180.prg"), machine, options), machine, options)
    assert check_proof(file, plan, spec) == ()
    other = plan_job(plan.job, machine, replace(options, feed=parse_feed("11 count/tick")))
    assert [found.what for found in check_proof(file, other, spec)] == ["options", "commands"]
    assert [found.what for found in check_proof(file, plan, spec.with_margin(0.2))] == ["spec"]
    assert [found.what for found in check_proof(file, plan, spec, machine)] == ["actual"]


def test_a_schedule_has_a_proof_too(shop: Path) -> None:
    file = proved(
        shop, "--shaper", "zv", job="letter-cycle.toml",
        machine="letter-placer+whole-scans+own-damping",
    )  # fmt: skip
    content = json.loads(file.read_text())
    assert content["commands"]["kind"] == "switches"
    assert content["spec"]["file"] is None
    assert verify_proof(file) == ()
    cycle = shop / "letter-cycle.toml"
    cycle.write_text(cycle.read_text().replace("ms", "ms ", 1))
    assert [found.what for found in verify_proof(file)] == ["job"]


def test_levels(shop: Path) -> None:
    machine = load_machine("mine.toml")
    options = Options(interpolation="linear", feed=parse_feed("40 count/tick"))
    spec = load_spec(None, machine)
    for trials, level in (
        (Trials(repeats=2), "nominal"),
        (REPEATED, "repeated"),
        (Trials(repeats=2, machines=3), "over tolerances"),
    ):
        proof = prove(Path("x-180.prg"), machine, spec, options, trials=trials)
        write_proof(proof, "level.json")
        known = read_proof("level.json")
        assert known.level == level
        assert known.content["runs"] == trials.repeats
        assert known.content["machines"] == trials.machines


BAD = {
    "no JSON": ("{", "is no JSON"),
    "a list": ("[]", "does not say that it is a 'threadline proof 1'"),
    "no number": ('{"format": NaN}', "is no JSON"),
    "another version": ('{"format": "threadline proof 99"}', "does not say"),
    "half a character": ('{"format": "threadline proof 1", "level": "\\ud800"}', "is no JSON"),
    "no end": ('{"format": "threadline proof 1", "runs": 1e400}', "is no JSON"),
    "no hash": ('{"format": "threadline proof 1"}', "was changed since it was written"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_proof_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    text, message = BAD[name]
    file = tmp_path / "x.json"
    file.write_text(text)
    with pytest.raises(ProofError, match=message) as caught:
        read_proof(file)
    assert "\n" not in str(caught.value)


OF_ANOTHER_FORM = [
    ("level", None), ("job", "x-180.prg"), ("job.file", 1), ("machine", []),
    ("machine.par", False), ("actual", {"sha256": ""}), ("spec.file", {}),
    ("commands.sha256", None), ("options.given", None), ("options.given.limits", 1.0),
    ("verdict", None), ("verdict.passed", "no"), ("verdict.passed", 1),
    ("verdict.criteria", [1]), ("threadline", ...), ("verdict.simulated", ...), ("actual", ...),
]  # fmt: skip


def test_a_proof_of_another_form_is_refused_in_one_line(shop: Path) -> None:
    """Its hash says that it was written so: what wrote it was another program."""
    file = proved(shop, *WINDER)
    proof = file.read_text("utf-8")
    for entry, value in OF_ANOTHER_FORM:
        content = json.loads(proof)
        *parts, last = entry.split(".")
        part = content
        for name in parts:
            part = part[name]
        part.pop(last)
        if value is not ...:
            part[last] = value
        content.pop("sha256")
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        content["sha256"] = hashlib.sha256(text.encode()).hexdigest()
        file.write_text(json.dumps(content), "utf-8")
        status, said = run("verify", str(file))
        assert status == 2, (entry, said)
        assert f"'{entry}" in said, (entry, said)
        assert "\n" not in said


def test_a_changed_verdict_is_noticed(shop: Path) -> None:
    file = proved(shop, *WINDER)
    content = json.loads(file.read_text())
    content["verdict"]["passed"] = not content["verdict"]["passed"]
    file.write_text(json.dumps(content))
    with pytest.raises(ProofError, match="was changed since it was written"):
        verify_proof(file)
    status, said = run("verify", str(file))
    assert status == 2
    assert "\n" not in said
