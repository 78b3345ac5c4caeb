"""A winding as a job: the fibre of its finished program, refusals, and written files."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.jobs.winding.test_fibre import VESSEL
from threadline.base.arrays import FloatArray
from threadline.errors import InputError, JobError, OptionError
from threadline.jobs import own_product, read_job
from threadline.jobs.operations import Job, Move, MoveRun
from threadline.jobs.winding.build_up import design
from threadline.jobs.winding.layers import read_layers
from threadline.machine import load_machine
from threadline.proof.options import options_of
from threadline.proof.pipeline import open_job, plan_job
from threadline.verdict.replayed import programmed_fibre, wound_job
from threadline.winding.product import product_of_text
from threadline.winding.surface import Surface

ROOT = Path(__file__).parents[3]
VESSEL_FILE = ROOT / "examples" / "vessel.wind.toml"
WINDER = load_machine("lathe-winder")


def _runs(job: Job) -> list[MoveRun]:
    return [item for item in job.runs() if isinstance(item, MoveRun)]


def _positions(job: Job) -> FloatArray:
    return np.vstack([run.targets for run in _runs(job)])


def test_the_finished_program_lays_the_designed_fibre() -> None:
    """At most 0.02 mm, by the replay that proofs use, over all 44 circuits."""
    (laid,) = design(read_layers(VESSEL_FILE))
    options = options_of(interpolation="linear", product=own_product(VESSEL_FILE))
    plan = plan_job(open_job(VESSEL_FILE, WINDER, options), WINDER, options)
    wound = wound_job(plan)
    assert wound is not None
    course = laid.circuit.course()
    lap = laid.circuit.advance
    # The job begins at 0 deg, and the fibre then leaves the turn square to the eye's plane.
    first = _positions(plan.job)[0]
    begin = next(item for item in plan.job if isinstance(item, Move) and item.target[2] > 0.0)
    start = math.acos(laid.circuit.left.radius_m / begin.target[2])
    assert first[0] > 0.0
    worst = 0.0
    for samples in programmed_fibre(plan, wound):
        fibre = samples.fibre
        known = fibre.known & np.isfinite(fibre.u)
        if not known.any():
            continue
        within = np.mod(start - fibre.angle[known], lap)
        u = np.interp(within, course[:, 2], course[:, 1])
        across = np.sin(np.interp(within, course[:, 2], course[:, 3]))
        worst = max(worst, float((np.abs(fibre.u[known] - u) * across).max()))
    assert 0.0 < worst < 2e-5


def test_the_mandrel_turns_on_and_on_and_the_pattern_closes() -> None:
    job = read_job(VESSEL_FILE, WINDER)
    runs = _runs(job)
    assert [run.passes for run in runs] == [(number,) for number in range(1, 45)]
    positions = _positions(job)
    assert (np.diff(positions[:, 0]) > 0.0).all()
    first, last = runs[0].targets, runs[-1].targets
    turned = last[-1, 0] - first[-1, 0]
    assert turned == pytest.approx(43 * 63 / 44 * 2.0 * math.pi, abs=1e-9)
    # The last circuit has the same points, and a longer way to its rest.
    same = runs[-2].targets
    assert same[:, 1:] == pytest.approx(first[:, 1:], abs=1e-12)
    lap = turned / 43
    at = np.argmin(np.abs(last[:, 0][:, None] - (same[:, 0] + lap)[None]), axis=0)
    assert last[at, 1:] == pytest.approx(same[:, 1:], abs=1e-12)
    assert len(last) > len(same)


def test_the_speed_of_the_fibre_is_even(tmp_path: Path) -> None:
    """No move draws fibre faster than wanted, and most draw it at that speed."""
    file = tmp_path / "even.wind.toml"
    text = VESSEL_FILE.read_text(encoding="utf-8")
    file.write_text(text.replace("[fibre]", '[fibre]\nspeed = "150 mm/s"'), encoding="utf-8")
    job = read_job(file, WINDER)
    run = _runs(job)[3]
    rates = np.array([feed.value for _, feed in run.feeds if feed is not None])
    product = product_of_text(own_product(file))
    (laid,) = design(read_layers(file))
    total = float((1.0 / rates).sum())
    assert total >= laid.circuit.length_m / 0.15 - 1e-9
    assert total < 1.1 * laid.circuit.length_m / 0.15
    assert product.tied == pytest.approx(3.66e-3, abs=2e-5)


@pytest.mark.long(but="stepper-winder")
@pytest.mark.parametrize("name", ["stepper-winder", "stepper-winder+xab", "stepper-winder+azxb"])
def test_other_eyes_lay_the_same_fibre(name: str) -> None:
    machine = load_machine(name)
    job = read_job(VESSEL_FILE, machine)
    options = options_of(interpolation="linear", product=own_product(VESSEL_FILE))
    plan = plan_job(open_job(VESSEL_FILE, machine, options), machine, options)
    wound = wound_job(plan)
    assert wound is not None
    known = 0
    for samples in programmed_fibre(plan, wound):
        fibre = samples.fibre
        assert np.nanmax(np.abs(fibre.steer), initial=0.0) < 0.1
        known += int(fibre.known.sum())
        if known > 5000:
            break
    assert known > 5000
    assert job.axes == machine.axis_names


def test_the_fibre_comes_up_to_speed_from_rest() -> None:
    """Three tenths of the speed at first; after a second at full speed, all circuits are alike."""
    first, full = (
        np.array([feed.value for _, feed in run.feeds if feed is not None])
        for run in _runs(read_job(VESSEL_FILE, WINDER))[:2]
    )
    share, away = first / full, np.cumsum(1.0 / full)
    assert share[0] == pytest.approx(0.3) and (np.diff(share) >= -1e-12).all()
    assert share[away > 1.1] == pytest.approx(1.0) and share[away <= 1.0].mean() < 0.8


def _written(folder: Path, text: str) -> Path:
    file = folder / "bad.wind.toml"
    file.write_text(text, encoding="utf-8")
    return file


TUBE = """
[[part]]
kind = "cylinder"
radius = "50 mm"
length = "200 mm"
[band]
width = "5 mm"
[friction]
value = "0.25 +- 0.05"
"""


@pytest.mark.parametrize(
    ("text", "expected_text", "line"),
    [
        (VESSEL, "no [[layer]]", 0),
        (f"layer = 3\n{VESSEL}", "layer must be a list of tables", 1),
        (f"{VESSEL}[[layer]]\nturns = 3\n", "unknown key 'turns'", 23),
        (f'{VESSEL}[[layer]]\nturn = "12 mm"\n', "the opening and half a band are 18 mm", 22),
        (f'{VESSEL}[[layer]]\nturn = "120 mm"\n', "largest radius is 100 mm", 23),
        (f'{VESSEL}[[layer]]\nangle = "0 deg"\n', "an angle of 0 deg", 23),
        (f'{VESSEL}[[layer]]\nturn = "20 mm"\nangle = "20 deg"\n', "the same twice", 24),
        (f"{VESSEL}[[layer]]\ncircuits = 0\n", "circuits is 0; it must be from 1 to 100000", 23),
        (f"{VESSEL}[[layer]]\ncircuits = 1000000\n", "circuits is 1000000; it must be", 23),
        (f"{VESSEL}[[layer]]\ncircuits = 1.5\n", "not a whole number", 23),
        (f"{VESSEL}[[layer]]\nshift = 3\n", "a shift needs the circuits", 23),
        (f'{VESSEL}[[layer]]\nturn = "20 mm"\ncircuits = 103\nshift = 60\n', "no pattern", 22),
        (f'{VESSEL}[[layer]]\nkind = "braid"\n', "a layer of the kind 'braid'", 23),
        (f'{VESSEL}[[layer]]\nclose = "luck"\n', "close = 'luck'", 23),
        (f"{TUBE}[[layer]]\n", "no dome that gives an angle", 10),
        (f'{TUBE}[[layer]]\nangle = "55 deg"\n', "nothing says from where on", 10),
        (
            f'{TUBE}[coverage]\nbegin = "40 mm"\nend = "160 mm"\n[[layer]]\nangle = "55 deg"\n',
            "runs off the mandrel at the left end with a friction ratio of 0.18", 13,
        ),
        (
            TUBE.replace('"5 mm"', '"0.001 mm"')
            + '[coverage]\nbegin = "90 mm"\nend = "110 mm"\n[[layer]]\nangle = "55 deg"\n',
            "would need 180195 circuits, limit 1000", 13,
        ),
        (f'{TUBE}[fibre]\nspeed = "0 mm/s"\n[[layer]]\nangle = "55 deg"\n', "speed", 0),
        (f'{VESSEL}[fibre]\ntied = "60 mm"\n[[layer]]\nturn = "20 mm"\n', "begins where it", 24),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(tmp_path: Path, text: str, expected_text: str, line: int) -> None:
    file = _written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_job(file, WINDER)
    message = str(caught.value)
    assert expected_text in message
    assert "\n" not in message
    assert "bad.wind.toml" in message
    if line:
        assert caught.value.place is not None
        assert caught.value.place.line == line


SMALL = VESSEL.replace("100 mm", "50 mm").replace("400 mm", "120 mm").replace("15 mm", "10 mm")
SMALL = SMALL.replace("6 mm", "8 mm")


@pytest.mark.parametrize(
    ("layer", "message"),
    [
        ("circuits = 1\n", r"no pattern with 1 circuits closes\. .*circuits = \d+, shift = \d+, "),
        (
            "circuits = 38\nshift = 4\n",
            r"circuits and shift 4 closes\. .* closes: circuits = 38, shift",
        ),
        ('[fibre]\nenvelope = "0.001 mm"\n', r"envelope is 0.001 mm; .* to 1000 mm. .*leave it"),
        ('[fibre]\nenvelope = "5 m"\n', "envelope is 5000 mm; it must be from 1 to 1000 mm"),
        (
            '[fibre]\nenvelope = "5 mm"\nclearance = "8 mm"\n',
            "an envelope of 5 mm: clearance and body of the eye need 8 mm",
        ),
    ],
)
def test_wishes_that_cannot_be_name_what_can(tmp_path: Path, layer: str, message: str) -> None:
    text = f'{SMALL}[[layer]]\nturn = "20 mm"\n{layer}'
    file = _written(tmp_path, text)
    with pytest.raises(JobError, match=message) as caught:
        read_job(file, WINDER)
    near = re.search(r"circuits = (\d+), shift = (\d+)", str(caught.value))
    assert caught.value.place is not None and caught.value.place.line
    if near is None:
        return
    # A winding with the named value exists.
    one, two = near.groups()
    wish = f'{SMALL}[[layer]]\nturn = "20 mm"\ncircuits = {one}\nshift = {two}\n'
    (laid,) = design(read_layers(_written(tmp_path, wish)))
    assert (laid.pattern.circuits, laid.pattern.shift) == (int(one), int(two))


def test_a_friction_that_closes_a_pattern_is_enough(tmp_path: Path) -> None:
    """With the friction in the message the pattern closes, with a tenth less it does not."""

    def text(friction: float) -> str:
        layer = '[[layer]]\nturn = "22 mm"\ncircuits = 37\nshift = 13\nclose = "friction"\n'
        return SMALL.replace('"0.25 +- 0.05"', f'"{friction!r}"') + layer

    with pytest.raises(JobError, match=r"A friction of [\d.]+ or more would close") as caught:
        read_layers_and_design(_written(tmp_path, text(0.001)))
    found = re.search(r"A friction of ([\d.]+)", caught.value.remedy)
    assert found is not None
    enough = float(found[1])
    assert read_layers_and_design(_written(tmp_path, text(1.05 * enough)))
    with pytest.raises(JobError):
        read_layers_and_design(_written(tmp_path, text(0.9 * enough)))


def test_a_join_with_too_little_friction_says_how_much_would_do(tmp_path: Path) -> None:
    """On a tube one pass has to be enough for the change of the angle."""

    def text(friction: float) -> str:
        tube = TUBE.replace('"200 mm"', '"600 mm"').replace('"0.25 +- 0.05"', f'"{friction!r}"')
        ends = '[mandrel]\nat = "-300 mm"\n[coverage]\nbegin = "290 mm"\nend = "310 mm"\n'
        return f'{ends}{tube}[[layer]]\nangle = "70 deg"\n[[layer]]\nangle = "50 deg"\n'

    with pytest.raises(JobError, match=r"cannot change from 70\.0 deg to 50\.0 deg") as caught:
        read_job(_written(tmp_path, text(0.2)), WINDER)
    found = re.search(r"A friction of ([\d.]+) would do", caught.value.remedy)
    assert found is not None and float(found[1]) > 0.2
    with pytest.raises(JobError, match="cannot change"):
        read_job(_written(tmp_path, text(0.9 * float(found[1]))), WINDER)
    assert read_job(_written(tmp_path, text(1.02 * float(found[1]))), WINDER)


def read_layers_and_design(file: Path) -> object:
    return design(read_layers(file))


def test_too_little_friction_says_how_much_would_do(tmp_path: Path) -> None:
    """On a cylinder the way is R / mu (1 / sin a - 1): 40 mm of room need 0.276."""
    text = f'{TUBE}[coverage]\nbegin = "40 mm"\nend = "160 mm"\n[[layer]]\nangle = "55 deg"\n'
    with pytest.raises(JobError) as caught:
        read_job(_written(tmp_path, text), WINDER)
    expected = 0.05 / 0.04 * (1.0 / math.sin(math.radians(55.0)) - 1.0)
    assert f"A ratio of {expected:.3g} would turn it" in caught.value.remedy


def test_a_machine_without_an_eye_is_refused() -> None:
    with pytest.raises(OptionError, match="a winding needs the eye of a winder, and stitcher"):
        read_job(VESSEL_FILE, load_machine("stitcher"))


STACK = VESSEL.replace("100 mm", "50 mm").replace("400 mm", "120 mm").replace("15 mm", "10 mm")
"""A small vessel: 8 mm band, a helical layer, a hoop layer and another helical one."""
LAYERS = '[[layer]]\nturn = "20 mm"\n[[layer]]\nkind = "hoop"\n[[layer]]\nturn = "30 mm"\n'


def test_layers_grow_by_the_volume_of_their_fibre(tmp_path: Path) -> None:
    """Bodies of revolution by the disc method, compared with fibre length times cross-section."""
    text = f'[mandrel]\nat = "100 mm"\n{STACK.replace("6 mm", "8 mm")}{LAYERS}'
    laid = design(read_layers(_written(tmp_path, text)))

    def discs_m3(surface: Surface) -> float:
        x, r = surface.at(np.linspace(0.0, surface.length_m, 20_001))
        inside = (x[:, 0] > 1e-3) & (x[:, 0] < 0.217)
        return float(np.trapezoid(math.pi * r[inside, 0] ** 2, x[inside, 0]))

    sizes = [discs_m3(one.circuit.surface) for one in laid]
    for one, low, high in zip(laid, sizes, sizes[1:], strict=False):
        fibre = (one.length_m + one.dwells_m) * 8e-3 * 0.25e-3
        # The step beside the hoops is drawn out over three times its height.
        hoops = one.layer.kind == "hoop"
        step = 3.0 * (one.thickness_m or 0.0) ** 2 * 2.0 * math.pi * 0.05 if hoops else 0.0
        assert high - low == pytest.approx(fibre + step, rel=0.01)
    for one in laid:
        spread = one.spread()
        assert spread is not None
        fibre = one.length_m * 8e-3 * 0.25e-3
        assert spread.volume_m3(one.circuit.surface) == pytest.approx(fibre, rel=1e-3)
    radius = 0.05 + sum(one.thickness_m or 0.0 for one in laid[:2])
    # Hoops reach half a band beyond their turns, so they are a little thinner.
    assert laid[2].circuit.widest_m == pytest.approx(radius, abs=5e-5)


def test_the_way_over_a_join_is_continuous(tmp_path: Path) -> None:
    text = f"{STACK.replace('6 mm', '18 mm')}{LAYERS[:25]}{LAYERS[-25:]}"
    file = _written(tmp_path, text)
    laid = design(read_layers(file))
    assert [one.layer.kind for one in laid] == ["helical", "helical"]
    job = read_job(file, WINDER)
    runs = [run for run in _runs(job) if run.line[0] == laid[1].layer.line]
    assert len(runs) == laid[1].pattern.circuits + 1  # the join is the first
    every = _positions(job)
    # The mandrel never stops or turns back.
    assert (np.diff(every[:, 0]) > 0.0).all()
    eye = np.vstack([runs[0].targets[-1], runs[1].targets])
    assert eye[-1, 0] - eye[0, 0] == pytest.approx(laid[1].circuit.advance, abs=1e-9)
    # At the end of the join the first circuit begins: the eye is at its place of each circuit.
    assert eye[-1, 1:] == pytest.approx(eye[0, 1:], abs=1e-6)


def test_layers_that_outgrow_a_fixed_eye_are_refused(tmp_path: Path) -> None:
    machine = load_machine("stepper-winder+xab")
    text = TUBE.replace("50 mm", "78 mm").replace("200 mm", "500 mm")
    text = text.replace('width = "5 mm"', 'width = "5 mm"\nthickness = "1 mm"')
    text += '[coverage]\nbegin = "150 mm"\nend = "350 mm"\n' + '[[layer]]\nangle = "55 deg"\n' * 2
    with pytest.raises(JobError, match="envelope with a radius of 80 mm") as caught:
        read_job(_written(tmp_path, text), machine)
    assert caught.value.remedy.startswith("The machine cannot move its eye across: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("overlays", "warned"), [("xab+marlin", True), ("xyz+marlin", False), ("xab+grbl", False)]
)
def test_a_mandrel_that_marlin_turns_as_a_rotary_axis_jumps(overlays: str, warned: bool) -> None:
    """Marlin's length of a move uses X Y Z alone: the plan shows the effect on a turn.

    A stepper accepts about 10 deg/s at once (RepRapFirmware's jump in the machine file); the
    mandrel turns at 150 deg/s.
    """
    machine = load_machine(f"stepper-winder+{overlays}")
    file = Path(__file__).parents[3] / "examples" / "tube.wind.toml"
    message = " ".join(read_job(file, machine).warnings)
    assert ("Marlin counts the speed of a move along X alone" in message) is warned
    options = options_of(product=str(file))
    plan = plan_job(open_job(file, machine, options), machine, options)
    trajectory = plan.motion.trajectory
    column = trajectory.axes.index("Y" if "xyz" in overlays else "A")
    before, largest = None, 0.0
    for block in trajectory:
        coefficients = block.coefficients[:, :, column]
        powers = np.arange(coefficients.shape[1])
        begin = coefficients[:, 1] / block.duration_s
        end = coefficients @ powers / block.duration_s
        steps = begin[1:] - end[:-1]
        steps = steps if before is None else np.append(steps, begin[0] - before)
        largest, before = max(largest, float(np.abs(steps).max(initial=0.0))), end[-1]
    assert (math.degrees(largest) > 60.0) is warned, math.degrees(largest)


HOOPS_ON_HELICAL = """name = "tube"
[mandrel]
at = "-110 mm"
[[part]]
kind = "cylinder"
radius = "50 mm"
length = "470 mm"
[band]
width = "6.05 mm"
thickness = "{thick} mm"
[friction]
value = 0.2
[coverage]
begin = "110 mm"
end = "360 mm"
[[layer]]
angle = "55 deg"
circuits = 30
[[layer]]
kind = "hoop"
"""
DOMES = """[[part]]
kind = "isotensoid"
radius = "50 mm"
opening = "28 mm"
pole = "left"
[[part]]
kind = "cylinder"
radius = "50 mm"
length = "96 mm"
[[part]]
kind = "isotensoid"
radius = "50 mm"
opening = "28 mm"
pole = "right"
[band]
width = "5.6 mm"
thickness = "2 mm"
[friction]
value = 0.25
[[layer]]
kind = "helical"
[[layer]]
kind = "hoop"
"""


@pytest.mark.parametrize(
    ("text", "line", "expected_text"),
    [
        (HOOPS_ON_HELICAL.format(thick=0.25), 19, "hoops do not lie on the layers below"),
        (HOOPS_ON_HELICAL.format(thick=2), 19, "no cylinder is left for a hoop layer"),
        (DOMES, 22, "the join to layer 2: the fibre runs off the mandrel"),
        (DOMES.replace("28 mm", "60 mm"), 4, "opening"),
    ],
)
def test_hoops_that_do_not_fit_name_file_and_line(
    tmp_path: Path, text: str, line: int, expected_text: str
) -> None:
    file = tmp_path / "p.wind.toml"
    file.write_text(text)
    with pytest.raises(JobError) as refused:
        read_job(file, load_machine("lathe-winder"))
    message = str(refused.value)
    assert f"p.wind.toml:{line}: " in message and expected_text in message
    assert "\n" not in message


@pytest.mark.long(shown_by="test_a_tension_at_which_the_arm_lies_at_its_stop_is_told")
def test_layers_with_another_tension_than_the_brake_gives_are_named(tmp_path: Path) -> None:
    """A taper of 10 % a layer: 8.6, 7.74 and 6.97 N against 7.88 N of the machine."""
    file = tmp_path / "p.wind.toml"
    layer = '[[layer]]\nangle = "55 deg"\ncircuits = 30\n'
    text = HOOPS_ON_HELICAL.format(thick=0.01).partition("[[layer]]")[0] + 3 * layer
    file.write_text(text + '[fibre]\ntension = "8.6 N"\ntaper = "10 %"\n')
    plain = read_job(file, load_machine("lathe-winder")).warnings
    assert not [warning for warning in plain if "tension" in warning]
    settable = load_machine("lathe-winder+spool")
    assert settable.spool is not None
    assert not [w for w in read_job(file, settable).warnings if "tension" in w]
    fixed = replace(settable, spool=replace(settable.spool, most_torque=None))
    warnings = [w for w in read_job(file, fixed).warnings if "brake" in w]
    assert [line.partition(": ")[0] for line in warnings] == ["p.wind.toml:16", "p.wind.toml:22"]
    assert "layer 1 asks for a tension of 8.6 N" in warnings[0] and "gives 7.9 N" in warnings[0]
    # T r / (1 + friction), and the arm's part of the brake above the middle of its travel
    assert "about 0.51 N m" in warnings[0] and "about 0.322 N m" in warnings[1]


def test_a_tension_at_which_the_arm_lies_at_its_stop_is_told(tmp_path: Path) -> None:
    file = tmp_path / "p.wind.toml"
    text = (Path(__file__).parents[3] / "examples" / "vessel.wind.toml").read_text()
    file.write_text(text + 'tension = "4 N"\n')
    (warning,) = [
        w for w in read_job(file, load_machine("lathe-winder+spool")).warnings if "arm" in w
    ]
    assert "p.wind.toml:" in warning
    assert (
        "layer 1 asks for a tension of 4 N, at which the spring arm lies at its lower stop"
        in warning
    )
    assert "free from 4.62 to 11.2 N" in warning


def test_the_mandrel_comes_to_rest_evenly() -> None:
    """The speed falls as half a cosine within 0.5 s, in steps of 20 ms; otherwise it swings."""
    file = Path(__file__).parents[3] / "examples" / "vessel.wind.toml"
    job = read_job(file, load_machine("lathe-winder"))
    runs = [item for item in job.runs() if isinstance(item, MoveRun)]
    last, before = runs[-1], runs[-2]
    turn = job.axes.index("A")

    def course(run: MoveRun) -> tuple[np.ndarray, np.ndarray]:
        """Return the instants of the targets before the end, and the remaining turn."""
        seconds = np.array([1.0 / feed.value for _, feed in run.feeds if feed is not None])
        return np.cumsum(seconds[::-1])[::-1][1:], run.targets[-1, turn] - run.targets[:-1, turn]

    left_s, turns = course(last)
    usual_s, usual = course(before)
    nominal_s = np.interp(turns, [0.0, *usual[::-1]], [0.0, *usual_s[::-1]])
    slow = left_s < 0.5
    assert slow.sum() >= 20
    expected = 0.5 * left_s - 0.25 / math.pi * np.sin(2.0 * math.pi * left_s)
    assert nominal_s[slow] == pytest.approx(expected[slow], abs=2e-4)
    assert left_s[~slow] - nominal_s[~slow] == pytest.approx(0.25, abs=2e-3)
    assert np.diff(left_s[::-1])[: slow.sum() - 1].max() < 0.045


def test_the_last_move_before_a_rest_has_steps_enough_for_marlin() -> None:
    """Marlin ignores moves of fewer than six steps, and does their way at the next one's speed.

    The last part of half a cosine would thus become a second at a hundredth of the speed.
    """
    machine = load_machine("stepper-winder+xyz+marlin")
    job = read_job(Path(__file__).parents[3] / "examples" / "tube.wind.toml", machine)
    last = [item for item in job.runs() if isinstance(item, MoveRun)][-1]
    turn = job.axes.index("Y")
    steps = np.diff(last.targets[:, turn]) * machine.counts_per_unit[turn]
    assert steps[-1] > 8.0 and steps.min() > 6.0
    (_, feed) = last.feeds[-1]
    assert feed is not None and 1.0 / feed.value < 0.1


def test_fewer_circuits_than_the_coverage_needs_are_refused(tmp_path: Path) -> None:
    """2 pi 50 mm cos(39.79 deg) / 5.6 mm = 43.1 bands lie side by side."""
    file = tmp_path / "p.wind.toml"
    text = (Path(__file__).parents[3] / "examples" / "vessel.wind.toml").read_text()
    few = text.replace("circuits = 44\nshift = 19\n", "circuits = 20\n")
    file.write_text(few + 'cover = "100 %"\n')
    with pytest.raises(JobError) as refused:
        read_job(file, load_machine("lathe-winder"))
    assert "20 circuits cover 46.4 % of the largest radius" in str(refused.value)
    assert "circuits = 44" in str(refused.value)
    file.write_text(few)
    assert len([r for r in read_job(file, load_machine("lathe-winder")).runs()]) > 20
