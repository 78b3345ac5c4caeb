"""The demands of a product on a machine, each with its range."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from threadline.errors import OptionError

_MAY_BE_ZERO = (
    "turn_rad",
    "load_damping_n_s_m",
    "motor_damping_n_m_s",
    "friction_n",
    "dwell_s",
)
_NOT_NUMBERS = ("profile",)
_BEYOND = 1e15  # squares and products of numbers up to here are finite


@dataclass(frozen=True, slots=True, kw_only=True)
class Demands:
    """What a product asks of a machine, and what is known of the drive, in SI; None if unknown.

    Parameters
    ----------
    needle_speed_hz, stitch_length_m
        Stitches a second, and the length of a stitch.
    speed_m_s
        Speed of the head of a machine that does not sew; needle speed times stitch length gives it
        for one that does.
    ramp_stitches
        Number of stitches within which the head has to reach its speed.
    placement_m, turn_rad
        Largest distance by which a corner may be missed, and the angle of the corner.
    acceleration_m_s2
        Acceleration of the head. When None, the larger one of those that the ramp and the corner
        need.
    load_mass_kg, load_damping_n_s_m, friction_n
        Mass, viscous damping and friction of the load that the motor drives.
    pulley_radius_m, gear_ratio
        ``x = radius * motor angle / ratio``. Without a ratio, the one that matches the inertia of
        the load to that of the motor is used.
    motor_inertia_kg_m2, motor_damping_n_m_s
        Inertia and damping of the rotor and all that turns with it.
    torque_constant_n_m_a, back_emf_v_s, resistance_ohm, current_limit_a
        Constants of the motor, and the limit of its amplifier.
    move_m, move_s, dwell_s, profile, ramp
        Distance and time of a repeated move from rest to rest, the pause after each, and its speed
        profile (``SpeedProfile``).
    motor_torque_n_m, torque_margin
        Peak torque of the motor, and the wanted ratio of it to the peak torque of the motion.
    encoder_lines, count_rate_limit_hz
        Lines of the encoder in a turn of the motor (four counts each), and the fastest rate of
        counts that the counter follows.

    Raises
    ------
    OptionError
        If a number is out of its range, or the speed is given twice.
    """

    needle_speed_hz: float | None = None
    stitch_length_m: float | None = None
    speed_m_s: float | None = None
    ramp_stitches: float = 2.0
    placement_m: float | None = None
    turn_rad: float = math.pi / 2.0
    acceleration_m_s2: float | None = None
    load_mass_kg: float | None = None
    load_damping_n_s_m: float = 0.0
    friction_n: float = 0.0
    pulley_radius_m: float | None = None
    gear_ratio: float | None = None
    motor_inertia_kg_m2: float | None = None
    motor_damping_n_m_s: float = 0.0
    torque_constant_n_m_a: float | None = None
    back_emf_v_s: float | None = None
    resistance_ohm: float | None = None
    current_limit_a: float | None = None
    move_m: float | None = None
    move_s: float | None = None
    dwell_s: float = 0.0
    profile: str = "trapezoidal"
    ramp: float = 1.0 / 3.0
    motor_torque_n_m: float | None = None
    torque_margin: float | None = None
    encoder_lines: float | None = None
    count_rate_limit_hz: float | None = None

    def __post_init__(self) -> None:
        for part in fields(self):
            value = getattr(self, part.name)
            if value is None or part.name in _NOT_NUMBERS:
                continue
            least = 0.0 if part.name in _MAY_BE_ZERO else math.ulp(0.0)
            if not (math.isfinite(value) and value >= least):
                raise OptionError(
                    f"{part.name} is {value!r}; it must be finite and "
                    f"{'not negative' if part.name in _MAY_BE_ZERO else 'above 0'}",
                    remedy="Check its sign and unit.",
                )
            if value and not 1.0 / _BEYOND <= value <= _BEYOND:
                raise OptionError(
                    f"{part.name} is {value!r}; no machine has one beyond 1e-15 to 1e15",
                    remedy="Check its unit.",
                )
        if self.turn_rad > math.pi:
            raise OptionError(f"turn_rad is {self.turn_rad!r}; a corner turns by at most pi")
        sewn = self.needle_speed_hz is not None and self.stitch_length_m is not None
        if sewn and self.speed_m_s is not None:
            raise OptionError(
                "the speed is given twice: by itself, and by needle speed and stitch length",
                remedy="Leave one out.",
            )
