"""``import threadline as tl``: its content, its page, and the cost of its import."""

from __future__ import annotations

import doctest
import inspect
import json
import math
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

import threadline as tl
from tests.test_limits_alone import files as limits_alone
from threadline import face
from threadline.cli.fastest import OUTPUTS
from threadline.cli.main import main
from threadline.errors import InputError, OptionError
from threadline.jobs.operations import Pace
from threadline.motion.path.interpolations import OPTIMAL
from threadline.proof.pipeline import Trials
from threadline.search.by_pace import SEARCHES
from threadline.search.question import PACE_OPTIONS
from threadline.verdict import load_spec

pytestmark = pytest.mark.usefixtures("coarse_search")

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "api.md"


def test_every_pace_of_a_job_has_its_search() -> None:
    assert set(SEARCHES) == set(OUTPUTS) == set(PACE_OPTIONS) == {*get_args(Pace), OPTIMAL}


def test_the_page_lists_the_face_and_nothing_else() -> None:
    listed = re.findall(r"^\| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), re.M)
    assert listed == tl.__all__ == face.__all__
    assert set(tl.__all__) < set(dir(tl))
    for name in tl.__all__:
        assert getattr(tl, name) is getattr(face, name)
        assert getattr(tl, name).__doc__
    stub = (Path(tl.__file__).parent / "__init__.pyi").read_text(encoding="utf-8")
    plain = re.findall(r"^from threadline\.face import (\w+) as \1$", stub, re.M)
    assert sorted([*plain, *re.findall(r"^def (\w+)\(", stub, re.M)]) == tl.__all__
    with pytest.raises(AttributeError, match="has no attribute 'prof'"):
        tl.prof  # noqa: B018


@pytest.mark.long(shown_by="test_every_kind_of_machine_has_the_whole_face")
def test_the_examples_of_the_page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They run in a folder that holds the examples, and write their files there."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    found = doctest.testfile(str(PAGE), module_relative=False, encoding="utf-8")
    assert found.attempted > 10
    assert found.failed == 0
    assert (tmp_path / "x.proof.json").is_file()


def test_importing_it_imports_nothing_heavy() -> None:
    code = "import sys, threadline; print(sorted({m.split('.')[0] for m in sys.modules}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "threadline" in done.stdout
    for heavy in ("numpy", "scipy", "numba", "matplotlib", "pydantic", "typer"):
        assert f"'{heavy}'" not in done.stdout


def test_mistakes_are_told_as_on_the_command_line() -> None:
    example = ROOT / "examples" / "x-180.prg"
    with pytest.raises(OptionError, match=r"unknown option 'interpolaton'\. Did you mean"):
        tl.prove(example, "lathe-winder", interpolaton="linear")
    with pytest.raises(OptionError, match="repeats must be at least 1"):
        tl.prove(example, "lathe-winder", repeats=0)
    with pytest.raises(OptionError, match="there is no recording to judge"):
        tl.judge([])
    with pytest.raises(OptionError, match="no interpolation to compare"):
        tl.compare(example, "lathe-winder", [])
    with pytest.raises(InputError, match="is for another kind of machine"):
        tl.compile(example, "lathe-winder", "st", "x.st")
    with pytest.raises(OptionError, match="needs feed-forward"):
        tl.prove(example, "lathe-winder", smoothing="40 ms")


def test_errors_speak_of_arguments() -> None:
    """No message of the face contains an option of the command line."""
    example = ROOT / "examples" / "x-180.prg"
    wrong = [
        ({"smoothing": "40 ms"}, "Give feed_forward=True too"),
        ({"interpolation": "optimal", "low": "1 m/s"}, "low='1 m/s' does not apply"),
        ({"low": "5 m/s", "high": "1 m/s"}, "Give a low= below high="),
    ]
    for words, message in wrong:
        with pytest.raises(OptionError, match=re.escape(message)) as caught:
            tl.fastest(example, "lathe-winder", level="nominal", **words)  # type: ignore[arg-type]
        assert "--" not in str(caught.value) and "--" not in repr(caught.value)


def test_the_best_is_proved_in_one_call(tmp_path: Path) -> None:
    """The proof uses the words of the search, unless others are given."""
    machine, job = limits_alone(tmp_path, "G1 X20 A90 F1000\nG1 X0")
    found = tl.fastest(job, machine, level="nominal", radius="A=40 mm")
    proof = found.prove()
    assert proof.passed and proof.plan.options["radius"] == "A=40 mm"
    shown = repr(found).splitlines()  # and not every trial
    assert shown[0].startswith(f"fastest: {found.of.best.duration_s:.6g} s at 0.")
    assert shown[0].endswith("limited by the velocity limits of the axes")
    capped = tl.fastest(job, machine, level="nominal", radius="A=40 mm", high="F 2000")
    assert repr(capped).splitlines()[0].endswith("limited by the end of the search")
    assert found.best_options is not None
    assert len(shown) == 2 and str(found.best_options["feed"]) in shown[1]
    again = tl.prove(job, machine, level="nominal", **found.best_options)
    assert again.json()["criteria"] == proof.json()["criteria"]
    assert proof.plan.duration_s == found.of.best.duration_s
    slow = found.prove(feed="F 60")
    assert slow.plan.duration_s > 2.0 * proof.plan.duration_s
    with pytest.raises(OptionError, match="so there is no best plan to prove"):
        replace(found, best=None, best_options=None).prove()


def test_a_recording_is_judged_by_machines_that_are_loaded(tmp_path: Path) -> None:
    """As by their names: the machine of the plan, and the one that ran it."""
    job, file = ROOT / "examples" / "x-180.prg", tmp_path / "own.toml"
    file.write_text('base = "lathe-winder"\nname = "own"\ntitle = "own"\n', encoding="utf-8")
    machine, heavy = tl.load_machine(file), tl.load_machine("lathe-winder+physical")
    recorded = tl.prove(job, machine, level="nominal", actual=heavy).record(tmp_path / "x.npz")
    expected = tl.judge(recorded.path).verdict.results
    found = tl.judge([recorded.path], machine=machine, actual=heavy)
    assert found.plan.machine is machine
    assert found.verdict.results == expected
    assert tl.judge(recorded.path, machine=file).verdict.results == expected
    with pytest.raises(OptionError, match="was recorded on another machine"):
        tl.judge(recorded.path, machine=machine, actual=machine)


def test_a_run_has_columns_for_plots() -> None:
    """The columns of the recording, with units and of equal length, as a data frame needs them."""
    proof = tl.prove(ROOT / "examples" / "x-180.prg", "lathe-winder", repeats=2)
    first, second = proof.columns(), proof.columns(run=2)
    times_s, load = proof.of.run(1).samples("X.load")
    assert next(iter(first)) == "time [s]"
    assert {len(one) for one in first.values()} == {len(times_s)}
    np.testing.assert_array_equal(first["X.load [m]"], load)
    np.testing.assert_array_equal(first["time [s]"], times_s)
    assert (first["X.load [m]"] != second["X.load [m]"]).any()
    with pytest.raises(OptionError, match="run=3 is none of the 2 judged"):
        proof.columns(3)


KINDS = {
    "motors": ("x-180.prg", "lathe-winder", "csv"),
    "needle": ("strap.seam.toml", "stitcher-rigid", "ticks"),
    "cylinders": ("letter-cycle.toml", "letter-placer", "st"),
    "step tables": ("rosette.dst", "table-embroiderer", "steps"),
    "steppers": ("helix.gcode", "stepper-winder", "grbl"),
    "limits alone": ("job.gcode", "limits.toml", "grbl"),
}
"""A job, a machine and a target for every kind of machine."""


def _of_kind(kind: str, folder: Path) -> tuple[Path, str, str]:
    file, machine, target = KINDS[kind]
    if kind != "limits alone":
        return ROOT / "examples" / file, machine, target
    limits, job = limits_alone(folder, "G1 X20 A90 F1000\nG1 X0")
    return job, str(limits), target


@pytest.mark.long(only="needle")
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_machine_has_the_whole_face(kind: str, tmp_path: Path) -> None:
    """A proof, its files, a judgement of its recording by file and by job, a program, a comparison.

    The judgement of the file equals the proof's judgement of the run.
    """
    job, name, target = _of_kind(kind, tmp_path)
    machine = tl.load_machine(name)
    proof = tl.prove(job, machine, level="nominal")
    assert proof.json()["machine"] == machine.name and proof.verdict.results
    assert tl.prove(job, name, repeats=2).verdict.runs == (1 if machine.without_dynamics else 2)
    recorded = proof.record(tmp_path / "run.npz").path
    for answer in (
        tl.judge(recorded),
        tl.judge(recorded, job=job, machine=name),
        tl.judge(recorded, job=job, machine=machine),
    ):
        assert answer.passed == proof.passed
        assert [r.status for r in answer.verdict.results] == [
            r.status for r in proof.verdict.results
        ]
    assert proof.write(tmp_path / "x.proof.json").path.is_file()
    assert tl.compile(job, machine, target, tmp_path / f"new/{kind}.{target}")[0].path.is_file()
    with pytest.raises(InputError, match="unknown target 'nonsense'"):
        tl.compile(job, machine, "nonsense", tmp_path / "x")
    (own,) = tl.compare(job, machine, level="nominal").proofs
    assert own.verdict.results == proof.verdict.results
    with pytest.raises(InputError):
        tl.prove(job, machine, tolerance="1 kg")


def test_the_search_is_chosen_by_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each kind of job has its own search, with the given machine and margin."""
    from threadline.search import by_pace

    asked = []

    def noted(name: str):
        def searched(question):
            asked.append((name, question.machine.name, question.spec))
            raise KeyError(name)

        return searched

    monkeypatch.setattr(by_pace, "fastest_job", noted("feed"))
    monkeypatch.setattr(by_pace, "fastest_needle", noted("needle"))
    monkeypatch.setattr(by_pace, "fastest_cycle", noted("cycle"))
    monkeypatch.setattr(by_pace, "fastest_shaft", noted("shaft"))
    for job, machine, name in (
        ("x-180.prg", "lathe-winder", "feed"),
        ("stitcher-test-path.seam.toml", "stitcher", "needle"),
        ("letter-cycle.toml", "letter-placer", "cycle"),
        ("rosette.dst", "schiffli-frame", "shaft"),
        ("helix.gcode", "stepper-winder", "feed"),
    ):
        with pytest.raises(KeyError, match=name):
            tl.fastest(ROOT / "examples" / job, machine, margin="20 %")
    whole = [load_spec(None, tl.load_machine(machine)) for _, machine, _ in asked]
    assert [spec for _, _, spec in asked] == [spec.with_margin(0.2) for spec in whole]


def test_ends_of_tolerances_are_judged_as_on_the_command_line() -> None:
    """At 39.4 mm/s the machine of the file is in spec, and a machine with other loads is not."""
    job = ROOT / "examples" / "x-180.prg"
    words = {"interpolation": "linear", "feed": "39.4 mm/s", "level": "nominal"}
    assert tl.prove(job, "lathe-winder", **words).passed
    proof = tl.prove(job, "lathe-winder", **words, ends="100 %")
    assert not proof.passed and proof.verdict.ends == 2
    assert "loads" in proof.result("contour_error").note
    with pytest.raises(OptionError, match=r"ends '0 %' must be above 0 %"):
        tl.prove(job, "lathe-winder", ends="0 %")


@pytest.mark.parametrize(
    ("job", "machine", "search", "words", "planned"),
    [
        ("x-180.prg", "lathe-winder", "fastest_job", {}, None),
        ("x-180.prg", "lathe-winder", "fastest_job", {"interpolation": "optimal"}, None),
        ("stitcher-robust.seam.toml", "stitcher", "fastest_needle", {"feed_forward": True}, 1.0),
        ("rosette.dst", "schiffli-frame", "fastest_shaft", {}, 1.0),
    ],
)
def test_a_search_is_asked_to_hold_at_the_ends_of_tolerances(
    job: str, machine: str, search: str, words: dict[str, object], planned: float | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """The search gets the same as from the command line; tests of the twin test the judgement."""
    from threadline.search import by_pace

    given = []

    def noted(asked):
        given.append((asked.options.robust_share, asked.trials))
        raise KeyError(search)

    monkeypatch.setattr(by_pace, search, noted)
    with pytest.raises(KeyError, match=search):
        tl.fastest(ROOT / "examples" / job, machine, level="nominal", robust="100 %", **words)
    assert given == [(planned, Trials(ends=1.0))]


def test_a_search_of_commands_and_waits_has_no_ends_of_loads() -> None:
    with pytest.raises(OptionError, match=r"robust='100 %' does not apply to letter-cycle"):
        tl.fastest(ROOT / "examples" / "letter-cycle.toml", "letter-placer", robust="100 %")


LOOSE: Any = tl
"""The package as somebody calls it who has no checker of types."""


prove_x = partial(LOOSE.prove, "x.prg", "lathe-winder")
compare_x = partial(LOOSE.compare, "x.prg", "lathe-winder")


def wrong_types() -> list[object]:
    """Return values that no argument of the face accepts."""
    return [
        -1, 10**400, 1.5, math.nan, b"x", 1j, {"a": 1}, object(), len, np.zeros(3), [1], (1, 2),
        "\0", "\udc80", Path("\0"), ["\0"],
    ]  # fmt: skip


def test_no_argument_of_a_wrong_type_ends_in_an_error_of_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every function, argument and odd value ends in an InputError of one line."""
    monkeypatch.chdir(tmp_path)
    job, machine = ROOT / "examples" / "x-180.prg", "lathe-winder"
    proof = tl.prove(job, machine, level="nominal", interpolation="linear", feed="10 count/tick")
    proof.record("good.npz")
    calls: dict[Callable[..., object], dict[str, Any]] = {
        tl.load_machine: {"machine": machine},
        tl.prove: {"job": job, "machine": machine},
        tl.run: {"job": job, "machine": machine, "speed": 0, "level": "nominal"},
        tl.fastest: {"job": job, "machine": machine},
        tl.compare: {"job": job, "machine": machine},
        tl.yields: {"job": job, "machine": machine, "variants": 4},
        tl.design: {"job": job, "machine": machine},
        tl.judge: {"recordings": "good.npz"},
        tl.learn: {"job": job, "machine": machine},
        tl.compile: {"job": job, "machine": machine, "target": "csv", "out": "out.csv"},
        tl.control: {"machine": machine, "design": "cross-coupled", "out": "out.toml"},
        tl.equal: {"job": job, "machine": machine},
        tl.shaper: {"text": "zv:10Hz"},
        tl.analyse: {"machine": machine, "axis": "X"},
        tl.measure: {"machine": machine, "axis": "X"},
        tl.fit: {"data": "good.npz", "machine": machine, "numbers": ["bodies.x.inertia"]},
        tl.trim: {"machine": machine, "axis": "X"},
        tl.tune: {"machine": machine, "axis": "X"},
        tl.wind: {"job": str(ROOT / "examples" / "vessel.wind.toml")},
        proof.report: {"folder": "out"},
        proof.write: {"file": "out.json"},
        proof.record: {"file": "out.npz"},
    }
    assert {call.__name__ for call in calls} >= {*tl.__all__} - {"retime"}
    tried = 0
    for call, right in calls.items():
        names = list(inspect.signature(call).parameters)
        assert "words" not in names
        for name in names:
            for value in wrong_types():
                if (call, name) == (tl.run, "speed") and isinstance(value, float) and value > 0.0:
                    continue  # a speed
                tried += 1
                with pytest.raises(InputError) as caught:
                    call(**{**right, name: value})
                assert "\n" not in str(caught.value), (call, name, value)
    assert tried > 1000
    assert sorted(file.name for file in tmp_path.iterdir()) == ["good.npz"]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (LOOSE.shaper, r"shaper: missing .* 'text'\. It is shaper\(text\)"),
        (lambda: LOOSE.shaper("zv:10Hz", 1), "shaper: too many positional arguments"),
        (lambda: prove_x(1), "prove: too many positional arguments"),
        (
            lambda: prove_x(repeats=10**9),
            "repeats must be at most 1000, got 10",
        ),
        (
            lambda: prove_x(repeats=True),
            "repeats is True, of type bool",
        ),
        (
            lambda: prove_x(feed=5),
            r"feed is 5, of type int\. Give a text or None",
        ),
        (lambda: prove_x(feed_forward="yes"), "Give True or False"),
        (
            lambda: compare_x(["linear", 3]),
            "Give a list, each item a text",
        ),
        (lambda: LOOSE.retime([[0, 0], [1, 0]], 10**400, 1), "velocity is 1000.*one number"),
        (lambda: LOOSE.retime([[0, 0], [10**400, 0]], 1, 1), "points are not an array of numbers"),
        (lambda: LOOSE.retime([[0, 0], [1, 0]], 1, 1, tolerance=10**400), "tolerance is 1000"),
    ],
)
def test_wrong_call_is_refused_with_the_reason(call: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()


def test_files_that_cannot_be_used_are_wrong_input(tmp_path: Path) -> None:
    proof = tl.prove(
        ROOT / "examples" / "x-180.prg", "lathe-winder", level="nominal", interpolation="linear"
    )
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="it is a file, not a folder"):
        proof.report(tmp_path / "file")
    with pytest.raises(InputError, match=r"cannot use .*file"):
        proof.report(tmp_path / "file" / "below")
    with pytest.raises(InputError, match="is a folder"):
        proof.write(tmp_path)
    assert (tmp_path / "file").read_text() == ""


