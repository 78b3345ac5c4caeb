"""Commands that are imported only when called, so that ``--help`` does not wait for numpy."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from threadline.base.importing import collecting_no_garbage
from threadline.cli.interrupt import leaving_on_interrupt
from threadline.errors import OptionError


@dataclass(frozen=True, slots=True)
class LazyCommand:
    """A command of the program.

    Parameters
    ----------
    module
        Module name in ``threadline.cli``; its ``register`` adds the command to a typer application.
    summary
        One line for ``threadline --help``, a short form of the first sentence of the command's own
        help.
    """

    module: str
    summary: str


SECTIONS = {
    "Start": {
        "new": LazyCommand("new", "Make a working project: machine, specification, job."),
        "connect": LazyCommand("connect", "Read the settings of a controller from itself."),
    },
    "Prove and search": {
        "prove": LazyCommand("prove", "Plan a job, simulate it, and say whether it is in spec."),
        "verify": LazyCommand("verify", "Check that a proof still matches its files."),
        "fastest": LazyCommand("fastest", "Find every feed at which a job stays in spec."),
        "compare": LazyCommand("compare", "Prove a job with several interpolations and feeds."),
        "yield": LazyCommand("yield_", "Say how many machines within the tolerances are in spec."),
        "design": LazyCommand("design", "Find the smallest change of a machine that is in spec."),
        "learn": LazyCommand(
            "learn", "Repeat JOB and correct its references by the error of every run."
        ),
        "animate": LazyCommand("animate", "Show a job on the machine: a page, a gif or a film."),
    },
    "Write for a controller": {
        "compile": LazyCommand("compile_", "Plan a job and write it for a controller."),
        "equal": LazyCommand("equal_", "Say whether the files of controllers are the plan."),
    },
    "Run, and judge the motion of the machine": {
        "run": LazyCommand("run_", "Prove a job, run it on a machine, record and judge it."),
        "panel": LazyCommand("panel_", "Serve the operator's panel in a browser."),
        "runs": LazyCommand("runs_", "List the runs of a store, the latest first."),
        "report": LazyCommand("report_", "Judge the recording of a run again, and write a report."),
        "judge": LazyCommand("judge_", "Judge the motion of a machine from its recording."),
    },
    "Understand and design a machine": {
        "analyse": LazyCommand("analyse", "Analyse the loops of a machine: margins, poles, modes."),
        "control": LazyCommand(
            "control_", "Design a controller for many sensors, and write it as a machine file."
        ),
        "measure": LazyCommand(
            "measure_", "Move one axis of MACHINE and record it, for a fit of its numbers."
        ),
        "fit": LazyCommand(
            "fit_", "Fit numbers of MACHINE to measured data, with their certainty."
        ),
        "tune": LazyCommand(
            "tune_",
            "Tune the loops of MACHINE: PE, PI, PD, PID and lead controllers by several rules.",
        ),
        "shaper": LazyCommand("shaper", "Design a shaper: table, sensitivity, cost."),
        "law": LazyCommand("law", "Show a motion law, rank laws on a mode, make one for it."),
        "cam": LazyCommand("cam", "Turn a measured cam into a motion law."),
        "size": LazyCommand("size", "Size a machine from the demands of its product."),
        "wind": LazyCommand("wind", "List the patterns, lengths and thickness of a winding."),
        "machines": LazyCommand("machines", "List the machines of the library, or print one."),
        "guide": LazyCommand("guide_", "Write the guide to a machine: axes, wiring, calibration."),
    },
}
"""The commands by purpose, in the order of ``threadline --help``."""

COMMANDS = {name: one for section in SECTIONS.values() for name, one in section.items()}


class LazyGroup(TyperGroup):
    """A group of commands, each imported when it is called."""

    def list_commands(self, _context: Any) -> list[str]:
        """Return the names in the order of the table."""
        return list(COMMANDS)

    def get_command(self, _context: Any, cmd_name: str) -> Any:
        """Import and return a command, None if there is none with that name."""
        entry = COMMANDS.get(cmd_name)
        if entry is None:
            return None
        if cmd_name not in self.commands:
            with leaving_on_interrupt(), collecting_no_garbage():
                module = import_module(f"threadline.cli.{entry.module}")
            app = typer.Typer(add_completion=False, rich_markup_mode=None)
            module.register(app)
            self.commands[cmd_name] = get_command(app)
        return self.commands[cmd_name]

    def resolve_command(self, context: Any, args: list[str]) -> Any:
        """Return the called command and the remaining arguments.

        Raises
        ------
        OptionError
            If there is no command with that name.
        """
        if args and args[0] not in COMMANDS:
            close = difflib.get_close_matches(args[0], COMMANDS, n=1)
            hint = f"Did you mean {close[0]!r}? " if close else ""
            raise OptionError(
                f"there is no command {args[0]!r}", remedy=f"{hint}threadline --help lists them."
            )
        return super().resolve_command(context, args)

    def format_commands(self, _context: Any, formatter: Any) -> None:
        """Write the list of commands for ``--help`` without importing them."""
        for title, section in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([(name, entry.summary) for name, entry in section.items()])
