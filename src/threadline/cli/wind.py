"""``threadline wind``: patterns, lengths and thickness of a winding, without a machine."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.base.writing import staged_file, together
from threadline.cli import completion
from threadline.cli.arguments import JsonOption, keep_inputs
from threadline.cli.messages import warning
from threadline.cli.output import check_outputs, print_json, print_table, say
from threadline.commands.nc import write_passes
from threadline.errors import OptionError
from threadline.jobs.winding.bare import bare_of, write_meridian
from threadline.jobs.winding.build_up import Laid, bridged, design, rings_of
from threadline.jobs.winding.closing_patterns import Pattern
from threadline.jobs.winding.job import is_winding, job_of
from threadline.jobs.winding.layers import Winding, read_layers
from threadline.jobs.winding.sheet import sheet_of, sheet_warnings, wound_laminate
from threadline.jobs.winding.write_fiberpath import check_wind, write_wind
from threadline.laminate.deck import shell_deck
from threadline.machine import load_machine
from threadline.units import parse_number

_SHOWN = 12
_MOST_PA = 1e9


def wind(
    product: Annotated[
        Path,
        typer.Argument(help="Product file with layers, NAME.wind.toml, or FiberPath's NAME.wind."),
    ],
    every: Annotated[
        bool, typer.Option("--all", help=f"List all patterns that close, not {_SHOWN} of them.")
    ] = False,
    report: Annotated[
        Path | None, typer.Option(help="Write the sheet for the shop into this folder.")
    ] = None,
    bare: Annotated[
        Path | None,
        typer.Option(
            help="The parts are the outer shape that is wanted after all layers: write the bare "
            "mandrel for this shape into this table, NAME.csv."
        ),
    ] = None,
    deck: Annotated[
        Path | None,
        typer.Option(help="Write a shell model for CalculiX and Abaqus into this file, NAME.inp."),
    ] = None,
    pressure: Annotated[
        str | None, typer.Option(help='Internal pressure of --deck, "10 bar" (default).')
    ] = None,
    definition: Annotated[
        Path | None,
        typer.Option("--wind", help="Write the layers as a definition of FiberPath, NAME.wind."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Write the circuits of each layer as a subroutine and its passes into this "
            "program, for --machine.",
        ),
    ] = None,
    machine: Annotated[
        str | None,
        typer.Option(
            "--machine", "-m", autocompletion=completion.machines, help="Machine of --out."
        ),
    ] = None,
    dialect: Annotated[
        str | None,
        typer.Option(
            help="Dialect of --out: winder, linuxcnc, fanuc. Default: the machine file's."
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """List the patterns, lengths and thickness of a winding.

    No machine is needed.

    The command prints a table for each layer: the patterns that close with the wanted coverage, the
    nearest to a geodesic first, the pattern that is wound, and the layer's fibre length, mass and
    thickness. Then it prints the sheet for the shop, with metres, grams, time and cost, and the
    stiffness of the laminate. Exit status: 0, or 2 for wrong input.

    Example: threadline wind examples/vessel.wind.toml
    """
    inside_pa = _pressure(pressure, deck)
    check_outputs(folder=report)
    for file in (deck, bare, definition, out):
        check_outputs(file=file)
        keep_inputs(file, product)
    if not (out is None and machine is None and dialect is None):
        _check_program(product, machine, out, bare)
    winding = read_layers(product)
    if definition is not None:
        check_wind(winding)
    found = None if bare is None else bare_of(winding)
    layers = design(winding) if found is None else found.laid
    written, left_out, program = None, [], ""
    with together(bare, deck, definition, out):
        if bare is not None and found is not None:
            write_meridian(bare, found.points)
        if deck is not None:
            _write_deck(deck, winding, layers, inside_pa)
        if definition is not None:
            left_out = write_wind(definition, layers)
        if out is not None and machine is not None:
            program, warnings = _write_program(winding, layers, machine, out, dialect)
            left_out += warnings
        if report is not None:
            from threadline.report.wound import write_sheet

            written = write_sheet(winding, layers, report)
    if json:
        print_json(
            _content(winding, layers) | ({} if written is None else {"report": str(written)})
        )
        return
    for layer in layers:
        shown = layer.table if every else layer.table[:_SHOWN]
        print_table(
            f"Layer {layer.layer.number}: patterns that close, the nearest to a geodesic first",
            ("circuits/shift", "beside", "ahead", "turns", "coverage", "off a circuit", "note"),
            [_row(layer, pattern) for pattern in shown],
        )
        if len(shown) < len(layer.table):
            say(f"{len(layer.table) - len(shown)} more: --all")
    print_table(
        f"{winding.product.name}: what is wound",
        ("layer", "angle", "turns at", "pattern", "closed by", "slip tendency", "fibre", "dwells",
         "mass", "thickness", "at most"),
        [_summary(layer) for layer in layers],
    )  # fmt: skip
    sheet = sheet_of(winding, layers)
    print_table(f"{sheet.title}: the sheet", sheet.header(), sheet.table())
    say(sheet.note())
    laminate = wound_laminate(layers)
    if laminate is not None:
        print_table("Laminate at the largest radius", ("", ""), laminate.rows())
    if written is not None:
        say(f"Report: {written}")
    if found is not None:
        say(
            f"Bare mandrel: {bare}; it begins {1e3 * float(found.points[0, 0]):.3f} mm right of "
            f"the drawing, and its layers end {1e3 * found.off_m:.2g} mm beside it"
        )
    if deck is not None:
        say(f"Shell model: {deck}")
    if out is not None:
        say(f"Program: {out}: {program}")
    if definition is not None:
        say(f"FiberPath's definition: {definition}")
    for text in [*left_out, *filter(None, map(bridged, layers)), *sheet_warnings(winding, sheet)]:
        warning(text)


def _check_program(product: Path, machine: str | None, out: Path | None, bare: Path | None) -> None:
    if machine is None or out is None:
        raise OptionError(
            "--out and --machine belong together: a program is written for a machine",
            remedy="Like -m lathe-winder -o vessel.prg.",
        )
    if bare is not None or not is_winding(product):
        raise OptionError(
            "--out writes the program of a product file, NAME.wind.toml, without --bare",
            remedy="Write the product file with the mandrel that is wound, and give that.",
        )


def _write_program(
    winding: Winding, laid: tuple[Laid, ...], machine: str, out: Path, dialect: str | None
) -> tuple[str, tuple[str, ...]]:
    """Write the circuits as subroutine passes; return the file's description, and warnings."""
    chosen = load_machine(machine)
    job = job_of(winding, laid, chosen)
    return write_passes(job, chosen, out, dialect), job.warnings


