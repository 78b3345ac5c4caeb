"""Every verb takes every option that applies to it, in Python and in a shell alike."""

from __future__ import annotations

import importlib
import inspect
import re
import shutil
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields, replace
from math import isinf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tools.options_reference import files

import threadline as tl
from tests.jobs.embroidery.test_designs import long_stitch
from threadline import face
from threadline.cli.main import app
from threadline.commands.learned import with_offsets
from threadline.commands.plan import Plan
from threadline.errors import InputError, OptionError
from threadline.files import tick_table
from threadline.files.formats.tick_table import write_table_npz
from threadline.machine import Machine, load_machine
from threadline.machine.radii import with_radii
from threadline.proof import pipeline
from threadline.proof.option_form import Door, Group, Option, Type
from threadline.proof.option_table import (
    PLANNERS,
    PYTHON_VERBS,
    RECORDED,
    TABLE,
    option,
    options_for,
    python_name,
)
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job
from threadline.proof.proof_hash import spec_sha256
from threadline.proof.python_arguments import as_arguments
from threadline.search.deadline import Deadline
from threadline.search.paced import Question
from threadline.verdict import Spec

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
WORK = {
    "ticks": ("a.gcode", "stepper-winder"),
    "loops": ("a.prg", "lathe-winder"),
    "seam": ("a.seam.toml", "stitcher-rigid"),
    "switches": ("letter-cycle.toml", "letter-placer"),
    "steps": ("a.dst", "schiffli-frame"),
}
"""By kind of work: a job and a machine; of axes a part program with steppers and with loops, and a
seam."""
GIVEN: dict[str, Any] = {
    "interpolation": "linear", "law": "cycloidal", "feed": "36 mm/s", "dialect": "grbl",
    "feed-mode": "linuxcnc", "radius": "A=40 mm", "offset": "X=12 mm", "needle": "20 stitch/s",
    "tolerance": "0.05 mm", "limits": "90 %", "shaper": "zv:12Hz:0.02", "mode": "3 Hz",
    "damping": "0.1", "feed-forward": True, "smoothing": "50 ms", "robust": "100 %",
    "contour": "0.45 mm", "outside": "0.05 mm", "reserve": "volts 1 %, current 3 %",
    "narrow": "1: 0.05 mm, 2: 0.06 mm",
    "axes": "A=X,X=A", "product": "vessel.wind.toml", "long-stitches": "split",
    "table": "learned.npz",
}  # fmt: skip
"""A value for each planning option; files are in the folder of the jobs."""
WITH: dict[str, dict[str, Any]] = {
    "smoothing": {"feed-forward": True}, "robust": {"feed-forward": True},
    "contour": {"interpolation": "optimal"}, "outside": {"interpolation": "optimal"},
    "reserve": {"interpolation": "optimal"}, "narrow": {"interpolation": "optimal"},
    "mode": {"shaper": "zv"}, "damping": {"shaper": "zv"},
}  # fmt: skip
"""What some of them need beside them."""
LINE_VERBS = tuple(verb for verb in PLANNERS if verb != "panel")
SEARCHED = {"fastest": {"shaper", "robust"}, "design": {"feed-forward", "smoothing", "robust"}}
"""Options that mean something else to a verb: a share of machines to judge, times to try."""


class StoppedError(Exception):
    """Raised in place of the work of a verb."""

    asked: tuple[Any, ...]


class PlannedError(StoppedError):
    """Raised where a verb has planned its job, with its plan and what it planned from."""

    def __init__(self, job: Any, machine: Any, options: Options) -> None:
        super().__init__("planned")
        options = options.on(machine)
        moves = [repr(one) for one in job]
        about = [repr(getattr(job, one.name)) for one in fields(job) if one.name != "operations"]
        axes = {name: (axis.radius, axis.profile) for name, axis in machine.axes.items()}
        asked = (options, moves, axes, machine.name)
        of_plan = repr((asked, about, machine.sha256, machine.parameters))
        if of_plan not in _PLANS:
            plan = PLAN_JOB(job, machine, options)
            _PLANS[of_plan] = (plan.commands.rows_sha256(), plan.duration_s, dict(plan.options))
        self.asked = (*asked, *_PLANS[of_plan])


PLAN_JOB = pipeline.plan_job
_PLANS: dict[str, tuple[str, float, dict[str, str]]] = {}
"""Rows, duration and options of a plan by everything that it is made from: each is made once."""


