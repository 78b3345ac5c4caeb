"""The entry point: one typer application, and the exit status and line of every error."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from typer.exceptions import TyperException

from threadline import __version__
from threadline.base.reading import noting_inputs
from threadline.base.wording import field_fault
from threadline.base.writing import noting_outputs
from threadline.cli.interrupt import (
    EXIT_DEFECT,
    EXIT_INTERRUPTED,
    Termination,
    keep_traceback,
    terminating,
)
from threadline.cli.lazy import LazyGroup
from threadline.cli.messages import STDOUT, note, tell_warnings, telling
from threadline.errors import BudgetError, InputError, LinkFaultError, OptionError, ThreadlineError

EXIT_WRONG_INPUT = 2
EXIT_FAULT = 3
EXIT_NO_READER = 141  # 128 + SIGPIPE
# Longest error text, in characters: a value of thousands would bury the message. A remedy, which
# Threadline writes itself and may list many values, is printed in full.
_HEAD_SHOWN, _TAIL_SHOWN, _MOST_OF_REMEDY = 320, 155, 3000
_LEFT_OUT = " ... "
_COMPLETION = ("--install-completion", "--show-completion")  # typer's; it ends with 1 if refused
_STDOUT = 1  # its file descriptor; typer may have put something else into sys.stdout

_EPILOG = (
    "Exit status: 0 in spec, 1 out of spec, 2 wrong input, 3 machine or link fault, 70 a defect "
    "of this program (its traceback is kept in a file that the error names). An error is "
    'one line of text on standard error, "error: [CODE] file:line: what. Remedy.", with --json '
    "too: standard output is then empty, so look at the exit status before reading it."
)

app = typer.Typer(
    name="threadline",
    cls=LazyGroup,
    help="How fast can this machine do this job and stay in spec, and can you prove it?",
    epilog=_EPILOG,
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")
    ] = False,
) -> None:
    """Hold the options that stand before a command."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program; an error that the package raises becomes one line and an exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    with terminating() as termination, noting_outputs() as appeared:
        status = _run(given, termination)
        if status == EXIT_INTERRUPTED:
            status, message = termination.end(wrote=bool(appeared.files))
            note(message.rstrip())
        for folder in appeared.folders:
            note(f"made the folder {_near(folder)}")
    sys.exit(status)


def _near(folder: Path) -> Path:
    """Return a folder relative to the working folder if it lies below, else unchanged."""
    with suppress(OSError, ValueError):  # the working folder may be deleted, or not a parent
        return folder.relative_to(Path.cwd())
    return folder


def _argument_fault(error: TyperException) -> str:
    """Return the fault of an argument, in Threadline's own words if it has some."""
    faults = getattr(error.__cause__, "errors", None)  # pydantic's: typer reads values with it
    if isinstance(error, typer.BadParameter) and error.param and faults is not None:
        fault, *_ = faults()
        if isinstance(raised := fault.get("ctx", {}).get("error"), ThreadlineError):
            return str(raised)
        reason, remedy = field_fault(fault)
        text = f"{error.param.get_error_hint()} {reason}. {remedy}"
        return f"[{OptionError.code}] {text} See the command's --help."
    # Imported only here: the table of options imports numpy.
    from threadline.proof.request import line_refusal

    verb = getattr(getattr(error, "ctx", None), "info_name", None) or ""
    if (refused := line_refusal(verb, getattr(error, "option_name", ""))) is not None:
        return str(refused)
    reason = error.format_message().rstrip(".")
    text = getattr(getattr(error, "param", None), "help", "")
    if reason.startswith("Missing") and text:
        reason = f"{reason}: {text[0].lower()}{text[1:].rstrip('.')}"
    return f"[{OptionError.code}] {reason}. See the command's --help for its arguments and options."


def _run(given: list[str], termination: Termination) -> int:
    """Return the exit status of a command; end the program with one line at an error."""
    try:
        _refuse_undecodable(given)
        with telling(starting="--help" not in given) as messages, noting_inputs():
            # Typer's stand-alone mode prints four lines for a wrong option and none for an
            # interrupt. Without it typer returns the exit status, or None for 0.
            status = int(app(args=given or ["--help"], standalone_mode=False) or 0)
            if status and given and given[0] in _COMPLETION:
                raise OptionError(
                    "there is no tab completion for this shell",
                    remedy="Call it from bash, zsh, fish or PowerShell.",
                )
            _flush()
            tell_warnings(messages.warnings)
    except ThreadlineError as error:
        fault = isinstance(error, LinkFaultError) and not isinstance(error, InputError)
        _stop(str(error), EXIT_FAULT if fault else EXIT_WRONG_INPUT, remedy=error.remedy)
    except TyperException as error:
        _stop(_argument_fault(error), EXIT_WRONG_INPUT)
    except BrokenPipeError:
        _nobody_reads()
    except SystemExit as stopped:  # typer ends a broken pipe with 1, which is "out of spec" here
        if isinstance(stopped.__context__, BrokenPipeError):
            _nobody_reads()
        raise
    except OSError as error:
        subject = error.filename or "file"
        if subject == STDOUT:
            _discard_output()
        _stop(
            f"[FILE] cannot use {subject}: {error.strerror or error}. Give another path.",
            EXIT_WRONG_INPUT,
        )
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except MemoryError:
        _stop(
            f"[{BudgetError.code}] this needs more memory than there is. Give a shorter job, a "
            "higher feed or a longer clock.",
            EXIT_WRONG_INPUT,
        )
    except Exception as error:
        # The interrupt came during machine code, which failed or returned as if nothing happened.
        cause = error.__cause__
        while isinstance(cause, SystemError):
            cause = cause.__cause__
        if termination.was_lost or isinstance(cause, KeyboardInterrupt):
            return EXIT_INTERRUPTED
        _stop(keep_traceback(error, given), EXIT_DEFECT)
    return status


def _refuse_undecodable(given: list[str]) -> None:
    """Refuse an argument that is not valid text: it could be neither printed nor recorded."""
    for text in given:
        try:
            text.encode("utf-8")
        except UnicodeEncodeError:
            raise OptionError(
                f"the argument {text!r} is not UTF-8 text", remedy="Rename the file."
            ) from None


def _flush() -> None:
    """Flush standard output; an error names the output that failed."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        error.filename = STDOUT
        raise


def _discard_output() -> None:
    """Send standard output nowhere, or the interpreter would flush it again and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), _STDOUT)


def _nobody_reads() -> NoReturn:
    """End as a shell's own tools do: a closed pipe is not an error of the input."""
    _discard_output()
    sys.exit(EXIT_NO_READER)


def _stop(text: str, status: int, *, remedy: str = "") -> NoReturn:
    """Print in one line why the program ends, and end it."""
    line = " ".join(text.split())
    tail = min(max(_TAIL_SHOWN, len(" ".join(remedy.split()))), _MOST_OF_REMEDY)
    if len(line) > _HEAD_SHOWN + tail + len(_LEFT_OUT):
        # The subject is at the start of the text and the remedy at its end.
        line = f"{line[:_HEAD_SHOWN]}{_LEFT_OUT}{line[-tail:]}"
    note(f"error: {line}")
    sys.exit(status)
