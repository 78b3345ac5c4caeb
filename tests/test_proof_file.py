"""The file of a proof: the meaning of its hashes, and the message if one differs."""

from __future__ import annotations

import hashlib
import hmac
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
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import REPEATED, Trials, open_job, plan_job, prove
from threadline.proof.proof_file import (
    check_proof,
    copy_proof,
    read_proof,
    verify_proof,
    write_proof,
)
from threadline.proof.proof_hash import spec_sha256
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
    """Return exit status and standard error."""
    stream = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(stream), pytest.raises(SystemExit) as left:
        main([*words])
    return left.value.code, stream.getvalue().strip()


def proved(shop: Path, *more: str, job: str = "x-180.prg", machine: str = "mine.toml+slow") -> Path:
    file = shop / "x.proof.json"
    status, output = run("prove", job, "-m", machine, "--proof", str(file), "--json", *more)
    assert status in {0, 1}, output
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
    # Computed independently: JSON with sorted keys and no blanks, without the hash itself.
    rest = {key: value for key, value in content.items() if key != "sha256"}
    canonical = json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    assert content["sha256"] == hashlib.sha256(canonical.encode()).hexdigest()
    assert list(content) == sorted(content)
    # Equal proofs give equal bytes.
    assert proved(shop, *WINDER).read_bytes() == file.read_bytes()


def test_a_proof_of_a_machine_without_loops_reads_back_what_it_wrote(shop: Path) -> None:
    """The contour limit of ``optimal`` bounds the following error of loops: a stepper has none."""
    (shop / "line.gcode").write_text("G21 G90 G94\nG1 X20 A90 F2000\nX40 A0\nM30\n")
    words = ("prove", "line.gcode", "-m", "stepper-winder", "--interpolation", "optimal", "--json")
    status, output = run(*words, "--proof", "x.proof.json", "--recording", "x.npz")
    assert status in {0, 1}, output
    assert "contour" not in json.loads(Path("x.proof.json").read_text())["options"]["given"]
    assert run("verify", "x.proof.json")[0] == 0
    judged, output = run("judge", "x.npz", "--json")
    assert judged == status, output


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
    """A comment in the machine or the specification is no change; of a job every byte counts."""
    file = proved(shop, *WINDER)
    mine = shop / "mine.toml"
    mine.write_text("# a comment\n" + mine.read_text())
    assert verify_proof(file) == ()
    status, output = run("verify", str(file))
    assert (status, output) == (0 if read_proof(file).passed else 1, "")
    change, message = CHANGES[what]
    change(shop)
    status, output = run("verify", str(file))
    assert status == 2
    assert "\n" not in output
    assert output.startswith(
        "error: [PROOF] x.proof.json: the proof does not match its files any more: "
    )
    assert re.search(message, output)


