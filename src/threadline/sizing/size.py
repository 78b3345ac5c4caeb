"""Sizing: results with their values, formulas and sources.

Formulas come from the stitcher thesis (chapter 2) and the filament winding thesis (chapter 4 and
section 6.3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from threadline.errors import OptionError
from threadline.sizing.profiles import (
    SpeedProfile,
    corner_acceleration_m_s2,
    corner_error_m,
    corner_speed_m_s,
    ramp_acceleration_m_s2,
)


@dataclass(frozen=True, slots=True)
class SizeLine:
    """One result of a sizing.

    Parameters
    ----------
    name
        Name of the result, unique within a sizing.
    value, unit
        In SI; the unit is empty for a ratio.
    formula
        Formula, with the names of demands and of earlier results.
    source
        Thesis, paper or field of the formula.
    """

    name: str
    value: float
    unit: str
    formula: str
    source: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizing:
    """The results in order, and warnings about suspicious demands."""

    lines: tuple[SizeLine, ...]
    warnings: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> SizeLine:
        """Return the line called ``name``; a KeyError lists all names."""
        for line in self.lines:
            if line.name == name:
                return line
        raise KeyError(f"no line {name!r}; there are {', '.join(x.name for x in self.lines)}")

    def __contains__(self, name: object) -> bool:
        return any(line.name == name for line in self.lines)


_MAY_BE_ZERO = ("turn_rad", "load_damping_n_s_m", "motor_damping_n_m_s", "friction_n", "dwell_s")
_NOT_NUMBERS = ("profile",)
_LARGEST = 1e15  # squares and products of numbers up to here are finite


@dataclass(frozen=True, slots=True, kw_only=True)
class Demands:
    """Demands of a product, and known data of the drive, in SI; None if unknown.

    Parameters
    ----------
    needle_speed_hz, stitch_length_m
        Stitches per second, and the length of a stitch.
    speed_m_s
        Speed of the head; on a sewing machine it follows from needle speed and stitch length.
    ramp_stitches
        Number of stitches in which the head must reach its speed.
    placement_m, turn_rad
        Largest allowed distance from a corner, and the angle of the corner.
    acceleration_m_s2
        Acceleration of the head; None: the larger of the accelerations for ramp and corner.
    load_mass_kg, load_damping_n_s_m, friction_n
        Mass, viscous damping and friction of the load.
    pulley_radius_m, gear_ratio
        ``x = radius * motor angle / ratio``. By default the ratio makes the reflected inertia of
        the load equal to the inertia of the motor.
    motor_inertia_kg_m2, motor_damping_n_m_s
        Inertia and damping of the rotor and the parts that turn with it.
    torque_constant_n_m_a, back_emf_v_s, resistance_ohm, current_limit_a
        Constants of the motor, and the limit of its amplifier.
    move_m, move_s, dwell_s, profile, ramp
        Distance and time of a repeated move from rest to rest, the pause after each, and its speed
        profile (``SpeedProfile``).
    motor_torque_n_m, torque_margin
        Peak torque of the motor, and its required ratio to the peak torque of the motion.
    encoder_lines, count_rate_limit_hz
        Lines of the encoder per turn of the motor (four counts each), and the largest count rate of
        the counter.

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
            if value and not 1.0 / _LARGEST <= value <= _LARGEST:
                raise OptionError(
                    f"{part.name} is {value!r}; it must be from 1e-15 to 1e15",
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


_STITCHER = "stitcher thesis"
_WINDER = "filament winding thesis"
_EMBROIDERY = "embroidery frame paper: servos of 6 to 10 times, of low inertia"
_MECHANICS = "mechanics"
_KT_KV_AGREE = 0.05


def size(demands: Demands) -> Sizing:
    """Return every result that can be computed from ``demands``.

    Raises
    ------
    OptionError
        If nothing can be computed, or the speed profile is unknown.
    """
    sheet = _Sheet(demands)
    sheet.product()
    sheet.drive()
    sheet.motor()
    sheet.move()
    sheet.encoder()
    if not sheet.lines:
        raise OptionError(
            "the demands are not enough for any result",
            remedy="Give needle speed and stitch length, or a load with a pulley and a motor.",
        )
    return Sizing(lines=tuple(sheet.lines), warnings=tuple(sheet.warnings))


class _Sheet:
    """The results so far, and the numbers for later results."""

    def __init__(self, demands: Demands) -> None:
        self.demands = demands
        self.lines: list[SizeLine] = []
        self.warnings: list[str] = []
        self.speed = demands.speed_m_s
        self.acceleration = demands.acceleration_m_s2
        self.ratio = demands.gear_ratio
        self.inertia: float | None = None  # at the motor, rotor and load, kg m^2
        self.damping = self.friction = 0.0  # at the motor, N m s and N m

    def add(self, name: str, value: float, unit: str, formula: str, source: str) -> float:
        self.lines.append(SizeLine(name, value, unit, formula, source))
        return value

    def product(self) -> None:
        """Speed and acceleration from stitches and corners."""
        d = self.demands
        rules = []
        if d.needle_speed_hz is not None and d.stitch_length_m is not None:
            self.speed = self.add(
                "head speed",
                d.needle_speed_hz * d.stitch_length_m,
                "m/s",
                "needle speed x stitch length",
                f"{_STITCHER}, eq 2.3",
            )
            rules.append(
                self.add(
                    "ramp acceleration",
                    ramp_acceleration_m_s2(self.speed, d.stitch_length_m, d.ramp_stitches),
                    "m/s^2",
                    f"speed^2 / ({d.ramp_stitches:g} x stitch length): at speed within "
                    f"{d.ramp_stitches:g} turns of the needle",
                    f"{_STITCHER}, chapter 2, the two-stitch rule",
                )
            )
        if self.speed is not None and d.placement_m is not None:
            rules.append(
                self.add(
                    "corner acceleration",
                    corner_acceleration_m_s2(self.speed, d.placement_m, d.turn_rad),
                    "m/s^2",
                    f"speed^2 sin(turn / 2) / (4 placement), turn {math.degrees(d.turn_rad):g} deg",
                    f"{_STITCHER}, eqs 2.4 to 2.7, for any angle",
                )
            )
        if self.acceleration is None and rules:
            self.acceleration = self.add(
                "acceleration", max(rules), "m/s^2", "the larger of the rules", _MECHANICS
            )
        if self.speed is None or self.acceleration is None:
            return
        self.add(
            "corner error",
            corner_error_m(self.speed, self.acceleration, d.turn_rad),
            "m",
            "speed^2 sin(turn / 2) / (4 acceleration)",
            f"{_STITCHER}, eqs 2.4 to 2.7, for any angle",
        )
        if d.placement_m is not None and d.turn_rad > 0.0:
            self.add(
                "corner speed",
                corner_speed_m_s(d.placement_m, self.acceleration, d.turn_rad),
                "m/s",
                "sqrt(4 acceleration placement / sin(turn / 2))",
                f"{_STITCHER}, eqs 2.4 to 2.7, for any angle",
            )

    def drive(self) -> None:
        """Gear and inertia at the motor."""
        d = self.demands
        if d.load_mass_kg is None or d.pulley_radius_m is None:
            return
        if d.motor_inertia_kg_m2 is not None:
            matched = self.add(
                "matched ratio",
                d.pulley_radius_m * math.sqrt(d.load_mass_kg / d.motor_inertia_kg_m2),
                "",
                "radius sqrt(load / rotor): load inertia at the motor = rotor inertia",
                f"{_WINDER}, sections 4.1 and 6.3",
            )
            self.ratio = self.ratio if self.ratio is not None else matched
        if self.ratio is None:
            return
        lever = d.pulley_radius_m / self.ratio  # m per rad of the motor
        reflected = self.add(
            "reflected inertia",
            d.load_mass_kg * lever**2,
            "kg*m^2",
            "load (radius / ratio)^2",
            _MECHANICS,
        )
        self.damping = d.motor_damping_n_m_s + d.load_damping_n_s_m * lever**2
        self.friction = d.friction_n * lever
        if d.motor_inertia_kg_m2 is not None:
            self.inertia = d.motor_inertia_kg_m2 + reflected
            self.add(
                "inertia ratio",
                reflected / d.motor_inertia_kg_m2,
                "",
                "reflected inertia / rotor inertia; 1 heats the motor least",
                f"{_WINDER}, sections 4.1 and 6.3",
            )
        if self.speed is not None:
            self.add("motor speed", self.speed / lever, "rad/s", "speed ratio / radius", _MECHANICS)

    def motor(self) -> None:
        """Torque, current and voltage at full speed and acceleration."""
        d = self.demands
        self._constants()
        if self.inertia is None or self.speed is None or d.pulley_radius_m is None:
            return
        assert self.ratio is not None
        per_m = self.ratio / d.pulley_radius_m
        cruise = self.add(
            "cruise torque",
            self.damping * self.speed * per_m + self.friction,
            "N*m",
            "damping at the motor x motor speed + friction",
            _MECHANICS,
        )
        peak = cruise
        if self.acceleration is not None:
            peak = self.add(
                "peak torque",
                cruise + self.inertia * self.acceleration * per_m,
                "N*m",
                "cruise torque + (rotor + reflected inertia) acceleration ratio / radius",
                _MECHANICS,
            )
        self._margin("torque margin", peak)
        if d.torque_constant_n_m_a is None:
            return
        steady_a = self.add(
            "cruise current",
            cruise / d.torque_constant_n_m_a,
            "A",
            "cruise torque / Kt",
            _MECHANICS,
        )
        peak_a = self.add(
            "peak current", peak / d.torque_constant_n_m_a, "A", "peak torque / Kt", _MECHANICS
        )
        limit = d.current_limit_a
        if limit is not None and peak_a > limit:
            self.warnings.append(
                f"the motion needs {peak_a:.3g} A, the amplifier gives {limit:.3g} A"
            )
        if limit is not None and steady_a > limit / 2.0:
            self.warnings.append(
                f"cruising alone takes {steady_a:.3g} of {limit:.3g} A: is the damping right?"
            )
        if d.back_emf_v_s is not None and d.resistance_ohm is not None:
            self.add(
                "peak voltage",
                d.back_emf_v_s * self.speed * per_m + d.resistance_ohm * peak_a,
                "V",
                "Ke motor speed + R peak current",
                _MECHANICS,
            )

    def _margin(self, name: str, needed_n_m: float) -> None:
        """Add the ratio of the motor's peak torque to the needed torque."""
        d = self.demands
        if d.motor_torque_n_m is None or needed_n_m == 0.0:
            return
        margin = self.add(
            name, d.motor_torque_n_m / needed_n_m, "", "motor torque / peak torque", _EMBROIDERY
        )
        if d.torque_margin is not None and margin < d.torque_margin:
            self.warnings.append(
                f"the motor has {margin:.3g} times the needed torque, required are "
                f"{d.torque_margin:g} times: {d.torque_margin * needed_n_m:.4g} N m"
            )

    def _constants(self) -> None:
        d = self.demands
        kt, ke, resistance = d.torque_constant_n_m_a, d.back_emf_v_s, d.resistance_ohm
        if kt is None or ke is None:
            return
        if abs(ke / kt - 1.0) > _KT_KV_AGREE:
            self.warnings.append(
                f"Kt is {kt:.4g} N m/A and Ke {ke:.4g} V s/rad, {abs(ke / kt - 1) * 100:.0f} % "
                "apart; in SI they must be equal"
            )
        if resistance is not None and d.motor_inertia_kg_m2 is not None:
            self.add(
                "mechanical time constant",
                resistance * d.motor_inertia_kg_m2 / (kt * ke),
                "s",
                "R rotor inertia / (Kt Ke)",
                f"{_WINDER}, section 6.3, KM",
            )

    def move(self) -> None:
        """A repeated move: speeds, torque and heat by profile."""
        d = self.demands
        try:  # also without a move, so that a wrong option is not ignored
            profile = SpeedProfile(name=d.profile, ramp=d.ramp)
        except ValueError as error:
            raise OptionError(str(error)) from error
        if d.move_m is None or d.move_s is None:
            return
        self.add(
            "profile efficiency",
            profile.efficiency,
            "",
            f"heat of the parabola / heat of the {d.profile} profile",
            f"{_WINDER}, section 6.3, Figure 6-3",
        )
        mean = d.move_m / d.move_s
        factor = profile.peak_speed, profile.peak_acceleration
        self.add(
            "move speed", factor[0] * mean, "m/s", f"{factor[0]:.4g} distance / time", _MECHANICS
        )
        self.add(
            "move acceleration",
            factor[1] * mean / d.move_s,
            "m/s^2",
            f"{factor[1]:.4g} distance / time^2",
            _MECHANICS,
        )
        if self.inertia is None or d.pulley_radius_m is None or self.ratio is None:
            return
        angle = d.move_m * self.ratio / d.pulley_radius_m
        load = (self.inertia, self.damping, self.friction)
        peak = self.add(
            "move peak torque",
            profile.peak_torque(angle, d.move_s, *load),
            "N*m",
            "largest of inertia x acceleration + damping x speed + friction",
            _MECHANICS,
        )
        rms = self.add(
            "move rms torque",
            profile.rms_torque(angle, d.move_s, *load, dwell_s=d.dwell_s),
            "N*m",
            "root mean square over the move and the dwell",
            f"{_WINDER}, section 6.3 (heat goes with its square)",
        )
        self._margin("move torque margin", peak)
        if d.torque_constant_n_m_a is not None:
            for name, torque in (("move peak current", peak), ("move rms current", rms)):
                self.add(name, torque / d.torque_constant_n_m_a, "A", "torque / Kt", _MECHANICS)

    def encoder(self) -> None:
        """Resolution at the load, and the rate of counts."""
        d = self.demands
        if d.encoder_lines is None or d.pulley_radius_m is None or self.ratio is None:
            return
        per_m = self.add(
            "encoder resolution",
            4.0 * d.encoder_lines * self.ratio / (2.0 * math.pi * d.pulley_radius_m),
            "count/m",
            "4 lines ratio / (2 pi radius)",
            f"{_WINDER}, sections 4.4 and 6.5",
        )
        if d.placement_m is not None:
            self.add(
                "counts in the placement", per_m * d.placement_m, "count", "resolution x placement",
                _MECHANICS,
            )  # fmt: skip
        if self.speed is None:
            return
        rate = self.add(
            "count rate", per_m * self.speed, "count/s", "resolution x speed", _MECHANICS
        )
        if d.count_rate_limit_hz is not None and rate > d.count_rate_limit_hz:
            self.warnings.append(
                f"{rate:.4g} counts/s at speed; the counter follows {d.count_rate_limit_hz:.4g}"
            )
