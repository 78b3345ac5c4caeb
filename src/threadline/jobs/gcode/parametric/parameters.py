"""The parameters of a running program: numbered, local and global ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from threadline.errors import JobError, Place
from threadline.jobs.gcode.dialects import Flavour

ARGUMENTS = 30
"""Number of a subroutine's own parameters, #1 to #30."""
MAX_DEPTH = 9
"""Deepest nesting of calls that LinuxCNC allows."""
_LAST_OWN = 5000
_POSITION = 5420
_AXES = "XYZABCUVW"
_POSITIONS = frozenset(f"_{letter.lower()}" for letter in _AXES)
_LAST = 5601
_UNKNOWN_VALUE = "only the control knows what it keeps there (offsets, tools, probes, inputs)"
_OF_CONTROL = frozenset(
    f"_{name}"
    for name in """
    line motion_mode plane ccomp metric imperial absolute incremental inverse_time units_per_minute
    units_per_rev coord_system tool_offset retract_r_plane retract_old_z spindle_rpm_mode
    spindle_css_mode ijk_absolute_mode lathe_diameter_mode lathe_radius_mode spindle_on spindle_cw
    spindle_m mist flood speed_override feed_override adaptive_feed feed_hold feed rpm current_tool
    selected_pocket current_pocket selected_tool task remap_level x y z a b c u v w abs_x abs_y
    abs_z abs_a abs_b abs_c abs_u abs_v abs_w vmajor vminor
    """.split()  # noqa: SIM905 - a table of words
)
_REMEDY = "Have the program written with numbers alone."
_IN_PROGRAM = "Set it in the program, or have the program written with numbers alone."


@dataclass(slots=True)
class _Frame:
    """An open call: its local names, and the values of #1 to #30 before the call."""

    names: dict[str, float] = field(default_factory=dict)
    saved: dict[int, float] = field(default_factory=dict)