def planned(job: Any, machine: Any, options: Options, *_: Any, **__: Any) -> None:
    raise PlannedError(job, machine, options)


def seen(job: Any, machine: Any, options: Options, *_: Any, **__: Any) -> None:
    """Stand-in for ``plan_job``, which gives the machine the radii of the options."""
    planned(job, with_radii(machine, options.radius), options)


CRITERIA = {
    "loops": ("contour_error", "9 mm"), "switches": ("cycle_time", "9 s"),
    "steps": ("stitch_residual", "9 mm"),
}  # fmt: skip
"""By kind of work: a criterion that its specification can have."""


@pytest.fixture(scope="module")
def jobs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with small jobs of each kind, and the files that their options name."""
    folder = tmp_path_factory.mktemp("doors")
    (folder / "a.prg").write_text("G91 G1 X5 A10 F600\nX-5\nM30\n")
    (folder / "a.gcode").write_text("G21 G91\nG1 X5 A10 F600\nX-5\nM2\n")
    (folder / "a.seam.toml").write_text(
        '[stitching]\nstitch_length = "0.1 in"\nneedle_speed = "60 stitch/s"\n[[contour]]\n'
        'unit = "mm"\npoints = [[0, 0], [7.62, 0], [7.62, 7.62]]\n'
    )
    long_stitch(folder, "dst", 224, 100)
    shutil.copy(EXAMPLES / "letter-cycle.toml", folder)
    shutil.copy(EXAMPLES / "vessel.wind.toml", folder)
    (folder / "trace.csv").write_text("time [s];X.load [m]\n0;0\n0.1;0\n0.2;0\n")
    (folder / "FW-CNC.PAR").write_text(
        "a\nb\nc\n20 ; manual\n11 ; normal\n30 ; limit\n20 ; record\n4 ; knots\n"
    )
    for work, (name, limit) in CRITERIA.items():
        (folder / f"{work}.spec.toml").write_text(
            f'name = "own"\n[[criteria]]\nname = "{name}"\nlimit = "{limit}"\n'
        )
    machine, options = load_machine("lathe-winder"), Options()
    base = tick_table(pipeline.plan_job(open_job(folder / "a.prg", machine, options), machine,
                                        options).commands)  # fmt: skip
    offset = np.zeros((base.tick_count() + 1, len(base.axes)), dtype=np.int64)
    offset[5:9, 0] = 1
    write_table_npz(with_offsets(base, offset), folder / "learned.npz")
    return folder


@pytest.fixture
def stopped(monkeypatch: pytest.MonkeyPatch, jobs: Path) -> Path:
    """Stop every verb where it has planned its job; return the folder with the jobs."""
    from threadline.cli import compile_, design, equal_, run_
    from threadline.panel import programs
    from threadline.proof import recorded
    from threadline.search import by_pace, learned_job, machine_yield

    compared = importlib.import_module("threadline.search.compare")  # its function has another name
    for module in (pipeline, recorded, compile_, equal_, run_, machine_yield, compared, learned_job,
                   programs):  # fmt: skip
        monkeypatch.setattr(module, "plan_job", seen)
    searched = lambda asked: planned(asked.job, asked.machine, asked.options)  # noqa: E731
    for pace, search in by_pace.SEARCHES.items():
        monkeypatch.setitem(by_pace.SEARCHES, pace, replace(search, find=searched))

    def designed(file: Path, machine: Any, spec: Any, options: Options, *_: Any) -> None:
        seen(open_job(file, machine, options), machine, options)

    monkeypatch.setattr(design, "search_design", designed)
    monkeypatch.setattr("threadline.search.design.design", designed)
    return jobs


def outcome(ask: Callable[[], object]) -> tuple[Any, ...] | str:
    """Return what a verb was about to do, or its refusal in the words of Python."""
    _BEFORE.clear()
    try:
        ask()
    except StoppedError as reached:
        return reached.asked
    except InputError as error:
        return as_arguments(str(error))
    raise AssertionError("neither planned nor refused")


def by_line(verb: str, folder: Path, work: str, words: dict[str, Any]) -> tuple[Any, ...] | str:
    file, machine = WORK[work]
    typed = [
        part
        for name, value in words.items()
        for part in (f"--{name}", *([] if value is True else [str(value)]))
    ]
    job = folder / file
    target = {"switches": "st", "steps": "steps"}.get(work, "csv")
    more = {
        "compile": ["--target", target, "-o", str(folder / "out")],
        "compare": ["--no-fastest"],
        "run": ["--speed", "0", "--store", str(folder / "runs"), "--pass-stops"],
        "animate": ["-o", str(folder / "a.html")],
    }.get(verb, [])
    if verb == "compare" and "interpolation" not in words:
        more += ["--interpolation", "auto"]
    if verb == "compare" and "shaper" not in words:
        more += ["--shaper", "none"]
    of = [str(folder / "trace.csv"), "--job", str(job)] if verb == "judge" else [str(job)]
    line = [verb, *of, "-m", machine, *typed, *more]
    return outcome(lambda: app(args=line, standalone_mode=False))


def by_python(verb: str, folder: Path, work: str, words: dict[str, Any]) -> tuple[Any, ...] | str:
    file, machine = WORK[work]
    job = folder / file
    given = {option(name).word: value for name, value in words.items()}
    if verb == "compare":
        lists = {"interpolation": "interpolations", "feed": "feeds", "shaper": "shapers"}
        given = {lists.get(word, word): [value] if word in lists else value
                 for word, value in given.items()}  # fmt: skip
        found = outcome(lambda: tl.compare(job, machine, **given))
        # Its refusals name the lists that it takes, and the other verbs' one value.
        return re.sub(r"\b(interpolation|feed|shaper)s=(?:\[([^]]*)\])?", r"\1=\2", found) if (
            isinstance(found, str)) else found  # fmt: skip
    if verb == "judge":
        return outcome(lambda: tl.judge(folder / "trace.csv", job=job, machine=machine, **given))
    target = {"switches": "st", "steps": "steps"}.get(work, "csv")
    more = [target, folder / "out"] if verb == "compile" else []
    return outcome(lambda: getattr(tl, python_name(verb))(job, machine, *more, **given))


PLANNING = [one for one in TABLE if one.group is Group.PLAN]


FILES = ("product", "table")
OF_KIND = {
    ("steps", "feed"): "100 stitch/min", ("switches", "shaper"): "um-zv", ("seam", "robust"): "0 %",
}  # fmt: skip
"""Another value for a kind of work."""


def given_to(one: Option, work: str, folder: Path) -> dict[str, Any]:
    value = OF_KIND.get((work, one.name), GIVEN[one.name])
    if one.name in FILES:
        value = str(folder / value)
    beside = {} if (work, one.name) == ("steps", "robust") else dict(WITH.get(one.name, {}))
    if work == "switches" and "shaper" in beside:
        beside["shaper"] = "um-zv"
    return {**beside, one.name: value}


def by_panel(folder: Path, work: str, words: dict[str, Any]) -> tuple[Any, ...] | str:
    from threadline.panel.programs import planned as planned_by_panel
    from threadline.panel.protocol import Calculate

    file, machine = WORK[work]
    given = {name.replace("-", "_"): value for name, value in words.items()}
    asked = Calculate(what="calculate", program=Path(file).name, **given).model_dump()
    return outcome(lambda: planned_by_panel(folder, asked, load_machine(machine)))


def test_every_planning_option_is_walked() -> None:
    assert set(GIVEN) == {one.name for one in PLANNING}


SAME_COMMANDS = {"product"}
"""Options that change what is judged, and no command."""


@pytest.mark.long(but="ticks")
@pytest.mark.parametrize("work", WORK)
def test_every_verb_plans_alike_by_every_door(stopped: Path, work: str) -> None:
    """Verb by option by kind: the same plan of the same job, or one refusal.

    A plan is compared by its rows, its duration and its options.
    """
    kind = "ticks" if work in {"loops", "seam"} else work
    plain = by_python("prove", stopped, work, {})
    answered_count = effective = 0
    for one in PLANNING:
        words = given_to(one, work, stopped)
        expected = by_python("prove", stopped, work, words)
        if kind not in one.kinds:
            assert isinstance(expected, str), one.name
        elif not isinstance(expected, str):
            assert (expected[4] != plain[4]) is (one.name not in SAME_COMMANDS), one.name
            effective += 1
        for verb in LINE_VERBS:
            if verb not in one.verbs or one.name in SEARCHED.get(verb, ()):
                continue
            if any(name not in {o.name for o in options_for(verb)} for name in words):
                continue
            found = by_line(verb, stopped, work, words)
            if verb in PYTHON_VERBS:
                assert by_python(verb, stopped, work, words) == found, (verb, one.name)
            if verb == "learn" and isinstance(found, str):
                continue  # a machine without loops, or a needle that is timed for a lag
            assert found == expected, (verb, one.name)
            answered_count += not isinstance(found, str)
        if "panel" in one.verbs and Door.PANEL in one.doors:
            assert by_panel(stopped, work, words) == expected, one.name
    assert answered_count > 5
    assert effective == EFFECTIVE[work]


EFFECTIVE = {"ticks": 15, "loops": 19, "seam": 14, "switches": 3, "steps": 5}
"""Number of options that change the plan of each kind of work, or its judgement."""


_BEFORE: list[Any] = []
"""What a verb asked for before it stopped: the machine of its link, the address of a cluster."""


class JudgedError(StoppedError):
    """Raised where a verb would judge, search or write, with its request."""


def fingerprint(value: Any) -> Any:
    """Return a part of a request in a form that can be compared."""
    match value:
        case None:
            return None
        case Plan():
            return value.commands.rows_sha256(), fingerprint(value.machine), dict(value.options)
        case Machine():
            return value.name, value.sha256, value.parameters
        case Spec():
            return spec_sha256(value)
        case Deadline():
            return None if isinf(value.end_s) else round(value.end_s - time.monotonic(), -1)
        case Question():
            left = {"progress", "job", "words"}
            return {
                one.name: fingerprint(getattr(value, one.name))
                for one in fields(value)
                if one.name not in left
            }
    return repr(value)


@pytest.fixture
def unjudged(monkeypatch: pytest.MonkeyPatch, jobs: Path) -> Path:
    """Stop every verb after its plan, where it would judge; return the folder with the jobs."""
    from threadline.base import cluster
    from threadline.cli import compile_, design, equal_, run_
    from threadline.live import links
    from threadline.proof import recorded
    from threadline.readback import equal
    from threadline.search import by_pace, learned_job, machine_yield

    compared = importlib.import_module("threadline.search.compare")

    def stop(*parts: Any, **more: Any) -> None:
        more.pop("progress", None)
        error = JudgedError("judged")
        listed = [*parts, *more.values(), *_BEFORE]
        error.asked = tuple(fingerprint(one) for one in listed if one is not None)
        raise error

    def prove(plan: Plan, spec: Spec, _progress: object = None, *parts: Any, **more: Any) -> None:
        trials = more.pop("trials", parts[0] if parts else None)
        stop(plan, spec, trials, *parts[1:], **more)

    def linked(_link: str, _machine: Machine, *_: Any, actual: Machine | None, **__: Any) -> Any:
        _BEFORE.append(actual)
        return SimpleNamespace(close=lambda: None)

    def connected(address: str, _tell: object) -> AbstractContextManager[None]:
        _BEFORE.append(address)
        return nullcontext()

    for module in (pipeline, run_, compared):
        monkeypatch.setattr(module, "prove_plan", prove)
    for module in (links, run_):
        monkeypatch.setattr(module, "link_of", linked)
    for module in (pipeline, compile_):
        monkeypatch.setattr(module, "write", lambda plan, *_, **__: stop(plan))
    for module in (equal, equal_):
        monkeypatch.setattr(module, "equal_targets", lambda plan, *_: stop(plan))
    for pace, search in by_pace.SEARCHES.items():
        monkeypatch.setitem(by_pace.SEARCHES, pace, replace(search, find=stop))
    monkeypatch.setattr(machine_yield, "MachineYield", stop)
    monkeypatch.setattr(recorded, "refuse_other_files", lambda *one: _BEFORE.append(one[-1]))
    monkeypatch.setattr(recorded, "judge", lambda _, *parts: stop(*parts))
    monkeypatch.setattr(learned_job, "Learner", lambda plan, _: plan)
    monkeypatch.setattr(learned_job, "learn", stop)
    monkeypatch.setattr(cluster, "on_cluster", connected)

    def designed(file: Path, machine: Machine, spec: Spec, options: Options, expected: Any,
                 *_: Any) -> None:  # fmt: skip
        stop(machine, spec, options, expected)

    monkeypatch.setattr(design, "search_design", designed)
    monkeypatch.setattr("threadline.search.design.design", designed)
    return jobs


OTHER = {
    "loops": "lathe-winder+stiction", "switches": "letter-placer+own-damping",
    "steps": "schiffli-frame+ten-yards",
}  # fmt: skip
"""By kind of work: a machine that runs what is planned for another one."""


def requests(work: str, folder: Path) -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """Return words of the command line and of Python for each option that changes no plan."""
    low, high = ("60 stitch/min", "90 stitch/min") if work == "steps" else ("20 mm/s", "50 mm/s")
    alike = {
        "spec": str(folder / f"{work}.spec.toml"), "par": str(folder / "FW-CNC.PAR"),
        "actual": OTHER[work], "repeats": 3, "yield": "90 %", "ends": "50 %", "band": "10 %",
        "margin": "20 %", "low": low, "high": high, "learned": 2, "mismatch": True,
        "within": "5 min",
    }  # fmt: skip
    many: tuple[dict[str, Any], dict[str, Any]] = (
        {"tolerances": True}, {"level": "over tolerances"},
    )  # fmt: skip
    return {name: ({name: value}, {name: value}) for name, value in alike.items()} | {
        "nominal": ({"nominal": True}, {"level": "nominal"}),
        "tolerances": many,
        "cluster": ({**many[0], "cluster": "localhost:9"}, {**many[1], "cluster": "localhost:9"}),
    }


def test_every_option_of_the_level_and_of_searches_is_walked(jobs: Path) -> None:
    """``level`` is the flags of the command line in one."""
    others = {one.name for one in TABLE if one.group is not Group.PLAN}
    assert set(requests("loops", jobs)) == others - {"level"}


@pytest.mark.long(but="loops")
@pytest.mark.parametrize("work", OTHER)
def test_every_verb_asks_alike_by_both_doors(unjudged: Path, work: str) -> None:
    """Verb by option by kind: the same request to judge or search, or the same refusal.

    A request has the plan, its machine, the specification, and everything that is asked for.
    """
    refused: dict[str, set[str]] = {}
    for verb in LINE_VERBS:
        plain = by_line(verb, unjudged, work, {})
        if verb in PYTHON_VERBS:
            assert by_python(verb, unjudged, work, {}) == plain, verb
        for name, words in requests(work, unjudged).items():
            if verb not in option(name).verbs:
                continue
            typed, given = words
            if (verb, name) == ("yield", "cluster"):  # every machine is drawn, at one level
                typed = given = {"cluster": "localhost:9"}
            found = by_line(verb, unjudged, work, typed)
            if verb in PYTHON_VERBS:
                assert by_python(verb, unjudged, work, given) == found, (verb, name)
            if isinstance(found, str):
                refused.setdefault(name, set()).add(verb)
            else:
                assert found != plain, (verb, name)
    assert refused == REFUSED[work]


_UNLEARNED = {
    one.name: {"learn"} for one in TABLE
    if one.group is not Group.PLAN and "learn" in one.verbs and Door.LINE in one.doors
}  # fmt: skip
REFUSED = {
    "loops": {"band": {"learn"}},  # the machine has no spring
    "switches": _UNLEARNED | {name: {"fastest"} for name in ("low", "high", "learned")},
    "steps": _UNLEARNED | {"learned": {"fastest"}},
}
"""By kind of work: options of a verb that have no meaning for the job or its machine."""


@pytest.mark.parametrize(
    ("given", "typed", "widths_s"),
    [
        ("36 ms", "36 ms", (0.036,)),
        ("36 ms, 50 ms", "36 ms, 50 ms", (0.036, 0.05)),
        (["36 ms", "50 ms"], "36 ms, 50 ms", (0.036, 0.05)),
        (("36 ms",), "36 ms", (0.036,)),
    ],
)
def test_a_redesign_tries_the_same_smoothing_times_by_both_doors(
    monkeypatch: pytest.MonkeyPatch, given: object, typed: str, widths_s: tuple[float, ...]
) -> None:
    from threadline.cli import design

    class AskedError(Exception):
        pass

    def asked(
        file: Path, machine: Any, spec: Any, options: Options, expected: Any, *_: Any
    ) -> None:
        raise AskedError(options, expected)

    monkeypatch.setattr(design, "search_design", asked)
    monkeypatch.setattr("threadline.search.design.design", asked)
    job = EXAMPLES / "stitcher-test-path.seam.toml"
    with pytest.raises(AskedError) as by_call:
        tl.design(job, "stitcher", feed_forward=True, smoothing=given)  # type: ignore[arg-type]
    words = ["design", str(job), "-m", "stitcher", "--feed-forward", "--smoothing", typed]
    with pytest.raises(AskedError) as by_words:
        app(args=words, standalone_mode=False)
    assert by_call.value.args == by_words.value.args
    assert by_call.value.args[1].smoothing_s == pytest.approx(widths_s, rel=1e-12)


def test_a_redesign_refuses_what_is_no_smoothing_time() -> None:
    job = EXAMPLES / "stitcher-test-path.seam.toml"
    with pytest.raises(OptionError, match=r"smoothing is \[36\], of type list"):
        tl.design(job, "stitcher", feed_forward=True, smoothing=[36])  # type: ignore[list-item]
    with pytest.raises(OptionError, match="needs feed-forward"):
        tl.design(job, "stitcher", smoothing=["36 ms"])


def test_an_option_changes_what_is_read(stopped: Path) -> None:
    """Otherwise this test would not notice a verb that ignores one of these options."""
    plain = by_python("prove", stopped, "ticks", {})
    for name in ("dialect", "feed-mode", "radius", "offset", "axes"):
        assert by_python("prove", stopped, "ticks", {name: GIVEN[name]}) != plain
    sewn = by_python("prove", stopped, "seam", {})
    assert by_python("prove", stopped, "seam", {"needle": "20 stitch/s"})[1] != sewn[1]


@pytest.mark.parametrize("verb", ["prove", "compare", "fastest"])
@pytest.mark.parametrize(
    ("work", "option", "value"),
    [("steps", "radius", "A=1 mm"), ("switches", "product", str(EXAMPLES / "vessel.wind.toml"))],
)
def test_a_refusal_names_the_option_and_offers_no_other(
    stopped: Path, verb: str, work: str, option: str, value: str
) -> None:
    """The machine has no use for the option; another may be of no use for the verb."""
    for ask in (by_line, by_python):
        refused = ask(verb, stopped, work, {option: value})
        assert isinstance(refused, str)
        assert f"{WORK[work][1]} takes no {option}=, because it" in refused
        assert refused.endswith(" to choose. Leave it out.")


def test_a_refusal_is_written_as_python_takes_it(stopped: Path) -> None:
    file, machine = WORK["steps"]
    with pytest.raises(OptionError, match=r'interpolations=\["law:cycloidal"\]\.$') as refused:
        tl.compare(stopped / file, machine, ["linear"])
    assert "takes no interpolations=, because" in str(refused.value)
    with pytest.raises(OptionError, match=r'feeds=\["120 stitch/min"\]\.$'):
        tl.compare(stopped / file, machine, feeds=["10 mm/s"])
    with pytest.raises(OptionError, match=r'give interpolation="optimal"\.$'):
        tl.prove(stopped / "a.prg", "lathe-winder", contour="1 mm")
    with pytest.raises(OptionError, match="long_stitches='x' is not known"):
        tl.prove(stopped / file, machine, long_stitches="x")


@pytest.mark.parametrize(
    ("verb", "word", "message"),
    [
        ("compare", "feed", "compare takes no feed. Did you mean feeds?"),
        ("compare", "shaper", "compare takes no shaper. Did you mean shapers?"),
        ("compare", "interpolaton", "Did you mean 'interpolations'?"),
        (
            "fastest",
            "needle",
            "fastest takes no needle: it searches the speed of the needle. "
            "Bound it with low= and high=.",
        ),
        ("fastest", "mode", 'commands for another mode could only be slower. Give band="20 %" '),
        ("yields", "level", "yields takes no level: it judges drawn machines in one run each. "),
        ("prove", "mismatch", 'Give ends="100 %" to judge the machines there.'),
        ("prove", "tolerances", 'prove takes no tolerances. Did you mean level="over tolerances"?'),
        ("compile", "nominal", "unknown option 'nominal'. "),
    ],
)
def test_an_argument_of_other_functions_is_refused_by_its_name(
    stopped: Path, verb: str, word: str, message: str
) -> None:
    """As on the command line, and not by the nearest word, which has another meaning."""
    more = ["csv", stopped / "out"] if verb == "compile" else []
    with pytest.raises(OptionError) as refused:
        getattr(tl, verb)(stopped / "a.prg", "lathe-winder", *more, **{word: "x"})
    assert message in str(refused.value)


@pytest.mark.parametrize("verb", ["compare", "fastest"])
def test_a_nonsense_dialect_is_refused_by_every_function(stopped: Path, verb: str) -> None:
    job, machine = stopped / "a.gcode", "stepper-winder"
    with pytest.raises(OptionError, match="nonsense"):
        getattr(tl, verb)(job, machine, dialect="nonsense")


def test_a_robust_search_is_refused_by_its_own_name_and_may_be_none(stopped: Path) -> None:
    for ask in (by_line, by_python):
        refused = ask("fastest", stopped, "seam", {"robust": "300 %"})
        assert "robust '300 %' must be at least 0 % and at most 200 %" in refused
        options = ask("fastest", stopped, "seam", {"robust": "0 %", "feed-forward": True})[0]
        assert options.robust_share == 0.0
        assert ask("fastest", stopped, "seam", {"robust": "0 %"})[0].robust_share is None


def test_the_searches_refuse_what_they_find_themselves(stopped: Path) -> None:
    """For a move list the search finds a shaper for every move."""
    for ask in (by_line, by_python):
        refused = ask("fastest", stopped, "switches", {"shaper": "zv"})
        assert "shaper='zv' does not apply to letter-cycle" in refused


def test_a_mode_is_refused_where_no_shaper_is_compared(stopped: Path) -> None:
    for ask in (by_line, by_python):
        refused = ask("compare", stopped, "ticks", {"mode": "3 Hz"})
        assert "mode= and damping= name the mode of a shaper" in refused


@pytest.mark.long(but="a.seam.toml-stitcher-found1")
@pytest.mark.usefixtures("coarse_search")
@pytest.mark.parametrize(
    ("job", "machine", "found"),
    [
        ("a.prg", "lathe-winder", {"feed", "limits"}),
        ("a.seam.toml", "stitcher", {"needle"}),
        ("rosette.dst", "table-embroiderer", {"tolerance"}),
    ],
)
def test_the_fastest_is_proved_by_the_options_that_it_tells(
    job: str, machine: str, found: set[str], tmp_path: Path
) -> None:
    (tmp_path / "a.prg").write_text("G91 G1 X60 F600\nX-60\nX60\nM30\n")
    (tmp_path / "a.seam.toml").write_text(
        '[stitching]\nstitch_length = "0.1 in"\nneedle_speed = "75 stitch/s"\n'
        'motion = "discrete"\n[[contour]]\nunit = "mm"\npoints = [[0, 0], [20, 0]]\n'
    )
    file = tmp_path / job if job.startswith("a.") else EXAMPLES / job
    words = {"level": "nominal"}
    if machine == "stitcher":
        words["spec"] = str(EXAMPLES / "stitcher-place.spec.toml")
    best = tl.fastest(file, machine, **words)
    assert best.best_options is not None
    assert set(best.best_options) <= found | {"feed"}
    proof = tl.prove(file, machine, **words, **best.best_options)
    assert proof.passed
    if job == "a.prg":
        assert proof.plan.duration_s == best.of.best.duration_s
    elif job.endswith(".dst"):
        assert proof.plan.duration_s == best.best
    else:
        assert proof.plan.options["needle"] == f"{best.best!r} stitch/s"
    assert [r.measured for r in proof.verdict.results] == [
        r.measured for r in _verdict(best.of).results
    ]


def _verdict(found: Any) -> Any:
    return found.best.found.verdict if hasattr(found, "candidates") else found.verdict


def test_files_made_from_the_table_of_options_are_current() -> None:
    """``python -m tools.options_reference`` writes the page, the types and the panel's fields."""
    for file, content in files().items():
        assert file.read_text(encoding="utf-8") == content, file.name


def test_functions_have_the_options_of_the_table_by_name() -> None:
    """Each function names them all in its signature."""
    for verb in PYTHON_VERBS:
        signature = inspect.signature(getattr(face, python_name(verb)))
        listed = {one.word: one.default_of(verb) for one in options_for(verb, Door.PYTHON)}
        own = {name: one.default for name, one in signature.parameters.items() if name in listed}
        assert own == listed


def test_the_table_and_the_options_of_a_plan_fit() -> None:
    """Every option in a recording is an attribute of ``Options``, and the reverse."""
    names = {one.name for one in inspect.signature(Options).parameters.values()}
    assert {one.attribute for one, _ in RECORDED} == names
    for one in TABLE:
        assert one.help and one.verbs and one.doors
        assert set(one.helps) <= set(one.verbs)
        assert one.type is Type.FLAG or not isinstance(one.default, bool)
        assert one.parse is None or one.attribute