def test_a_proof_is_verified_from_any_folder(
    shop: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its paths count from its own folder: a project can be moved as a whole."""
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
    "no JSON": ("{", "is not JSON"),
    "a list": ("[]", "is not marked as a 'threadline proof 1'"),
    "no number": ('{"format": NaN}', "is not JSON"),
    "another version": ('{"format": "threadline proof 99"}', "is not marked as"),
    "half a character": ('{"format": "threadline proof 1", "level": "\\ud800"}', "is not JSON"),
    "no end": ('{"format": "threadline proof 1", "runs": 1e400}', "is not JSON"),
    "no hash": ('{"format": "threadline proof 1"}', "was changed since it was written"),
}


@pytest.mark.parametrize("name", BAD)
def test_malformed_proof_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    text, message = BAD[name]
    file = tmp_path / "x.json"
    file.write_text(text)
    with pytest.raises(ProofError, match=message) as caught:
        read_proof(file)
    assert "\n" not in str(caught.value)


def write_again(content: dict[str, Any], file: Path) -> None:
    """Write a changed proof with the right hash of its new content."""
    content.pop("sha256", None)
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    content["sha256"] = hashlib.sha256(text.encode()).hexdigest()
    file.write_text(json.dumps(content), "utf-8")


OF_ANOTHER_FORM = [
    ("level", None), ("job", "x-180.prg"), ("job.file", 1), ("machine", []),
    ("machine.par", False), ("actual", {"sha256": ""}), ("spec.file", {}),
    ("commands.sha256", None), ("options.given", None), ("options.given.limits", 1.0),
    ("verdict", None), ("verdict.passed", "no"), ("verdict.passed", 1),
    ("verdict.criteria", [1]), ("runs", True), ("runs", 1.5), ("machines", None),
    ("threadline", ...), ("verdict.simulated", ...), ("actual", ...),
]  # fmt: skip


def test_a_proof_of_another_form_is_refused_in_one_line(shop: Path) -> None:
    """Its hash is right, because another program wrote it so."""
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
        write_again(content, file)
        status, output = run("verify", str(file))
        assert status == 2, (entry, output)
        assert f"'{entry}" in output, (entry, output)
        assert "\n" not in output


def test_a_changed_verdict_is_noticed(shop: Path) -> None:
    file = proved(shop, *WINDER)
    content = json.loads(file.read_text())
    content["verdict"]["passed"] = not content["verdict"]["passed"]
    file.write_text(json.dumps(content))
    with pytest.raises(ProofError, match="was changed since it was written"):
        verify_proof(file)
    status, output = run("verify", str(file))
    assert status == 2
    assert "\n" not in output


def first(content: dict[str, Any], status: str) -> dict[str, Any]:
    """Return the first criterion of a status that has a limit."""
    found: dict[str, Any] = next(
        c
        for c in content["verdict"]["criteria"]
        if c["status"] == status and (c["limit"] or status == "not-measured")
    )
    return found


def named(content: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the first criterion of a name."""
    found: dict[str, Any] = next(c for c in content["verdict"]["criteria"] if c["name"] == name)
    return found


OVER = {
    "worst_share": 0.9, "worst_criterion": "contour_error", "searched": 100, "drawn": 200,
    "passed": 200, "at_least": 0.05 ** (1 / 200), "confidence": 0.95,
}  # fmt: skip
"""200 of 200: the least share p for which p^200 is 5 % (Clopper and Pearson)."""


def over(content: dict[str, Any], **changed: float) -> None:
    """Make a proof claim that it holds for machines within the tolerances."""
    tolerances = {**OVER, **changed}
    content.update(machines=200, level="over tolerances", tolerances=tolerances)


FORGED: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "passed alone": (
        lambda c: c["verdict"].update(passed=True),
        "says that it passed, where contour_error failed",
    ),
    "a status": (
        lambda c: first(c, "failed").update(status="passed"),
        "contour_error is 'passed' with 0.000935568 under a limit of 0.0005, which is 'failed'",
    ),
    "a status that is none": (
        lambda c: first(c, "failed").update(status="fine"),
        "contour_error has the unknown status 'fine'",
    ),
    "no value": (
        lambda c: first(c, "failed").update(measured=None, status="passed"),
        "contour_error is 'passed' with nothing measured",
    ),
    "a limit": (
        lambda c: first(c, "failed").update(limit=0.002, status="passed"),
        "the limit of contour_error is 0.002, in the specification 0.0005",
    ),
    "no limit": (
        lambda c: first(c, "failed").update(limit=None, status="reported"),
        "the limit of contour_error is none, in the specification 0.0005",
    ),
    "not required": (
        lambda c: first(c, "failed").update(
            required=False, status="not-measured", measured=None
        ),
        "contour_error is required in only one of proof and specification",
    ),
    "a unit": (
        lambda c: first(c, "failed").update(unit="s", measured=None),
        "contour_error is measured in m, not in 's'",
    ),
    "another name": (
        lambda c: first(c, "failed").update(name="beauty"),
        "there is no criterion 'beauty'",
    ),
    "no criteria": (lambda c: c["verdict"].update(criteria=[], passed=True), "has no criteria"),
    "one criterion fewer": (
        lambda c: c["verdict"]["criteria"].remove(first(c, "failed")),
        "it lacks contour_error, which the specification asks",
    ),
    "a level": (
        lambda c: c.update(level="over tolerances"),
        "its level is 'over tolerances', where 1 runs and 0 other machines reach 'nominal'",
    ),
    "a level that is none": (lambda c: c.update(level="perfect"), "its level is 'perfect'"),
    "a level of a machine without dynamics": (
        lambda c: c.update(level="limits and time alone"),
        "its level is 'limits and time alone', and lathe-winder has dynamics",
    ),
    "less than no runs": (lambda c: c.update(runs=-5), "it counts -5 runs"),
    "more runs than there can be": (
        lambda c: c.update(runs=10**30, level="repeated"),
        "it counts more than 1e12 runs, and a verdict has at most 1200",
    ),
    "more runs than a verdict may have": (
        lambda c: c.update(runs=1201, level="repeated"),
        "it counts 1201 runs, and a verdict has at most 1200",
    ),
    "more machines than there can be": (
        lambda c: c.update(machines=10**7, level="over tolerances"),
        "it counts 10000000 other machines, and a verdict has at most 1000000",
    ),
    "less than no machines": (lambda c: c.update(machines=-1), "and -1 other machines"),
    "a hash that is none": (
        lambda c: c["commands"].update(sha256="0" * 63), "the sha256 of commands is not one"
    ),
    "options of another hash": (
        lambda c: c["options"]["given"].update(feed="1 count/tick"),
        "the sha256 of its options does not match the options in it",
    ),
    "twice": (
        lambda c: c["verdict"]["criteria"].append(
            {**c["verdict"]["criteria"][0], "measured": 0.0, "status": "passed"}
        ),
        "is in it 2 times",
    ),
    "a length below zero": (
        lambda c: first(c, "failed").update(measured=-0.001, status="passed"),
        "contour_error is -0.001, and it cannot be less than 0",
    ),
    "a share below zero": (
        lambda c: named(c, "dac_saturation").update(measured=-0.5, status="passed"),
        "dac_saturation A is -0.5, and it cannot be less than 0",
    ),
    "more than the whole": (
        lambda c: named(c, "dac_saturation").update(measured=1.5, status="failed"),
        "dac_saturation A is 1.5, and it cannot be more than 1",
    ),
    "a peak below zero": (
        lambda c: named(c, "current_peak").update(measured=-1e-6),
        "current_peak A is -1e-06, and it cannot be less than 0",
    ),
    "a number of 400 digits": (
        lambda c: first(c, "failed").update(measured=10**400),
        "contour_error has a number beyond 1e+100",
    ),
    "a limit of 400 digits": (
        lambda c: first(c, "failed").update(limit=10**400, status="passed"),
        "contour_error has a number beyond 1e+100",
    ),
    "what takes many runs": (
        lambda c: named(c, "repeatability").update(measured=0.0, status="passed"),
        "repeatability is measured, which needs 20 runs, and it has 1",
    ),
    "another machine's name": (
        lambda c: c["machine"].update(name="gantry"),
        "its machine is 'gantry', and the hashed one 'lathe-winder'",
    ),
    "another specification's name": (
        lambda c: c["spec"].update(name="tighter"),
        "its specification is 'tighter', and the hashed one 'lathe-winder'",
    ),
    "another kind of commands": (
        lambda c: c["commands"].update(kind="switches"),
        "its kind of commands is 'switches', and the hashed one 'ticks'",
    ),
    "machines beside one": (
        lambda c: c.update(tolerances=OVER), "its level is 'nominal', and it has an entry",
    ),
    "no machines beside it": (
        lambda c: c.update(machines=200, level="over tolerances"),
        "its level is 'over tolerances', and it has no entry 'tolerances'",
    ),
    "fewer machines than it draws": (
        lambda c: over(c, drawn=20, passed=20),
        "it counts 200 other machines, where 20 were drawn",
    ),
    "none searched": (lambda c: over(c, searched=0), "200 were drawn and 0 searched"),
    "more in specification than drawn": (
        lambda c: over(c, passed=201), "201 of 200 drawn machines are in specification",
    ),
    "a larger share of all": (
        lambda c: over(c, at_least=0.999),
        "200 of 200 drawn machines show that at least 0.9851 of all are in specification",
    ),
    "more confidence": (lambda c: over(c, confidence=0.999), "and it says another share"),
    "a worst machine below zero": (
        lambda c: over(c, worst_share=-1.0), "its worst machine uses the share -1 of a limit",
    ),
    "fewer rejects than can be shown": (
        lambda c: [
            c.update(machines=200, level="yield over tolerances"),
            c["verdict"]["criteria"].append(
                {
                    "name": "rejects", "axis": "", "status": "passed", "required": True,
                    "measured": 0.0, "limit": 0.05, "unit": "",
                }
            ),
        ],
        "its rejects are 0, and 200 machines cannot show less than 0.01828",
    ),
    "measured on no simulation": (
        lambda c: c["verdict"].update(simulated=False),
        "were not simulated",
    ),
    "out of specification for no reason": (
        lambda c: [
            one.update(measured=0.0, status="passed")
            for one in c["verdict"]["criteria"]
            if one["status"] == "failed"
        ],
        "says that it did not pass, where no criterion failed",
    ),
}  # fmt: skip