def test_a_proof_prints_itself_in_ten_lines_worst_first(tmp_path: Path) -> None:
    job = tmp_path / "<i>.prg"  # text in a notebook is escaped
    job.write_text((ROOT / "examples" / "x-180.prg").read_text("utf-8"), "utf-8")
    spec = tmp_path / "tight.spec.toml"
    spec.write_text(
        'name = "tight"\n\n[[criteria]]\nname = "tracking_error"\n\n'
        '[[criteria]]\nname = "contour_error"\nlimit = "0.1 mm"\n',
        "utf-8",
    )
    proof = tl.prove(job, "lathe-winder", interpolation="linear", spec=spec, level="nominal")
    lines = str(proof).splitlines()
    assert len(lines) <= 10
    assert re.match(r"<i>\.prg on lathe-winder, 10.01 s: OUT OF SPEC \(nominal: 1 run; ", lines[0])
    assert re.search(r"contour_error +0\.4633 mm +limit 0\.1 mm +failed, line 12$", lines[1])
    assert repr(proof) == str(proof)
    shown = proof._repr_html_()
    assert "<i>" not in shown and "&lt;i&gt;.prg" in shown
    assert shown.index("<td>contour_error</td>") < shown.index("<td>tracking_error</td>")


def test_the_analysis_of_a_loop_is_that_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    """The content is the same for one named axis, and for all axes without a name."""
    with pytest.raises(SystemExit):
        main(["analyse", "lathe-winder", "--json"])
    printed = json.loads(capsys.readouterr().out)["axes"]
    found = tl.analyse("lathe-winder")
    assert list(found) == list(printed) and len(found) > 1
    assert {k: json.loads(json.dumps(one.as_json())) for k, one in found.items()} == printed
    assert list(tl.analyse("lathe-winder", "X")) == ["X"]
    with pytest.raises(OptionError, match=r"has no axis 'Q'"):
        tl.analyse("lathe-winder", "Q")
