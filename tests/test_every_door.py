"""Every verb takes every option that applies to it, in Python and in a shell alike."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tools.options_reference import files

import threadline as tl
from threadline import face
from threadline.cli.main import app
from threadline.commands.learned import text_of
from threadline.errors import InputError, OptionError
from threadline.files import Clock, Stream, TickBlock, TickTable
from threadline.proof.option_form import Door, Group, Option, Type
from threadline.proof.option_table import PYTHON_VERBS, RECORDED, TABLE, options_for, python_name
from threadline.proof.options import Options
from threadline.proof.request import as_arguments

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
WORK = {
    "ticks": ("a.gcode", "stepper-winder"),
    "loops": ("a.prg", "lathe-winder"),
    "seam": (EXAMPLES / "strap.seam.toml", "stitcher-rigid"),
    "switches": (EXAMPLES / "letter-cycle.toml", "letter-placer"),
    "steps": (EXAMPLES / "rosette.dst", "schiffli-frame"),
}
"""By kind of work: a job and a machine; of axes a part program with steppers and with loops, and a
seam."""
TABLE_TEXT = text_of(
    TickTable(
        clock=Clock("tick", Fraction(1, 1000)),
        axes=("X",),
        counts_per_unit=np.ones(1),
        start_counts=np.zeros(1, dtype=np.int64),
        job_sha256="",
        machine_sha256="",
        began_sha256="a",
        blocks=Stream.of(
            [
                TickBlock(
                    first_tick=0,
                    counts=np.ones((1, 1), dtype=np.int64),
                    operation=np.zeros(1, dtype=np.int64),
                )
            ]
        ),
    )
)
GIVEN: dict[str, Any] = {
    "interpolation": "linear", "law": "cycloidal", "feed": "36 mm/s", "dialect": "grbl",
    "feed-mode": "linuxcnc", "radius": "A=40 mm", "offset": "X=12 mm", "needle": "20 stitch/s",
    "tolerance": "0.05 mm", "limits": "90 %", "shaper": "zv:12Hz:0.02", "mode": "3 Hz",
    "damping": "0.1", "feed-forward": True, "smoothing": "50 ms", "robust": "100 %",
    "contour": "0.45 mm", "outside": "0.05 mm", "reserve": "volts 1 %, current 3 %",
    "narrow": "1: 0.05 mm, 2: 0.06 mm",
    "axes": "A=X,X=A", "product": str(EXAMPLES / "vessel.wind.toml"), "long-stitches": "split",
    "table": TABLE_TEXT,
}  # fmt: skip
"""A value for each planning option."""
WITH: dict[str, dict[str, Any]] = {
    "smoothing": {"feed-forward": True}, "robust": {"feed-forward": True},
    "contour": {"interpolation": "optimal"}, "outside": {"interpolation": "optimal"},
    "reserve": {"interpolation": "optimal"}, "narrow": {"interpolation": "optimal"},
    "mode": {"shaper": "zv"}, "damping": {"shaper": "zv"},
}  # fmt: skip
"""What some of them need beside them."""
LINE_VERBS = ("prove", "run", "compile", "equal", "compare", "fastest", "yield", "design", "judge")
SEARCHED = {"fastest": {"shaper", "robust"}, "design": {"feed-forward", "smoothing", "robust"}}
"""Options that mean something else to a verb: a share of machines to judge, times to try."""


class PlannedError(Exception):
    """Raised where a verb has read the job and would plan it."""

    def __init__(self, job: Any, machine: Any, options: Options) -> None:
        moves = [repr(one) for one in job]
        axes = {name: (axis.radius, axis.profile) for name, axis in machine.axes.items()}
        super().__init__("planned")
        self.asked = (options.on(machine), moves, axes, machine.name)


def planned(job: Any, machine: Any, options: Options, *_: Any, **__: Any) -> None:
    raise PlannedError(job, machine, options)


@pytest.fixture
def stopped(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Stop every verb where it would plan its job; return a folder with the jobs."""
    from threadline.cli import compile_, design, equal_, run_
    from threadline.machine.radii import with_radii
    from threadline.proof import pipeline, recorded
    from threadline.search import by_pace, machine_yield

    compared = importlib.import_module("threadline.search.compare")  # its function has another name
    for module in (pipeline, recorded, compile_, equal_, run_, machine_yield, compared):
        monkeypatch.setattr(module, "plan_job", seen)
    searched = lambda asked: planned(asked.job, asked.machine, asked.options)  # noqa: E731
    for pace, search in by_pace.SEARCHES.items():
        monkeypatch.setitem(by_pace.SEARCHES, pace, replace(search, find=searched))

    def designed(file: Path, machine: Any, spec: Any, options: Options, *_: Any) -> None:
        planned(pipeline.open_job(file, machine, options), with_radii(machine, options.radius),
                options)  # fmt: skip

    monkeypatch.setattr(design, "search_design", designed)
    monkeypatch.setattr("threadline.search.design.design", designed)
    (tmp_path / "a.prg").write_text("G91 G1 X5 A10 F600\nX-5\nM30\n")
    (tmp_path / "a.gcode").write_text("G21 G91\nG1 X5 A10 F600\nX-5\nM2\n")
    (tmp_path / "trace.csv").write_text("time [s];X.load [m]\n0;0\n0.1;0\n0.2;0\n")
    return tmp_path