def test_a_proof_that_contradicts_itself_is_refused_by_verify_and_run(shop: Path) -> None:
    """Its hash is right, because a forger can write one. Only the figures count."""
    how = (
        "x-180.prg",
        "-m",
        "lathe-winder",
        "--interpolation",
        "linear",
        "--feed",
        "20 count/tick",
    )
    file = shop / "x.proof.json"
    assert run("prove", *how, "--nominal", "--proof", str(file))[0] == 1
    proof = file.read_text("utf-8")
    for name, (change, message) in FORGED.items():
        content = json.loads(proof)
        change(content)
        write_again(content, file)
        for command in (("verify", str(file)), ("run", *how, "--proof", str(file))):
            status, output = run(*command)
            assert (status, output.count("\n")) == (2, 0), (name, output)
            assert "[PROOF] x.proof.json: it contradicts itself: " in output, (name, output)
            assert message in output, (name, output)
    assert not (shop / "runs").exists()


@pytest.mark.parametrize(
    ("change", "where"),
    [
        (lambda c: c["verdict"].update(incomplete=0), "verdict.incomplete"),
        (lambda c: c["verdict"].update(incomplete=[]), "verdict.incomplete"),
        (lambda c: c.update(tolerances=[]), "tolerances"),
        (lambda c: c.update(tolerances={**OVER, "passed": 199.5}), "tolerances.passed"),
    ],
)
def test_an_entry_of_another_type_is_refused(
    shop: Path, change: Callable[[dict[str, Any]], object], where: str
) -> None:
    file = proved(shop, *WINDER)
    content = json.loads(file.read_text())
    change(content)
    write_again(content, file)
    status, output = run("verify", str(file))
    assert (status, output.count("\n")) == (2, 0)
    assert f"'{where}' is missing, or has the wrong type" in output