@dataclass(slots=True)
class Values:
    """The parameters of one run.

    Parameters
    ----------
    flavour
        Rules of the control for parameters.
    predefined
        Function that returns the value of a predefined name, None for an unknown name. The names
        ``_x`` to ``_w`` give the present position in the units of the program.

    Attributes
    ----------
    unset
        First line that reads each numbered parameter before it is set.
    doubtful
        First line that compares numbers so close that versions of the control give different
        results; 0 without one.
    """

    flavour: Flavour
    predefined: Callable[[str], float | None]
    unset: dict[int, int] = field(default_factory=dict)
    doubtful: int = 0
    _numbers: dict[int, float] = field(default_factory=dict)
    _globals: dict[str, float] = field(default_factory=dict)
    _frames: list[_Frame] = field(default_factory=lambda: [_Frame()])
    _returned: float | None = None

    @property
    def depth(self) -> int:
        """Number of open calls."""
        return len(self._frames) - 1

    def number(self, which: int, at: Place) -> float:
        """Return the value of a numbered parameter.

        Raises
        ------
        JobError
            If the parameter does not exist, is not set, is one that the control never reads, or
            only the control knows its value.
        """
        if 1 <= which < self.flavour.readable:
            raise JobError(
                f"parameter #{which} is set and never read by fluidnc, which keeps "
                f"#{self.flavour.readable} to #{_LAST_OWN} for programs",
                place=at,
                remedy=f"Take a number from #{self.flavour.readable} on, or a name like #<depth>.",
            )
        if which in self._numbers:
            return self._numbers[which]
        if _POSITION <= which < _POSITION + len(_AXES):
            self._refuse_position(f"#{which}", at)
            value = self.predefined(f"_{_AXES[which - _POSITION].lower()}")
            if value is not None:
                return value
        if not 1 <= which <= _LAST:
            raise JobError(
                f"there is no parameter #{which}",
                place=at,
                remedy=f"They have numbers from 1 to {_LAST}.",
            )
        if which > _LAST_OWN:
            raise JobError(f"parameter #{which}: {_UNKNOWN_VALUE}", place=at, remedy=_IN_PROGRAM)
        if self.flavour.unset is None:
            raise JobError(
                f"parameter #{which} is read before it is set", place=at, remedy=_IN_PROGRAM
            )
        if which > ARGUMENTS:
            self.unset.setdefault(which, at.line)
        return self.flavour.unset

    def set_number(self, which: int, value: float, at: Place) -> None:
        """Set a numbered parameter.

        Raises
        ------
        JobError
            If the number is not one of the program's own parameters.
        """
        if not 1 <= which <= _LAST_OWN:
            raise JobError(
                f"parameter #{which} is not one of the program's own",
                place=at,
                remedy=f"Set those from 1 to {_LAST_OWN}; others move zeros, or belong to the "
                "control.",
            )
        self._numbers[which] = value

    def named(self, name: str, at: Place) -> float:
        """Return the value of a named parameter; a name with a leading underscore is global.

        Raises
        ------
        JobError
            If the parameter was not set, only the control knows its value, or it is an item of the
            control's configuration.
        """
        if name in _POSITIONS:
            self._refuse_position(f"#<{name}>", at)
        self._refuse_configuration(name, at)
        value = self._find(name)
        if value is None and name in _OF_CONTROL:
            raise JobError(f"parameter #<{name}>: {_UNKNOWN_VALUE}", place=at, remedy=_REMEDY)
        if value is None:
            raise JobError(
                f"the parameter #<{name[:40]}> is read before it is set",
                place=at,
                remedy="Set it in the program.",
            )
        return value

    def exists(self, name: str, at: Place) -> bool:
        """Say whether a named parameter was set.

        Raises
        ------
        JobError
            If the name is an item of the control's configuration.
        """
        self._refuse_configuration(name, at)
        return name in _OF_CONTROL or self._find(name) is not None

    def has_number(self, which: int) -> bool:
        """Say whether the numbered parameter ``which`` exists."""
        return 1 <= which <= _LAST

    def set_named(self, name: str, value: float, at: Place) -> None:
        """Set a named parameter.

        Raises
        ------
        JobError
            If the control sets this parameter, or it is an item of the control's configuration.
        """
        self._refuse_configuration(name, at)
        if name in _OF_CONTROL or (name[:1] == "_" and self._predefined(name) is not None):
            raise JobError(
                f"the control sets #<{name}>, and no program does",
                place=at,
                remedy="Choose another name.",
            )
        (self._globals if name[:1] == "_" else self._frames[-1].names)[name] = value

    def _refuse_position(self, written: str, at: Place) -> None:
        """Refuse a position parameter if the control reads the motors while it parses the line."""
        if not self.flavour.at_motors:
            return
        raise JobError(
            f"parameter {written} is where the motors are at the instant at which fluidnc reads "
            "the line, somewhere in the moves before it",
            place=at,
            remedy="Keep the position in a parameter of the program, like #<_at_x> = 20.",
        )

    def _refuse_configuration(self, name: str, at: Place) -> None:
        """Refuse a name that is an item of the control's configuration (a path)."""
        if name[:1] == "/" and self.flavour.paths_configure:
            raise JobError(
                f"#<{name[:40]}> is an item of the control's configuration (its steps, limits and "
                "pins)",
                place=at,
                remedy="Set it in the configuration and not in the program.",
            )

    def _find(self, name: str) -> float | None:
        if name[:1] != "_":
            return self._frames[-1].names.get(name)
        value = self._globals.get(name)
        return self._predefined(name) if value is None else value

    def _predefined(self, name: str) -> float | None:
        if self.flavour.subroutines:
            if name == "_value":
                return self._returned or 0.0
            if name == "_value_returned":
                return float(self._returned is not None)
            if name == "_call_level":
                return float(self.depth)
        return self.predefined(name)

    def enter(self, arguments: list[float], at: Place) -> None:
        """Begin a call: set #1 to #30 to the arguments, and to 0 without an argument.

        Raises
        ------
        JobError
            If calls are nested too deeply.
        """
        if self.depth >= MAX_DEPTH:
            raise JobError(
                f"calls are nested more than {MAX_DEPTH} deep",
                place=at,
                remedy="LinuxCNC refuses it, too.",
            )
        argument_numbers = range(1, ARGUMENTS + 1)
        saved = {k: self._numbers[k] for k in argument_numbers if k in self._numbers}
        self._frames.append(_Frame({}, saved))
        for k in argument_numbers:
            self._numbers[k] = arguments[k - 1] if k <= len(arguments) else 0.0

    def leave(self, returned: float | None) -> None:
        """End a call and keep its returned value."""
        frame = self._frames.pop()
        for k in range(1, ARGUMENTS + 1):
            self._numbers.pop(k, None)
        self._numbers.update(frame.saved)
        self._returned = returned