def _write_deck(file: Path, winding: Winding, laid: tuple[Laid, ...], inside_pa: float) -> None:
    rings, materials = rings_of(laid)
    text = shell_deck(winding.product.name, rings, materials, inside_pa)
    with staged_file(file) as stream:
        stream.write(text.encode("ascii", "replace"))


def _pressure(text: str | None, deck: Path | None) -> float:
    """Return the internal pressure of the shell model, Pa."""
    if text is not None and deck is None:
        raise OptionError("--pressure is the load of a shell model", remedy="Add --deck NAME.inp.")
    pressure_pa = parse_number("--pressure", text or "10 bar", "Pa", "10 bar")
    if not 0.0 < pressure_pa <= _MOST_PA:
        raise OptionError(
            f"--pressure {text!r}: it must be above 0 and at most 10000 bar",
            remedy='Like --pressure "10 bar".',
        )
    return pressure_pa


def _row(laid: Laid, pattern: Pattern) -> list[str]:
    closings = [
        ("friction {:+.5f}", pattern.ratio),
        ("turning at {:.3f} mm", 1e3 * pattern.constant_m),
        ("a dwell of {:.4g} deg", math.degrees(pattern.dwell)),
    ]
    closed = " or ".join(text.format(value) for text, value in closings if not math.isnan(value))
    mark = "*" if pattern is laid.pattern else ""
    return [
        f"{pattern.circuits}/{pattern.shift}{mark}", f"{pattern.beside}",
        "leading" if pattern.leading else "lagging", f"{pattern.turns}",
        f"{pattern.coverage:.2%}", f"{math.degrees(pattern.off):+.4f} deg",
        closed and f"closed by {closed}",
    ]  # fmt: skip


def _summary(laid: Laid) -> list[str]:
    circuit, pattern = laid.circuit, laid.pattern
    mass = laid.fibre_kg
    turns = sorted({f"{1e3 * t.radius_m:.3f}" for t in (circuit.left, circuit.right)})
    most = laid.most_m
    return [
        f"{laid.layer.number} {laid.layer.kind}", f"{math.degrees(circuit.angle):.3f} deg",
        f"{' and '.join(turns)} mm", f"{pattern.circuits}/{pattern.shift}", laid.by,
        f"{laid.slip:.2%}", f"{laid.length_m:.2f} m", f"{laid.dwells_m:.2f} m",
        "-" if mass is None else f"{1e3 * mass:.1f} g",
        "-" if laid.thickness_m is None else f"{1e3 * laid.thickness_m:.3f} mm",
        "-" if most is None else f"{1e3 * most:.3f} mm",
    ]  # fmt: skip


def _content(winding: Winding, laid: tuple[Laid, ...]) -> dict[str, Any]:
    found = wound_laminate(laid)
    return {
        "product": winding.product.name,
        "layers": [
            {
                "kind": one.layer.kind,
                "line": one.layer.line,
                "angle_rad": one.circuit.angle,
                "geodesic_rad_per_circuit": one.wrap.base.advance,
                "rad_per_circuit": one.circuit.advance,
                "turns_at_m": [one.circuit.left.radius_m, one.circuit.right.radius_m],
                "circuits": one.pattern.circuits,
                "shift": one.pattern.shift,
                "closed_by": one.by,
                "friction_ratio": -one.circuit.right.ratio,
                "slip_tendency": one.slip,
                "coverage": one.pattern.coverage,
                "length_m": one.length_m,
                "dwells_m": one.dwells_m,
                "mass_kg": one.fibre_kg,
                "thickness_m": one.thickness_m,
                "largest_thickness_m": one.most_m,
                "patterns": [
                    {
                        "circuits": p.circuits, "shift": p.shift, "beside": p.beside,
                        "leading": p.leading, "turns": p.turns, "coverage": p.coverage,
                        "off_rad": p.off, "closed_by": list(p.closings),
                    }
                    for p in one.table
                ],
            }
            for one in laid
        ],
        "sheet": sheet_of(winding, laid).content(),
        "laminate": None if found is None else found.content(),
    }  # fmt: skip


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("wind")(wind)
