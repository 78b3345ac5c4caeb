"""``threadline verify``: check that a proof still matches its files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.cli.arguments import JsonOption, KeyOption
from threadline.cli.output import print_json, say
from threadline.errors import Place, ProofError
from threadline.proof.proof_file import read_proof, verify_proof
from threadline.proof.proof_hash import read_key
from threadline.verdict.types import Level

_SIGNED = {
    "none": "Not signed: anybody may have written the measured values of the file.",
    "not checked": "Signed; give --key KEY to check the signature.",
    "good": "Signed with this key, and unchanged since.",
}


def verify(
    proof: Annotated[Path, typer.Argument(help="File of a proof (prove --proof FILE).")],
    key: KeyOption = None,
    json: JsonOption = False,
) -> None:
    """Plan again from the files that PROOF names, and check that the proof still matches them.

    Job, machine, options, specification, the rows of the commands and the version of the program
    must be unchanged, and the verdict must follow from the criteria. Nothing is simulated again,
    and hashes do not show who wrote the measured values: check a signature with --key, or prove the
    job again, which gives the same bytes.

    Exit status: 0 when nothing has changed and the work is in spec, 1 when it is out of spec, 2
    when something has changed or cannot be read.

    Example: threadline verify x-180.proof.json
    """
    secret = None if key is None else read_key(key)
    proof_read = read_proof(proof, secret)
    differences = verify_proof(proof_read)
    if differences:
        raise ProofError(
            f"the proof does not match its files any more: {'; '.join(map(str, differences))}",
            place=Place(str(proof)),
            remedy="Prove the job again.",
        )
    signature = "none" if not proof_read.signed else "good" if secret is not None else "not checked"
    if json:
        print_json(
            {
                "proof": str(proof),
                "passed": proof_read.passed,
                "level": proof_read.level,
                "signature": signature,
            }
        )
    else:
        limits_only = proof_read.level == Level.LIMITS.value
        verdict = (
            "out of spec" if not proof_read.passed else "limits kept" if limits_only else "in spec"
        )
        say(f"{proof.name}: nothing has changed since it was proved; {verdict}, {proof_read.level}")
        say(_SIGNED[signature])
    raise typer.Exit(0 if proof_read.passed else 1)


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("verify")(verify)
