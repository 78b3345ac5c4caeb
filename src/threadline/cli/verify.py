"""``threadline verify``: whether a proof still holds for its files as they are now."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.cli.output import print_json, say
from threadline.cli.shared_options import JsonOption
from threadline.errors import Place, ProofError
from threadline.proof_file import read_proof, verify_proof
from threadline.verdict.types import Level


def verify(
    proof: Annotated[Path, typer.Argument(help="File of a proof (prove --proof FILE).")],
    json: JsonOption = False,
) -> None:
    """Plan again from the files that PROOF names, and say whether it is still a proof of them.

    Job, machine, options, specification, the rows of the commands and the version of the program
    must be what they were; nothing is simulated again.

    Exit status: 0 when nothing has changed and the work is in spec, 1 when it is out of spec, 2
    when something has changed or cannot be read.

    Example: threadline verify x-180.proof.json
    """
    known = read_proof(proof)
    differences = verify_proof(known)
    if differences:
        raise ProofError(
            f"it is no proof of what there is now: {'; '.join(map(str, differences))}",
            place=Place(str(proof)),
            remedy="Prove the job again.",
        )
    if json:
        print_json({"proof": str(proof), "passed": known.passed, "level": known.level})
    else:
        alone = known.level == Level.LIMITS.value
        verdict = "out of spec" if not known.passed else "limits kept" if alone else "in spec"
        say(f"{proof.name}: nothing has changed since it was proved; {verdict}, {known.level}")
    raise typer.Exit(0 if known.passed else 1)


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("verify")(verify)
