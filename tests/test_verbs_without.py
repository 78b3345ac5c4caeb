"""A verb without an option says why, by every door, and what to use instead."""

from __future__ import annotations

import re

import pytest

import threadline as tl
from threadline.cli.main import main
from threadline.errors import OptionError
from threadline.proof.option_form import Door, Option
from threadline.proof.option_table import (
    PLANNERS,
    PYTHON_VERBS,
    TABLE,
    list_argument,
    options_for,
    python_name,
)
from threadline.proof.python_arguments import as_arguments
from threadline.proof.verbs_without import reason, reasons

MATRIX = [(one, verb) for one in TABLE for verb in PLANNERS if verb not in one.verbs]
"""Every pair of option and verb that does not take it."""
OWN = {("repeats", "learn")}
"""Pairs for which the verb has an option of its own with this name."""


def test_every_verb_takes_an_option_or_has_a_reason() -> None:
    for one in TABLE:
        for verb in PLANNERS:
            assert (verb in one.verbs) is (reason(one.name, verb) is None), (one.name, verb)
        for without in reasons(one.name):
            assert set(without.verbs) <= set(PLANNERS), one.name


def test_a_reason_names_options_that_can_be_given() -> None:
    """Of the verb itself, or of the other command that the text names."""
    own = {"learn": {"repeats"}, "design": {"searches"}}
    for one, verb in MATRIX:
        why = reason(one.name, verb)
        assert why is not None
        named = [verb, *re.findall(r"(?:to|Learn) ([a-z]+)", why.instead)]
        taken = {name for other in named for name in own.get(other, set())}
        taken |= {o.name for other in named if other in PLANNERS for o in options_for(other)}
        for typed in re.findall(r"--([a-z-]+)", f"{why.why} {why.instead}"):
            assert typed in taken, (one.name, verb, typed)
        for other in re.findall(r"[Gg]ive it to (?!threadline panel)([a-z]+)", why.instead):
            assert other in one.verbs, (one.name, verb)


@pytest.mark.parametrize(("one", "verb"), MATRIX, ids=lambda part: getattr(part, "name", part))
def test_an_option_that_means_nothing_to_a_verb_is_refused_with_the_reason(
    one: Option, verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """By both doors, in the same words, and before a file is read: there is no such job."""
    why = reason(one.name, verb)
    assert why is not None
    if (one.name, verb) in OWN:
        return
    if verb != "panel" and Door.LINE in one.doors:
        with pytest.raises(SystemExit) as ended:
            main([verb, "no.prg", "-m", "lathe-winder", one.typed, "1"])
        told = capsys.readouterr()
        assert ended.value.code == 2
        assert (
            told.err == f"error: [OPTION] {verb} takes no {one.typed}: {why.why}. {why.instead}\n"
        )
    if verb in PYTHON_VERBS and Door.PYTHON in one.doors:
        more = ("csv", "out") if verb == "compile" else ()
        job = ("no.prg",) if verb == "judge" else ("no.prg", "lathe-winder")
        with pytest.raises(OptionError) as refused:
            getattr(tl, python_name(verb))(*job, *more, **{one.word: "1"})
        text = as_arguments(f"{why.why}. {why.instead}", verb)
        if list_argument(one, verb) is None:  # else the list of values is named
            assert f"{python_name(verb)} takes no {one.word}: {text}" in str(refused.value)


def test_the_level_of_python_is_two_flags_of_the_command_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        main(["prove", "no.prg", "-m", "lathe-winder", "--level", "nominal"])
    assert "--level is an argument of Python. Give --nominal, or --tolerances" in (
        capsys.readouterr().err
    )
