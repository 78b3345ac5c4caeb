"""Start of the program, before its commands are imported.

Importing the commands takes seconds. Interrupts are handled before, so that one then also ends in
a single line.
"""

from __future__ import annotations

import io
import logging
import os
import sys
import warnings

from threadline.cli.interrupt import leaving_on_interrupt

_STREAMS = 3


def run() -> None:
    """Run the program with the arguments of the shell."""
    _open_streams()
    _silence_libraries()
    _calculate_on_one_thread()
    _draw_into_files()
    with leaving_on_interrupt():  # also after the command, while the interpreter ends
        from threadline.cli.main import main

        main()


def _open_streams() -> None:
    """Open standard streams that were closed, and let each of them take any text.

    Otherwise the next opened file would get the descriptor of a closed stream, and printed text
    would land in that file.
    """
    for number in range(_STREAMS):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free descriptor: this one
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _silence_libraries() -> None:
    """Keep libraries' warnings for programmers off standard error, unless ``python -W`` asks."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    logging.lastResort = None


def _calculate_on_one_thread() -> None:
    """Let BLAS multiply numpy's matrices on one thread, unless the environment says otherwise.

    The matrices are small: several threads wait longer than they calculate. A sum split among
    cores is rounded differently for each number of cores. BLAS reads the variable when numpy is
    imported.
    """
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _draw_into_files() -> None:
    """Let matplotlib draw into files only; it fails if it is set to a backend that it lacks."""
    os.environ["MPLBACKEND"] = "agg"


if __name__ == "__main__":
    run()
