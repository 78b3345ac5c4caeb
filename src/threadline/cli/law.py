"""``threadline law``: motion laws and what they ask of a machine."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from threadline.cli.options import JsonOption
from threadline.cli.output import print_json, print_table
from threadline.laws import LAWS, Law
from threadline.laws import law as law_called


def law(
    name: Annotated[
        str | None, typer.Argument(help="Name of the law, modified-sine or 3-4-5; default: all.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Show a motion law from rest to rest, of rise 1 in time 1.

    Cv, Ca and Cj are the peaks of velocity, acceleration and jerk: a move by h in time T has the
    peak velocity Cv h / T, acceleration Ca h / T^2, jerk Cj h / T^3. The efficiency is the heat
    in the motor of the cubic law, the least there is, over that of this law.

    Example: threadline law modified-sine
    """
    laws = list(LAWS.values()) if name is None else [law_called(name)]
    if json and name is not None:
        print_json(law_json(laws[0]))
    elif json:
        print_json({"laws": {each.name: law_json(each) for each in laws}})
    else:
        rows = [
            [
                each.name,
                f"{each.velocity:.4f}",
                f"{each.acceleration:.4f}",
                "infinite" if each.jerk is None else f"{each.jerk:.4f}",
                f"{each.efficiency:.4f}",
            ]
            for each in laws
        ]
        print_table("Motion laws", ["law", "Cv", "Ca", "Cj", "efficiency"], rows)


def law_json(law: Law) -> dict[str, Any]:
    """Return the characteristics of a law as JSON content; Cj is None where it is infinite."""
    return {
        "name": law.name,
        "Cv": law.velocity,
        "Ca": law.acceleration,
        "Cj": law.jerk,
        "efficiency": law.efficiency,
    }


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("law")(law)
