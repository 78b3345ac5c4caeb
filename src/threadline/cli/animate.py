"""``threadline animate``: a film of the machine at work, planned and actual."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.base.writing import together
from threadline.cli import option_parameters
from threadline.cli.arguments import JobArgument, MachineOption, keep_inputs
from threadline.cli.output import check_outputs, progress_bar, say, tell
from threadline.proof.pipeline import NOMINAL, with_shaping
from threadline.proof.pipeline import prove as prove_job
from threadline.proof.recorded import warnings_of
from threadline.proof.request import Words
from threadline.report.animation import needs_of, write_animation
from threadline.verdict import closing


def animate(
    job: JobArgument,
    machine: MachineOption,
    out: Annotated[
        Path, typer.Option("--out", "--output", "-o", help="File to write: .html, .gif or .mp4.")
    ],
    words: Words,
) -> None:
    """Show JOB on the simulated machine: its motion, the plan, and the places where they differ.

    A winder's mandrel turns with the fibre on it; a stitcher's head goes over the cloth, an
    embroidery frame under its needle; a placer and other machines are gantries. One run is shown.
    An .html plays in any browser, a .gif anywhere; an .mp4 needs ffmpeg.

    Exit status: 0 written, 2 wrong input.

    Example: threadline animate examples/helix.gcode -m lathe-winder --radius "A=50 mm"
    --feed "200 mm/s" -o helix.html
    """
    chosen = words.machine(machine)
    keep_inputs(out, job, chosen.file, *words.files())
    needs_of(out)
    check_outputs(file=out)
    options = words.options(job)
    spec = with_shaping(words.spec(chosen), chosen, options)
    with progress_bar() as progress:
        proof = prove_job(job, chosen, spec, options, progress, NOMINAL, words.actual())
        with together(out):
            scene = write_animation(proof, out, progress)
    tell(warnings_of(proof))
    say(closing(proof.verdict))
    say(f"Animation: {out}, {scene.frames} frames of {proof.plan.duration_s:.4g} s")


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "animate", animate)