def test_an_entry_that_stands_in_it_twice_is_refused(shop: Path) -> None:
    """A program may read the first entry, and a person the second."""
    file = proved(shop, *WINDER)
    text = file.read_text()
    assert text.count('  "passed": true') == 1
    file.write_text(text.replace('  "passed": true', '  "passed": false,\n  "passed": true'))
    status, output = run("verify", str(file))
    assert (status, output.count("\n")) == (2, 0)
    assert "the entry 'passed' occurs twice" in output


def test_a_step_that_is_left_out_of_a_proof_is_missed(shop: Path) -> None:
    """In each step of a move list the frame has to come to rest."""
    file = proved(shop, "--nominal", job="letter-cycle.toml", machine="letter-placer")
    proof = file.read_text()
    names = ("settling_time", "residual_vibration", "end_position_error")
    for name in names:
        content = json.loads(proof)
        criteria = content["verdict"]["criteria"]
        mine = [one for one in criteria if one["name"] == name]
        assert len({one["step"] for one in mine}) > 1
        criteria.remove(mine[-1])
        write_again(content, file)
        status, output = run("verify", str(file))
        assert (status, output.count("\n")) == (2, 0), name
        assert f"it lacks {name}" in output and f"of the step {mine[-1]['step']!r}" in output, (
            output
        )


