"""``threadline size``: gear, motor and encoder from the demands of the product."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from threadline.cli.arguments import JsonOption, ratio
from threadline.cli.messages import warning
from threadline.cli.output import print_json, print_table
from threadline.sizing import PROFILES, Demands, Sizing
from threadline.sizing import size as size_demands
from threadline.units import parse_number

_EXAMPLES = {"m": "0.1 in", "s": "50 ms", "rad": "90 deg", "kg*m^2": "4.75 kg cm^2"}


def _quantity(help_text: str) -> Any:
    return typer.Option(help=help_text)


def size(
    needle_speed: Annotated[str | None, _quantity('Stitches a second: "75 stitch/s".')] = None,
    stitch_length: Annotated[str | None, _quantity('"0.1 in".')] = None,
    speed: Annotated[
        str | None, _quantity('Speed of the head if nothing is stitched: "7.5 in/s".')
    ] = None,
    ramp_stitches: Annotated[
        float, _quantity("Stitches within which the head has to be at speed.")
    ] = 2.0,
    placement: Annotated[str | None, _quantity('Corner error allowed: "0.5 mm".')] = None,
    turn: Annotated[str, _quantity("Angle by which the seam turns in the corner.")] = "90 deg",
    acceleration: Annotated[
        str | None,
        _quantity('Acceleration; default: from the two rules, "546 in/s^2".'),
    ] = None,
    load_mass: Annotated[str | None, _quantity('Mass that the motor drives: "111 kg".')] = None,
    load_damping: Annotated[str, _quantity("Damping of the load to the ground.")] = "0 N s/m",
    friction: Annotated[str, _quantity("Coulomb friction of the load.")] = "0 N",
    pulley_radius: Annotated[str | None, _quantity('Radius of the drive pulley: "29 mm".')] = None,
    gear_ratio: Annotated[
        float | None, _quantity("Motor turns per pulley turn; default: the matched ratio.")
    ] = None,
    motor_inertia: Annotated[
        str | None, _quantity('Inertia of the rotor and all parts on its shaft: "4.75 kg cm^2".')
    ] = None,
    motor_damping: Annotated[str, _quantity("Viscous damping of the motor.")] = "0 N m s/rad",
    torque_constant: Annotated[str | None, _quantity('"0.5 N m/A".')] = None,
    back_emf: Annotated[str | None, _quantity('"60 V/krpm".')] = None,
    resistance: Annotated[str | None, _quantity('"0.8 ohm".')] = None,
    current_limit: Annotated[
        str | None, _quantity('Current limit of the amplifier: "27 A".')
    ] = None,
    motor_torque: Annotated[str | None, _quantity('Peak torque of the motor: "38 N m".')] = None,
    torque_margin: Annotated[
        float | None,
        _quantity("Motor torque over the torque of the motion; 6 to 10 for step tables."),
    ] = None,
    move: Annotated[str | None, _quantity('Distance of a repeated move: "50 mm".')] = None,
    move_time: Annotated[str | None, _quantity('Duration of --move: "80 ms".')] = None,
    dwell: Annotated[str, _quantity("Pause after each --move.")] = "0 s",
    profile: Annotated[str, _quantity(", ".join(PROFILES) + ".")] = "trapezoidal",
    ramp: Annotated[
        float,
        typer.Option(
            parser=ratio("--ramp"),
            help="Share of the move's time in which a trapezoid accelerates.",
        ),
    ] = 1.0 / 3.0,
    encoder_lines: Annotated[
        float | None, _quantity("Encoder lines per motor turn; four counts each.")
    ] = None,
    count_rate: Annotated[
        str | None, _quantity('Highest rate of the counter: "1e6 count/s".')
    ] = None,
    json: JsonOption = False,
) -> None:
    """Size a machine: speed, acceleration, gear, motor and encoder from the product's demands.

    Every line has its formula and source; a line is left out if one of its values is missing.
    Exit status: 0, or 2 for wrong input.

    Example: threadline size --needle-speed "75 stitch/s" --stitch-length "0.1 in"
    --placement "0.02 in"
    """

    def si(text: str, unit: str, option: str) -> float:
        return parse_number(option, text, unit, _EXAMPLES.get(unit, f"1 {unit}"))

    def maybe(text: str | None, unit: str, option: str) -> float | None:
        return None if text is None else si(text, unit, option)

    sizing = size_demands(
        Demands(
            needle_speed_hz=maybe(needle_speed, "stitch/s", "--needle-speed"),
            stitch_length_m=maybe(stitch_length, "m", "--stitch-length"),
            speed_m_s=maybe(speed, "m/s", "--speed"),
            ramp_stitches=ramp_stitches,
            placement_m=maybe(placement, "m", "--placement"),
            turn_rad=si(turn, "rad", "--turn"),
            acceleration_m_s2=maybe(acceleration, "m/s^2", "--acceleration"),
            load_mass_kg=maybe(load_mass, "kg", "--load-mass"),
            load_damping_n_s_m=si(load_damping, "N*s/m", "--load-damping"),
            friction_n=si(friction, "N", "--friction"),
            pulley_radius_m=maybe(pulley_radius, "m", "--pulley-radius"),
            gear_ratio=gear_ratio,
            motor_inertia_kg_m2=maybe(motor_inertia, "kg*m^2", "--motor-inertia"),
            motor_damping_n_m_s=si(motor_damping, "N*m*s/rad", "--motor-damping"),
            torque_constant_n_m_a=maybe(torque_constant, "N*m/A", "--torque-constant"),
            back_emf_v_s=maybe(back_emf, "V*s/rad", "--back-emf"),
            resistance_ohm=maybe(resistance, "ohm", "--resistance"),
            current_limit_a=maybe(current_limit, "A", "--current-limit"),
            motor_torque_n_m=maybe(motor_torque, "N*m", "--motor-torque"),
            torque_margin=torque_margin,
            move_m=maybe(move, "m", "--move"),
            move_s=maybe(move_time, "s", "--move-time"),
            dwell_s=si(dwell, "s", "--dwell"),
            profile=profile,
            ramp=ramp,
            encoder_lines=encoder_lines,
            count_rate_limit_hz=maybe(count_rate, "count/s", "--count-rate"),
        )
    )
    if json:
        print_json(_content(sizing))
        return
    for text in sizing.warnings:
        warning(text)
    rows = [
        [line.name, f"{line.value:.5g} {line.unit}".rstrip(), f"{line.formula} ({line.source})"]
        for line in sizing.lines
    ]
    print_table("From the product to the machine", ["quantity", "value", "note"], rows)


def _content(sizing: Sizing) -> dict[str, Any]:
    return {
        "lines": [
            {
                "name": line.name,
                "value": line.value,
                "unit": line.unit,
                "formula": line.formula,
                "source": line.source,
            }
            for line in sizing.lines
        ],
        "warnings": list(sizing.warnings),
    }


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("size")(size)
