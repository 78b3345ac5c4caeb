"""Names for PLC programs: letters, digits and single underscores, and no word of the language."""

from __future__ import annotations

import re
from collections.abc import Iterable

_WORDS = """
abs absolute_time acos action add and any any_bit any_date any_derived any_elementary any_int
any_magnitude any_num any_real any_string array asin at atan bool by byte cal calc calcn call
case char class concat configuration constant continue cos ct ctd ctu ctud date date_and_time
delete dint div do dt dword else elsif en end_action end_case end_class end_configuration end_for
end_function end_function_block end_if end_interface end_method end_namespace end_program
end_repeat end_resource end_step end_struct end_transition end_type end_var end_while eno eq exit
exp expt extends f_edge f_trig false final find for from function function_block ge gt if
implements in initial_step insert int interface internal interval jmp jmpc jmpcn ld ldate
ldate_and_time ldn ldt le left len limit lint ln log lreal lt ltime ltime_of_day ltod lword max
method mid min mod move mul mux namespace ne neg non_retain not null of on or orn overlap override
pou pointer priority private program protected public r r1 r_edge r_trig read_only read_write real
ref ref_to reference repeat replace resource ret retain retc retcn return right rol ror rs rtc s
s1 sel sema shl shr sin single sint sqrt sr st step stn string struct sub super t tan task then
this time time_of_day to tod tof ton tp transition true trunc type udint uint ulint until ups
using usint var var_access var_config var_external var_global var_in_out var_input var_output
var_temp wchar while with word wstring xor xorn andn clk cu cv cd pv q qd qu et pt
"""
RESERVED = frozenset(_WORDS.split())
"""Keywords, types, standard functions and blocks and their pins, in lower case."""
_MAX_LENGTH = 30


class Names:
    """Hands out names of one program: valid, and each once, whatever their case.

    Parameters
    ----------
    taken
        Names that the program uses already.
    """

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = {name.lower() for name in taken}

    def give(self, wanted: str) -> str:
        """Return a valid name as near to ``wanted`` as can be.

        >>> names = Names()
        >>> names.give("step"), names.give("x-low"), names.give("X_low"), names.give("2nd__try")
        ('step_signal', 'x_low', 'X_low_2', 'n2nd_try')
        """
        name = re.sub(r"[^A-Za-z0-9]+", "_", wanted).strip("_") or "unnamed"
        name = name[:_MAX_LENGTH].rstrip("_")
        if name[0].isdigit():
            name = f"n{name}"
        if name.lower() in RESERVED:
            name = f"{name}_signal"
        unique, count = name, 1
        while unique.lower() in self._taken or unique.lower() in RESERVED:
            count += 1
            unique = f"{name}_{count}"
        self._taken.add(unique.lower())
        return unique
