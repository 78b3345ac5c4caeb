"""The tree of errors: codes, texts and base classes."""

from __future__ import annotations

import re

import pytest

from threadline import errors
from threadline.errors import (
    BudgetError,
    InputError,
    LimitError,
    LinkFaultError,
    Place,
    PlanError,
    ThreadlineError,
)

ALL = [
    cls
    for cls in vars(errors).values()
    if isinstance(cls, type) and issubclass(cls, ThreadlineError)
]


def test_every_error_has_a_code_of_its_own_and_stands_in_the_drawing() -> None:
    codes = [cls.code for cls in ALL]
    assert len(set(codes)) == len(codes)
    drawing = errors.__doc__ or ""
    for cls in ALL:
        assert re.search(rf"^ +{cls.__name__}\b", drawing, re.M), cls
    printed = re.findall(r"(\w+Error) +\[([A-Z-]+)\]", drawing)
    assert len(printed) >= 9
    for name, code in printed:
        assert getattr(errors, name).code == code


def test_the_tree_is_as_drawn() -> None:
    """Indentation of the drawing is inheritance."""
    above: dict[int, type] = {}
    for line in (errors.__doc__ or "").splitlines():
        match = re.match(r"( +)(\w+Error)\b", line)
        if match is None:
            continue
        depth, cls = len(match[1]), getattr(errors, match[2])
        parents = [d for d in above if d < depth]
        if parents:
            assert above[max(parents)] in cls.__bases__, cls
        above = {d: c for d, c in above.items() if d < depth} | {depth: cls}


def test_wrong_input_is_also_a_value_error() -> None:
    assert issubclass(InputError, ValueError)
    assert issubclass(LimitError, PlanError)
    assert issubclass(BudgetError, PlanError)
    assert not issubclass(LinkFaultError, InputError)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (InputError("too fast"), "[INPUT] too fast."),
        (InputError("Did you mean it?"), "[INPUT] Did you mean it?"),
        (
            PlanError("feed is 0", place=Place("/jobs/a.prg", 7), remedy="Give an F."),
            "[PLAN] a.prg:7: feed is 0. Give an F.",
        ),
        (PlanError("empty", place=Place("a.prg")), "[PLAN] a.prg: empty."),
    ],
)
def test_text(error: ThreadlineError, text: str) -> None:
    assert str(error) == text


def test_a_limit_error_keeps_its_numbers() -> None:
    error = LimitError(
        "too fast", axis="X", quantity="velocity", value_si=1.5, limit_si=1.0, remedy="Slow down."
    )
    assert (error.axis, error.quantity, error.value_si, error.limit_si) == (
        "X",
        "velocity",
        1.5,
        1.0,
    )
    assert str(error) == "[PLAN-LIMIT] too fast. Slow down."
