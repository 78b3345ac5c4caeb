"""The tree of errors: each has a stable code and states subject, value, limit and remedy.

::

    ThreadlineError
      InputError (also ValueError)          wrong input: the program exits with 2
        UnitError          [UNIT]           a quantity that cannot be read
        MachineError       [MACHINE]        a machine file
        JobError           [JOB]            a job file
        SpecError          [SPEC]           a specification file
        RecordingError     [RECORDING]      a recording or table file
        ProofError         [PROOF]          the file of a proof
        OptionError        [OPTION]         a command-line or API option
        PlanError          [PLAN]           a job that this machine cannot do
          LimitError       [PLAN-LIMIT]     a planned motion beyond a limit of the machine
          BudgetError      [PLAN-BUDGET]    more work than the machine file allows
        StoreError         [STORE]          a folder of runs
        CommandError       [COMMAND]        a command that a machine cannot take in its state
      LinkFaultError       [FAULT]          the machine or its link: the program exits with 3

``threadline.motion.shaping.ShaperError``, code SHAPER, is also a ``PlanError``: an input shaper
that cannot be designed, or that fails its own proof.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class Place:
    """A file and a line in it; ``line`` counts from 1, 0 means the whole file."""

    file: str
    line: int = 0

    def __str__(self) -> str:
        name = Path(self.file).name
        return f"{name}:{self.line}" if self.line else name


class ThreadlineError(Exception):
    """Base of every error that Threadline raises on purpose.

    Parameters
    ----------
    message
        The fault: the subject, its value and the limit.
    place
        File and line that caused it, where there is one.
    remedy
        Advice to the user.
    """

    code = "THREADLINE"

    def __init__(self, message: str, *, place: Place | None = None, remedy: str = "") -> None:
        self.message = message
        self.place = place
        self.remedy = remedy
        super().__init__(message)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]:
        # Pickle the state instead of calling __init__ again: subclasses need further arguments.
        return type(self).__new__, (type(self), *self.args), vars(self)

    def __str__(self) -> str:
        where = f"{self.place}: " if self.place else ""
        remedy = f" {self.remedy}" if self.remedy else ""
        text = self.message if self.message.endswith((".", "?", "!")) else f"{self.message}."
        return f"[{self.code}] {where}{text}{remedy}"


class InputError(ThreadlineError, ValueError):
    """The input is wrong; nothing was moved or written."""

    code = "INPUT"


@contextmanager
def placed(place: Place) -> Iterator[None]:
    """Add ``place`` to every ``InputError`` of the block that names no place itself.

    >>> with placed(Place("vessel.wind.toml", 12)):
    ...     raise JobError("the fibre never turns back")
    Traceback (most recent call last):
    threadline.errors.JobError: [JOB] vessel.wind.toml:12: the fibre never turns back.
    """
    try:
        yield
    except InputError as error:
        if error.place is None:
            error.place = place
        raise


class UnitError(InputError):
    """A quantity whose text, unit or dimension is wrong."""

    code = "UNIT"


class MachineError(InputError):
    """A machine file that does not describe a machine."""

    code = "MACHINE"


class JobError(InputError):
    """A job file that cannot be read."""

    code = "JOB"


class SpecError(InputError):
    """A specification file that cannot be read."""

    code = "SPEC"


class RecordingError(InputError):
    """A recording or command table that cannot be read."""

    code = "RECORDING"


class ProofError(InputError):
    """The file of a proof that cannot be read."""

    code = "PROOF"


class OptionError(InputError):
    """An option that is unknown or outside its range."""

    code = "OPTION"


class PlanError(InputError):
    """A job that this machine cannot do."""

    code = "PLAN"


class LimitError(PlanError):
    """A planned motion beyond a limit of the machine.

    Attributes
    ----------
    axis, quantity
        Axis and quantity of the exceeded limit, for instance ``"X"`` and ``"velocity"``.
    value_si, limit_si
        Peak of the planned motion, and the limit, in SI.
    """

    code = "PLAN-LIMIT"

    def __init__(
        self,
        message: str,
        *,
        axis: str,
        quantity: str,
        value_si: float,
        limit_si: float,
        place: Place | None = None,
        remedy: str = "",
    ) -> None:
        super().__init__(message, place=place, remedy=remedy)
        self.axis = axis
        self.quantity = quantity
        self.value_si = value_si
        self.limit_si = limit_si


class BudgetError(PlanError):
    """A job that needs more ticks, operations or memory than the machine file allows."""

    code = "PLAN-BUDGET"


class StoreError(InputError):
    """A folder of runs that cannot be used, or a run that does not exist."""

    code = "STORE"


class CommandError(InputError):
    """A command that a machine cannot take in its present state."""

    code = "COMMAND"


class LinkFaultError(ThreadlineError):
    """The machine or the link to it failed."""

    code = "FAULT"
