"""Start of the program, before its commands are imported.

Interrupts are handled before the commands are imported, which takes seconds: an interrupt ends in
one line then, too.
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
    with leaving_on_interrupt():  # behind the command, too, while the interpreter ends
        from threadline.cli.main import main

        main()


def _open_streams() -> None:
    """Open standard streams that were closed, and let each of them take any text.

    The next file that is opened would otherwise get the number of a closed stream, and with it
    what is printed there.
    """
    for number in range(_STREAMS):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _silence_libraries() -> None:
    """Keep what libraries say to programmers off standard error, unless ``python -W`` asks."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    logging.lastResort = None


def _calculate_on_one_thread() -> None:
    """Let BLAS multiply numpy's matrices on one thread, unless the environment says otherwise.

    The matrices are small: threads wait for each other longer than they calculate, and a sum that
    is split among cores is rounded differently for each number of cores. BLAS reads the variable
    when numpy is imported.
    """
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _draw_into_files() -> None:
    """Let matplotlib draw into files alone; it fails of the name of a backend that it lacks."""
    os.environ["MPLBACKEND"] = "agg"


if __name__ == "__main__":
    run()