def test_signature_is_checked_with_the_key(shop: Path) -> None:
    """The signature is an HMAC of the proof without its files' paths, computed independently."""
    (shop / "ours.key").write_text("0123456789abcdef\n")
    (shop / "theirs.key").write_text("0123456789abcdeF\n")
    file = proved(shop, *WINDER, "--sign", "ours.key")
    content = json.loads(file.read_text())
    signed = {k: v for k, v in content.items() if k not in {"sha256", "signature"}}
    for what, places in {
        "job": ["file"],
        "spec": ["file"],
        "machine": ["reference", "par"],
    }.items():
        signed[what] = {k: v for k, v in signed[what].items() if k not in places}
    text = json.dumps(signed, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    expected = hmac.new(b"0123456789abcdef", text.encode(), "sha256").hexdigest()
    assert content["signature"] == {"method": "HMAC-SHA256", "value": expected}

    passed = 0 if content["verdict"]["passed"] else 1
    assert run("verify", str(file), "--key", "ours.key") == (passed, "")
    copy_proof(read_proof(file), shop / "deep.json")  # with other names of the same files
    assert run("verify", "deep.json", "--key", "ours.key") == (passed, "")
    how = ("x-180.prg", "-m", "mine.toml+slow", *WINDER, "--proof", str(file), "--speed", "0")
    over = ["--override", "why"] if passed else []
    assert run("run", *how, "--key", "ours.key", *over)[0] in {0, 1}
    assert list(shop.glob("runs/*/inputs/*")) and not list(shop.glob("runs/*/*/ours.key"))
    status, output = run("verify", str(file), "--key", "theirs.key")
    assert (status, "its signature is not by this key" in output) == (2, True)
    # Possible figures, but not the signed ones.
    criterion = next(c for c in content["verdict"]["criteria"] if c["measured"])
    criterion["measured"] *= 0.999
    write_again(content, file)
    assert run("verify", str(file)) == (passed, "")
    for command in (("verify", str(file)), ("run", *how)):
        status, output = run(*command, "--key", "ours.key")
        assert (status, "it was changed since it was signed" in output) == (2, True), output
    del content["signature"]
    write_again(content, file)
    status, output = run("verify", str(file), "--key", "ours.key")
    assert (status, "it is not signed" in output) == (2, True)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("prove", "x-180.prg", "-m", "mine.toml", "--sign", "ours.key"), "--sign signs or checks"),
        (("run", "x-180.prg", "-m", "mine.toml", "--key", "ours.key"), "--key signs or checks"),
        (("verify", "x.json", "--key", "none.key"), "the key 'none.key' cannot be read"),
        (("verify", "x.json", "--key", "short.key"), "has 3 bytes, not 16 to 65536"),
    ],
)
def test_a_key_that_cannot_be_used_is_one_line(
    shop: Path, words: tuple[str, ...], message: str
) -> None:
    (shop / "ours.key").write_text("0123456789abcdef")
    (shop / "short.key").write_text("abc\n")
    status, output = run(*words)
    assert (status, output.count("\n"), message in output) == (2, 0, True), output