def seen(job: Any, machine: Any, options: Options, *_: Any, **__: Any) -> None:
    """Stand-in for ``plan_job``, which gives the machine the radii of the options."""
    from threadline.machine.radii import with_radii

    planned(job, with_radii(machine, options.radius), options)


def outcome(ask: Callable[[], object]) -> tuple[Any, ...] | str:
    """Return the plan request of a verb, or its refusal in the words of Python."""
    try:
        ask()
    except PlannedError as reached:
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
    given = {name.replace("-", "_"): value for name, value in words.items()}
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


def given_to(one: Option, work: str) -> dict[str, Any]:
    value = GIVEN[one.name]
    if work == "steps" and one.name == "feed":
        value = "100 stitch/min"
    if work == "switches" and one.name == "shaper":
        value = "zv"
    return {**WITH.get(one.name, {}), one.name: value}


def test_every_planning_option_is_walked() -> None:
    assert set(GIVEN) == {one.name for one in PLANNING}


@pytest.mark.long(but="ticks")
@pytest.mark.parametrize("work", WORK)
def test_every_verb_reads_and_plans_alike_by_both_doors(stopped: Path, work: str) -> None:
    """Verb by option by kind: the same job, read alike, with the same options, or one refusal."""
    kind = "ticks" if work in {"loops", "seam"} else work
    answered_count = 0
    for one in PLANNING:
        words = given_to(one, work)
        expected = by_python("prove", stopped, work, words)
        if kind not in one.kinds:
            assert isinstance(expected, str), one.name
        for verb in LINE_VERBS:
            if verb not in one.verbs or one.name in SEARCHED.get(verb, ()):
                continue
            if any(name not in {o.name for o in options_for(verb)} for name in words):
                continue
            found = by_line(verb, stopped, work, words)
            assert found == expected, (verb, one.name)
            answered_count += not isinstance(found, str)
            if verb in PYTHON_VERBS:
                assert by_python(verb, stopped, work, words) == expected, (verb, one.name)
    assert answered_count > 5


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
        ("fastest", "needle", "fastest takes no needle; prove, run, compare, yields, design, "),
        ("yields", "level", "yields takes no level; prove, run, fastest, "),
        ("design", "mode", "design takes no mode; prove, run, compare, yields, "),
        ("prove", "margin", "prove takes no margin; fastest takes it. Leave it out."),
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
        refused = ask("fastest", stopped, "loops", {"robust": "300 %"})
        assert "robust '300 %' must be at least 0 % and at most 200 %" in refused
        options = ask("fastest", stopped, "loops", {"robust": "0 %", "feed-forward": True})[0]
        assert options.robust_share == 0.0
        assert ask("fastest", stopped, "loops", {"robust": "0 %"})[0].robust_share is None


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
