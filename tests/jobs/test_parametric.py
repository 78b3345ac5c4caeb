"""Parameters, expressions and O words, compared with LinuxCNC's interpreter and FluidNC's tests.

LinuxCNC 2.9's ``rs274 -g`` printed the places of ``PROGRAMS`` and the numbers of ``EXPRESSIONS``;
those of ``FLUIDNC`` stand in FluidNC's ExpressionParserTest.cpp.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from tests.jobs.in_dialects import millimetres, read
from tests.jobs.made_machines import made_machine
from threadline.errors import InputError
from threadline.jobs import Dwell
from threadline.jobs.gcode.parametric import course
from threadline.jobs.gcode.parametric import program as survey
from threadline.machine import Machine

OFFSETS = """[programs]
dialect = "linuxcnc"
[programs.offsets]
G54 = { X = "100 mm exact, assumed" }
G55 = { X = "130 mm exact, assumed" }
"""


@pytest.fixture(scope="module")
def xyza(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("xyza"), "XYZ", "A")


PROGRAMS = {
    "repeat [2.5]": ("o1 repeat [2.5]\n#1=[#1+1]\nG0 X#1\no1 endrepeat", [(1, 0, 0), (2, 0, 0)]),
    "set together": ("#1=2\nG0 X#1 #1=7 #2=[#1*3]\nG0 X#1 Y#2", [(2, 0, 0), (7, 6, 0)]),
    "names": (
        "#<a>=1\n#<_g>=2\no<s t> sub\n#<a>=5\n#<_g>=[#1+#3]\nG0 X#<a> Y#<_g>\n"
        "o<s t> endsub [#<a>*2]\no<ST> call [7] [8]\nG0 X#<A> Y#<_G> Z#<_value>",
        [(5, 7, 0), (1, 7, 10)],
    ),
    "arguments": (
        "#1=11\no9 sub\nG0 X#1 Y#2\no9 endsub\no9 call [#1+1]\nG0 X#1 Y#<_value_returned>",
        [(12, 0, 0), (11, 0, 0)],
    ),
    "sub behind M2": (
        "o[1+1] call\nG0 X7\nM2\no2 sub\nG0 X4\no2 return [3]\nG0 X5\no2 endsub",
        [(4, 0, 0), (7, 0, 0)],
    ),
    "elseif": (
        "o1 while [#1 LT 4]\n#1=[#1+1]\no2 if [#1 EQ 1]\nG0 X1\no2 elseif [#1 EQ 2]\nG0 Y2\n"
        "o2 else\nG0 Z#1\no2 endif\no1 endwhile",
        [(1, 0, 0), (1, 2, 0), (1, 2, 3), (1, 2, 4)],
    ),
    "continue": (
        "o1 do\n#1=[#1+1]\no2 if [#1 EQ 2]\no1 continue\no2 endif\nG0 X#1\no1 while [#1 LT 4]",
        [(1, 0, 0), (3, 0, 0), (4, 0, 0)],
    ),
    "break ends the next do": (
        "o1 while [#1 LT 5]\n#1=[#1+1]\no1 break\no1 endwhile\no2 do\n#2=[#2+1]\nG0 X#2\n"
        "o2 while [#2 LT 4]\no3 do\n#3=[#3+1]\nG0 Y#3\no3 while [#3 LT 3]",
        [(1, 0, 0), (1, 1, 0), (1, 2, 0), (1, 3, 0)],
    ),
    "so does one passed by": (
        "o1 while [#1 LT 1]\n#1=[#1+1]\no9 if [0]\no1 break\no9 endif\no1 endwhile\n"
        "o2 do\n#2=[#2+1]\nG0 X#2\no2 while [#2 LT 4]",
        [(1, 0, 0)],
    ),
    "continue of a do begins the next repeat anew": (
        "o1 do\n#1=[#1+1]\no2 if [#1 EQ 1]\no1 continue\no2 endif\no1 while [#1 LT 2]\n"
        "o3 repeat [2]\n#3=[#3+1]\nG0 X#3\no3 endrepeat",
        [(1, 0, 0), (2, 0, 0), (3, 0, 0), (4, 0, 0)],
    ),
    "position in inches": (
        "G20\nG0 X1 A10\nG0 Y[#5420*2] Z#<_metric>\nG91\nG0 X#5423",
        [(25.4, 0, 0), (25.4, 50.8, 0), (279.4, 50.8, 0)],
    ),
    "position with G92": ("G92 X5\nG0 X7\nG0 Y[#<_x>+#5420]", [(2, 0, 0), (2, 14, 0)]),
    "words": ("G[0.2*5] F[60*2] X[1/4]\nG#9 X2\nM[1+1]", [(0.25, 0, 0), (2, 0, 0)]),
    "recursive": (
        "o1 sub\nG0 X#1\no2 if [#1 GT 0]\no1 call [#1-1]\no2 endif\nG0 Y#1\no1 endsub\no1 call [2]",
        [(2, 0, 0), (1, 0, 0), (0, 0, 0), (0, 0, 0), (0, 1, 0), (0, 2, 0)],
    ),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_go_where_linuxcnc_goes(tmp_path: Path, xyza: Machine, name: str) -> None:
    text, places = PROGRAMS[name]
    job = read(tmp_path, xyza, f"{text}\nM2\n", "linuxcnc")
    for _ in range(2):  # the job can be read again
        assert [p[:3] for p in millimetres(job)] == [pytest.approx(p, abs=1e-9) for p in places]


EXPRESSIONS = """
[2*SIN[30]] 1 [FIX[2*SIN[30]]] 1 [FUP[10*COS[60]]] 5 [2**3**2] 64 [-7MOD3] 2 [1OR1AND0] 0
[1XOR1OR1] 1 [-2**2] 4 [--5] 5 [ATAN[-1]/[-1]] -135 [ROUND[-2.5]] -3 [FIX[-2.5]] -3
[FUP[-2.5]] -2 [ABS[-3]] 3 [ACOS[0.5]] 60 [ASIN[-1]] -90 [EXP[1]] 2.7183 [LN[10]] 2.3026
[SQRT[2]] 1.4142 [TAN[45]] 1 [2+3*4**2/8-1] 7 [1EQ1.00005] 1 [1EQ1.0002] 0 [3GE3] 1
[0.1+0.2LE0.3] 0 [2LT3AND4GT3] 1 [7MOD-2] 1 [EXISTS[#<a>]] 0 [EXISTS[#9]] 1 [##1] 9 [#[1+1]] 9
[-#2] -9 [-[3]] -3 [+.5-.25] 0.25 [4NE4] 0 -#2 -9 SIN[90] 1 #[##1-7] 9
""".split()  # noqa: SIM905 - a table of words
FLUIDNC = """
[2+3] 5 [2*3+4] 10 -[2+3] -5 +[2+3] 5 [2**3] 8 -[2**3] -8 [ABS[-5]] 5 [SQRT[16]] 4
[ROUND[3.7]] 4 [-ABS[-5]] -5 --[7] 7 -+[5] -5 [2+3*4-5] 9 -[2+3*4] -14 -#101 -42.5 --#101 42.5
""".split()  # noqa: SIM905 - a table of words


def _values(folder: Path, machine: Machine, dialect: str, table: list[str]) -> list[float]:
    lines = "".join(f"G0 X{one}\n" for one in table[::2])
    job = read(folder, machine, f"#1=2 #2=9 #101=42.5\n{lines}M2\n", dialect)
    return [p[0] for p in millimetres(job)]


def test_expressions_have_the_values_that_linuxcnc_prints(tmp_path: Path, xyza: Machine) -> None:
    found = _values(tmp_path, xyza, "linuxcnc", EXPRESSIONS)
    assert found == [pytest.approx(float(v), abs=5.1e-5) for v in EXPRESSIONS[1::2]]


def test_expressions_have_the_values_of_fluidnc(tmp_path: Path, xyza: Machine) -> None:
    """Its numbers are of single precision."""
    found = _values(tmp_path, xyza, "fluidnc", FLUIDNC)
    assert found == [pytest.approx(float(v), rel=1e-6) for v in FLUIDNC[1::2]]
    third = _values(tmp_path, xyza, "fluidnc", ["[1/3]", ""])[0]
    assert third != 1 / 3 and third == pytest.approx(1 / 3, rel=1e-7)


def test_fluidnc_rounds_within_its_functions(tmp_path: Path, xyza: Machine) -> None:
    """An angle in rad has single precision: the sine of 1 degree and back is a little above 1.

    The same comes from its own compiled ``Expression.cpp`` (``test_controls_themselves.py``).
    """
    found = _values(tmp_path, xyza, "fluidnc", ["[ASIN[SIN[1]]EQ1]", "", "[ASIN[SIN[1]]-1]", ""])
    assert found == [1, 0]
    table = ["[COS[90]*10**8]", "", "[1-ASIN[SIN[5GE1]]AND3]", ""]
    assert _values(tmp_path, xyza, "fluidnc", table) == [pytest.approx(-4.3711388), 0]


def test_fluidnc_breaks_repeats_and_uses_labels_again(tmp_path: Path, xyza: Machine) -> None:
    """FluidNC's own examples/gcode_conditionals_test.nc does so; all its 59 tests pass here."""
    text = (
        "#101=0 (a) )\no9 repeat [5] ; (a\no7 if [#101 EQ 2]\no9 break\no7 endif\n"
        "#101=[#101+1]\nG0 X#101\no9 endrepeat\no7 if [EXISTS[_what] EQ 0]\nG0 Y1\no7 endif\n"
        "o8 do\n#101=[#101+1]\nG0 X#101 (open\no8 while [#101 LT 4]\no1 repeat [0.5]\nG0 Z1\n"
        "o1 endrepeat\n"
    )
    places = [p[:3] for p in millimetres(read(tmp_path, xyza, text, "fluidnc"))]
    assert places == [(1, 0, 0), (2, 0, 0), (2, 1, 0), (3, 1, 0), (4, 1, 0), (4, 1, 1)]


def test_fluidnc_begins_a_repeat_anew_that_a_continue_has_left(
    tmp_path: Path, xyza: Machine
) -> None:
    text = (
        "#31=0\no1 while [#31 LT 2]\n#31=[#31+1]\no2 repeat [2]\nG0 X#31\no3 if [#31 EQ 1]\n"
        "o1 continue\no3 endif\nG0 Y[#31]\no2 endrepeat\no1 endwhile\n"
    )
    places = [p[:2] for p in millimetres(read(tmp_path, xyza, text, "fluidnc"))]
    assert places == [(1, 0), (2, 0), (2, 2), (2, 2), (2, 2)]


def test_a_winding_program_is_what_it_stands_for(tmp_path: Path, xyza: Machine) -> None:
    """Circuits by parameters: the same moves and feeds as in the plain text."""
    short = (
        "%\n(tube) #<turn>=[360/4] F[#<speed>*60] ; winding\n#<_x0>=1.25\nG21 G90 M3 S5\n"
        "o100 repeat [3]\nG91\nG1 X[#<_x0>*2] A#<turn> ; layer=3\nG4 P[1/2]\nG1 X-[#<_x0>*2]\n"
        "G90\no100 endrepeat\nG2 X5 Y0 I[5/2] J0\nM5\nM2\n%\n"
    )
    short = short.replace("%\n", "%\n#<speed>=10\n", 1)
    plain = (
        "F600\nG21 G90 M3 S5\n"
        + "G91\nG1 X2.5 A90 ; layer=3\nG4 P.5\nG1 X-2.5\nG90\n" * 3
        + "G2 X5 Y0 I2.5 J0\nM5\nM2\n"
    )
    ours, other = (
        read(tmp_path, xyza, text, "linuxcnc", f"{k}.ngc") for k, text in enumerate((short, plain))
    )

    def what(job):
        return [
            (type(o), getattr(o, "target", 0), getattr(o, "feed", 0), dict(getattr(o, "tags", {})))
            for o in job
        ]

    assert what(ours) == what(other)
    assert sum(isinstance(o, Dwell) for o in ours) == 3
    assert what(pickle.loads(pickle.dumps(ours))) == what(other)
    assert any("S (line 5)" in warning for warning in ours.warnings)


def test_program_that_depends_on_the_state_of_the_control_gives_a_warning(
    tmp_path: Path, xyza: Machine
) -> None:
    """A number kept from an earlier program, and one that versions compare differently."""
    job = read(tmp_path, xyza, "G0 X#40 Y#41\no1 if [0.1+0.2 LE 0.3]\no1 endif\nM2\n", "linuxcnc")
    assert any("a.nc:1: parameters" in w and "(#40 #41)" in w for w in job.warnings)
    assert any("a.nc:2: the compared numbers differ only by rounding" in w for w in job.warnings)
    assert not read(tmp_path, xyza, "#40=1\nG0 X#40\nM2\n", "linuxcnc").warnings


def test_position_parameter_follows_coordinate_systems(tmp_path: Path) -> None:
    machine = made_machine(tmp_path, "X", "", OFFSETS)
    text = "G54 G0 X5\nG55\nG0 X[#5420+1]\nM2\n"
    assert [p[0] for p in _places(read(tmp_path, machine, text, None))] == [5, 6]


def _places(job):
    return [tuple(round(1e3 * p, 9) for p in o.target) for o in job if hasattr(o, "target")]


REFUSED = [
    ("o1 if [1]", "if 1 has no end"),
    ("/#1=2", "run or left out by a switch of the control"),
    ("o1 endif", "endif 1 has no if of that label before it"),
    ("o1 while [1]\no2 if [1]\no1 endwhile\no2 endif", "which stands in if 2"),
    ("o1 if [1]\no1 else\no1 elseif [1]\no1 endif", "elseif stands behind else"),
    (
        "o1 if [1]\no1 endif\no1 if [1]\no1 endif",
        "the label 1 names a block twice, first on line 2",
    ),
    ("o1 sub\no1 endsub\no1 sub\no1 endsub", "sub 1 is defined twice, first on line 2"),
    ("o1 if [1]\no2 sub\no2 endsub\no1 endif", "a subroutine begins inside another block"),
    ("o1 repeat [2]\no1 break\no1 endrepeat", "LinuxCNC has no break of a repeat"),
    ("o1 break", "break 1 stands in no loop of that label"),
    ("o1 return", "return stands outside of a subroutine"),
    ("o<wind> call", "sub wind is not in this file. It has none."),
    ("o5 call [1] 2", "an expression in [ ] is missing"),
    ("o1 sub\no1 call\no1 endsub\no1 call", "calls are nested more than 9 deep"),
    ("o1 if [1] G0 X1\no1 endif", "something stands behind if"),
    ("o1 else G0 X1", "stands behind else"),
    ("#1=1\no1 what", "is no O word"),
    ("o100\n#1=1", "begins with its number"),
    ("#1=1\nM98 P2", "M98 and M99 do not go with O words"),
    ("#1", "= is missing"),
    ("#0=1", "parameter #0 is not one of the program's own"),
    ("#5221=1", "parameter #5221 is not one"),
    ("#1.5=1", "1.5 must be a whole number here"),
    ("#<_x>=1", "the control sets #<_x>, and no program does"),
    ("#<_rpm>=1", "the control sets #<_rpm>, and no program does"),
    ("G0 X#<_abs_x>", "parameter #<_abs_x>: only the control knows"),
    ("G0 X#<a>", "#<a> is read before it is set"),
    ("G0 X#5061", "parameter #5061: only the control knows"),
    ("G0 X#6000", "there is no parameter #6000"),
    ("G0 X[1/0]", "1 / 0 has no value"),
    ("G0 X[9**9**9**9]", "has no value"),
    ("G0 X[[0-8]**0.5]", "has no value"),
    ("G0 X[SQRT[-1]]", "SQRT[-1] has no value"),
    ("G0 X[ACOS[2]]", "ACOS[2] has no value"),
    ("G0 X[1+]", "a number, a parameter or an expression is missing, at ']'"),
    ("G0 X[1", "an operator or ] is missing, at 'the end of the line'"),
    ("G0 X[1 2 3]]", "a letter is missing, at ']'"),
    ("G0 X" + "[" * 40 + "1" + "]" * 40, "nested more than 30 deep"),
    ("G0 X[" + "1+" * 130 + "1]", "the line has 267 characters; linuxcnc takes 252"),
    ("G0 X[FOO[1]]", "is missing, at 'foo[1]]'"),
    ("G[1/3] X1", "unknown word G0.3333"),
    ("o1 repeat [1e9]\no1 endrepeat", "an operator or ] is missing, at 'e9]'"),
    ("o1 repeat [9999999999]\no1 endrepeat", "is beyond 10^9"),
    ("X#1 (no motion)", "axis words before any G0 or G1"),
    ("%\n#1=1\n%\n#2=2", "a block after the % that ends the file is never run"),
    ("G0 Xé#1", "this is not part of this dialect"),
]


@pytest.mark.parametrize(("text", "message"), REFUSED)
def test_malformed_expression_or_flow_control_is_refused(
    tmp_path: Path, xyza: Machine, text: str, message: str
) -> None:
    head = "" if text.startswith("%") else "F60\n"
    with pytest.raises(InputError) as caught:
        list(read(tmp_path, xyza, f"{head}{text}\nG0 X1\nM2\n", "linuxcnc"))
    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G0 X#40", "parameter #40 is read before it is set"),
        ("o<a> if [1]\no<a> endif", "FluidNC has no subroutines, and labels that are numbers only"),
        ("o1 sub\no1 endsub", "FluidNC has no subroutines"),
        ("#31=0\no1 while [#31 LT 1]\n#31=1\no1 continue\no1 endwhile", "stops at endwhile"),
        ("o1 repeat [1]\no1 continue\no1 endrepeat", "stops at endrepeat"),
        ("o1 repeat [0-1]\no1 endrepeat", "repeat [-1] is negative"),
        ("#1=2\nG0 X#1", "parameter #1 is set and never read by fluidnc"),
        ("#31=31.99995\nG0 X##31", "must be a whole number here"),
        (
            "#31=0\no1 do\no2 while [#31 LT 3]\n#31=[#31+1]\no2 endwhile\no1 while [#31 LT 1]",
            "while 2 stands directly in do 1: FluidNC takes it for the end of a do",
        ),
        ("o1 error [3]", "the program stops here with error [3]"),
    ],
)
def test_expression_that_fluidnc_lacks_is_refused(
    tmp_path: Path, xyza: Machine, text: str, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        list(read(tmp_path, xyza, f"{text}\nG0 X1\nM2\n", "fluidnc"))
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("o1 while [1]\nG0 X1\no1 endwhile", "runs more than 50 lines again"),
        ("o1 while [1]\n#1=2\no1 endwhile", "runs more than 40 lines without a move"),
        ("o1 do\no1 while [1]\nG0 X1", "runs more than 40 lines without a move"),
        ("o1 repeat [15]\nG0 X1\nG4 P1\no1 endrepeat", "asks for more than 20 operations"),
    ],
)
def test_loops_without_an_end_are_refused(
    tmp_path: Path, xyza: Machine, monkeypatch: pytest.MonkeyPatch, text: str, message: str
) -> None:
    for module, name, most in (
        (course, "MOST_LINES", 50), (course, "MOST_IDLE", 40), (survey, "MOST_OPERATIONS", 20),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, most)
    with pytest.raises(InputError, match=message):
        read(tmp_path, xyza, f"{text}\nM2\n", "linuxcnc")


def test_numbered_programs_are_read_as_before(tmp_path: Path, xyza: Machine) -> None:
    """A block after the program's number is no O word."""
    text = "G1 X1 F60\nM98 P2 L2\nM30\nO2 G91\nX1\nG90 M99\n"
    for _ in range(2):
        job = read(tmp_path, xyza, text, "linuxcnc")
        assert [p[0] for p in millimetres(job)] == [1, 2, 3]


def test_a_program_that_only_reckons_moves_nothing(tmp_path: Path, xyza: Machine) -> None:
    with pytest.raises(InputError, match="the program moves nothing"):
        read(tmp_path, xyza, "#1=[1+2]\nM2\n", "linuxcnc")
    with pytest.raises(InputError, match="the program has no end"):
        read(tmp_path, xyza, "#1=[1+2]\nG0 X#1\n", "linuxcnc")
    assert len(millimetres(read(tmp_path, xyza, "#101=3\nG0 X#101\n", "fluidnc"))) == 1
