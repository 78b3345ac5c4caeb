"""The entry point: one typer application, and what an error means to the shell."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from threadline import __version__
from threadline.cli import analyse, compare, compile_, fastest, judge_, prove, shaper, size
from threadline.errors import InputError, LinkFaultError, ThreadlineError

EXIT_WRONG_INPUT = 2
EXIT_FAULT = 3
EXIT_INTERRUPTED = 130

app = typer.Typer(
    name="threadline",
    help="How fast can this machine do this job and stay in spec, and can you prove it?",
    no_args_is_help=True,
    add_completion=False,
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
    """Exit status: 0 in spec, 1 out of spec, 2 wrong input, 3 machine or link fault."""


for module in (prove, compare, fastest, compile_, judge_, analyse, shaper, size):
    module.register(app)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program; every error on purpose becomes one line and an exit status."""
    try:
        app(args=list(sys.argv[1:] if arguments is None else arguments), standalone_mode=True)
    except ThreadlineError as error:
        sys.stderr.write(f"error: {' '.join(str(error).split())}\n")
        fault = isinstance(error, LinkFaultError) and not isinstance(error, InputError)
        sys.exit(EXIT_FAULT if fault else EXIT_WRONG_INPUT)
    except OSError as error:
        subject = error.filename or "file"
        sys.stderr.write(f"error: [FILE] cannot use {subject}: {error.strerror}\n")
        sys.exit(EXIT_WRONG_INPUT)
    except KeyboardInterrupt:
        sys.stderr.write("error: interrupted; nothing was left half-written\n")
        sys.exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
