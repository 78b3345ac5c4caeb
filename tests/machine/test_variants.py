"""Variants of a machine: the same bits in any order, within their tolerances, none left out."""

from __future__ import annotations

import re
from fractions import Fraction

import numpy as np
import pytest

from threadline.dynamics.prescribed import prescribed
from threadline.dynamics.values import Values
from threadline.errors import MachineError, OptionError
from threadline.machine import Machine, library_names, load_machine, variants
from threadline.machine.numbers import number_at
from threadline.machine.variants import (
    corners,
    drawn,
    numbers_at,
    one_at_a_time,
    uncertain,
    variant,
)

RULES = """base = "lathe-winder"
[tolerances]
normal = ["bodies.x.inertia", "drives.*.resistance"]
exclude = ["bodies.y.*", "axes.*.counts"]
[tolerances.groups]
magnets = ["drives.x.torque_constant", "drives.x.back_emf"]
"""


@pytest.fixture
def machine(tmp_path):
    file = tmp_path / "m.toml"
    file.write_text(RULES)
    return load_machine(file)


def test_a_variant_depends_on_seed_and_index_alone(machine) -> None:
    whole = drawn(machine, 7, np.arange(1000))
    order = np.random.default_rng(0).permutation(1000)
    np.testing.assert_array_equal(drawn(machine, 7, order), whole[order])
    np.testing.assert_array_equal(drawn(machine, 7, np.array([999])), whole[999:])
    assert (drawn(machine, 8, np.arange(1000)) != whole).all()
    # Philox 4x64-10, key (7, 3): the generator's own first number.
    first = np.random.Generator(np.random.Philox(key=np.array([7, 3], dtype=np.uint64))).random()
    names = [number.name for number in uncertain(machine)]
    uniform = names.index("bodies.a.inertia")
    assert names.index("bodies.x.inertia") == 0 and whole[3, 0] != 2 * first - 1
    assert abs(whole[:, uniform]).max() <= 1.0


def test_distributions_are_what_the_file_says(machine) -> None:
    """Uniform on the interval; normal with two standard deviations in it, cut off at three."""
    from scipy import stats

    parts = drawn(machine, 1, np.arange(20_000))
    for column, number in zip(parts.T, uncertain(machine), strict=True):
        expected = stats.truncnorm(-3, 3, scale=0.5) if number.normal else stats.uniform(-1.0, 2.0)
        assert stats.kstest(column, expected.cdf).pvalue > 1e-4, number
    apart = np.corrcoef(parts.T) - np.eye(parts.shape[1])
    assert abs(apart).max() < 0.03  # 4 standard deviations of 1 / sqrt(20 000)
    normal = {n.name for n in uncertain(machine) if n.normal}
    assert normal == {"bodies.x.inertia", *(f"drives.{d}.resistance" for d in "xya")}


def test_groups_move_together_and_what_is_excluded_stays(machine) -> None:
    numbers = numbers_at(machine, drawn(machine, 1, np.arange(50)))
    share = {
        path: (values - number_at(machine, path).si) / number_at(machine, path).tolerance_si
        for path, values in numbers.items()
    }
    magnets = share["drives.x.torque_constant"]
    np.testing.assert_allclose(magnets, share["drives.x.back_emf"], atol=1e-12)
    assert not np.allclose(magnets, share["drives.y.back_emf"])
    assert not any(path.startswith(("bodies.y", "axes")) for path in numbers)


def test_a_batch_and_a_machine_have_the_same_numbers() -> None:
    machine = load_machine("letter-placer")
    parts = drawn(machine, 3, np.arange(4))
    numbers = numbers_at(machine, parts)
    assert "cylinders.X.delay" in numbers and "contacts.x_is_left.at" in numbers
    for k in range(4):
        one = variant(machine, parts[k])
        for path, values in numbers.items():
            quantity = number_at(one, path)
            assert quantity.si == values[k]
            if path.endswith(".delay"):
                assert float(quantity.exact_s) == quantity.si
    assert one.sha256 != machine.sha256
    delay = one.cylinders["X"].delay.exact_s
    assert delay is not None and delay.denominator <= 10**6


def test_drawn_dead_times_are_shared_and_spread_evenly() -> None:
    """Eleven values, the ends half as often: the weights of the trapezoidal rule."""
    machine = load_machine("stitcher")
    names = [one.name for one in uncertain(machine)]
    parts = drawn(machine, 5, np.arange(4000))
    for name in "drives.x.delay", "drives.y.delay":
        values, counts = np.unique(parts[:, names.index(name)], return_counts=True)
        np.testing.assert_allclose(values, np.linspace(-1.0, 1.0, 11), atol=1e-12)
        expected = 4000 * np.array([0.05, *[0.1] * 9, 0.05])
        assert (np.abs(counts - expected) < 5.0 * np.sqrt(expected)).all()
    inertia = parts[:, names.index("bodies.x_head.inertia")]
    assert len(np.unique(inertia)) == 4000  # every other number differs from machine to machine


def with_one_at_end(machine: Machine, name: str) -> Machine:
    """Return the machine with one of its uncertain numbers at the upper end of its tolerance."""
    return variant(machine, np.array([float(one.name == name) for one in uncertain(machine)]))


def test_a_drawn_dead_time_is_made_once_for_all_machines_that_have_it(monkeypatch) -> None:
    """The command draws for all workers; the groups equal those of their simulations."""
    machine, made = load_machine("stitcher"), []

    def counted(number: float) -> Fraction:
        made.append(number)
        return Fraction(number)

    monkeypatch.setattr(variants, "Fraction", counted)
    parts = drawn(machine, 3, np.arange(500))
    numbers = numbers_at(machine, parts)
    late = [path for path in numbers if path.endswith(".delay")]
    assert late and 0 < len(made) <= 11 * len(late)
    values = Values.of(machine, numbers)
    groups, places = values.by_delay(), values.places_by_delay()
    assert len(groups) == len(places) > 50
    for (group, theirs), mine in zip(groups, places, strict=True):
        assert theirs.tolist() == mine.tolist() and group.count == len(mine)
        for path in late:
            assert len(set(numbers[path][mine].tolist())) == 1
    assert sorted(np.concatenate(places).tolist()) == list(range(500))


def test_corners_and_one_at_a_time(tmp_path) -> None:
    file = tmp_path / "m.toml"
    file.write_text(
        'base = "lathe-winder"\n[tolerances]\n'
        'exclude = ["drives.*", "axes.*", "inputs.*", "controllers.*"]\n'
    )
    machine = load_machine(file)
    assert [n.name for n in uncertain(machine)] == [f"bodies.{b}.inertia" for b in "xya"]
    table = corners(machine)
    assert len({tuple(row) for row in table.tolist()}) == 8 and (abs(table) == 1.0).all()
    single = one_at_a_time(machine)
    np.testing.assert_array_equal(single[:2], [[-1, 0, 0], [1, 0, 0]])
    heavy = with_one_at_end(machine, "bodies.y.inertia")
    assert heavy.bodies["y"].inertia.si == pytest.approx(1.5 * 7.212e-4)
    with pytest.raises(OptionError, match="22 numbers of 'lathe-winder' vary, too many"):
        corners(load_machine("lathe-winder"))
    with pytest.raises(OptionError, match="the index of a variant is -1"):
        drawn(machine, 1, np.array([-1]))


def test_other_counts_put_the_load_elsewhere() -> None:
    """The command is unchanged; the load moves by the true counts per unit."""
    machine = load_machine("lathe-winder")
    off = with_one_at_end(machine, "axes.X.counts")
    assert off.axes["X"].counts == machine.axes["X"].counts
    assert off.axes["X"].load is not None
    weight = off.axes["X"].load["x"]
    assert weight.unit == "m/rad"
    assert weight.si == pytest.approx(4000 / (2 * np.pi) / (55358.0 * 1.0001), rel=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[clocks]\nservo = "5 ms +- 1 %, assumed"\n', "clocks.servo has a tolerance but cannot"),
        (
            '[axes.X]\nload = { x = "11.5 mm/rad exact, assumed" }\n',
            "axes.X.counts has a tolerance but cannot vary: its load defines",
        ),
        (
            '[bodies.x]\ninertia = "1 kg m^2 +- 70 %, assumed"\n'
            '[tolerances]\nnormal = ["bodies.x.inertia"]\n',
            "bodies.x.inertia would reach zero at 3 standard deviations of 0.35 kg",
        ),
        (
            '[tolerances]\nnormal = ["bodies.x.inertia"]\n'
            '[tolerances.groups]\nall = ["bodies.*"]\n',
            "the group 'all' varies together, but bodies.x.inertia is normal and bodies.y",
        ),
    ],
)
def test_number_that_cannot_vary_is_refused_by_name(tmp_path, text, message) -> None:
    file = tmp_path / "m.toml"
    file.write_text('base = "lathe-winder"\n' + text)
    with pytest.raises(OptionError, match=re.escape(message)):
        uncertain(load_machine(file))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('normal = ["bodies.x.inertai"]', "did you mean 'bodies.x.inertia'"),
        ('exclude = ["bodies.*.weight"]', "which does not exist"),
        (
            'groups = { a = ["bodies.x.*"], b = ["bodies.*.inertia"] }',
            "is in the group 'a' already",
        ),
        ("groups = { a = [] }", "the group has no numbers"),
    ],
)
def test_wrong_rules_are_refused_with_their_line(tmp_path, text, message) -> None:
    file = tmp_path / "m.toml"
    file.write_text(f'base = "lathe-winder"\n[tolerances]\n{text}\n')
    with pytest.raises(MachineError, match=re.escape(message)) as caught:
        load_machine(file)
    assert "m.toml:" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", library_names())
def test_every_library_machine_varies(name: str) -> None:
    machine = load_machine(name)
    numbers = numbers_at(machine, one_at_a_time(machine))
    assert len(numbers) >= 15
    assert variant(machine, drawn(machine, 1, np.array([0]))[0]).sha256 != machine.sha256


def test_counts_of_a_stepper_without_a_load_move_its_load(tmp_path) -> None:
    """N steps turn the motor by N / 3200 of a turn and the load by N / counts, 1 % less here."""
    file = tmp_path / "m.toml"
    file.write_text(
        'base = "stepper-winder"\n[axes.X]\nload = "none"\n'
        'counts = "80 count/mm +- 1 %, assumed"\n[tolerances]\n'
        'exclude = ["bodies.*", "links.*", "drives.*"]\n'
    )
    machine = load_machine(file)
    (other,) = (variant(machine, row) for row in one_at_a_time(machine)[1:])
    weight = other.axes["X"].load["x_motor"]

    assert weight.si == pytest.approx(3200 / (2 * np.pi) / (1.01 * 80e3), rel=1e-12)
    assert weight.unit == "m/rad"
    (piece,) = (piece for piece in prescribed(other) if "X" in piece.axes)
    row = piece.loads[piece.axes.index("X")]
    assert row[len(piece.states) + piece.drives.index("x")] == pytest.approx(weight.si, rel=1e-12)


def test_stiction_of_a_variant_is_never_below_its_friction(tmp_path) -> None:
    """Tolerances of friction and stiction overlap: drawn separately, they could be reversed."""
    file = tmp_path / "sticky.toml"
    file.write_text(
        'base = "lathe-winder"\n[bodies.x]\n'
        'friction = "0.02 N m +- 50 %, assumed"\nstiction = "0.022 N m +- 50 %, assumed"\n'
    )
    for machine in (load_machine(file), load_machine("letter-placer+whole-scans+hysteresis")):
        parts = np.concatenate([drawn(machine, 1, np.arange(40)), one_at_a_time(machine)])
        found = numbers_at(machine, parts)
        sticks = [name for name in found if name.endswith(".stiction")]
        assert sticks
        for name in sticks:
            assert (found[name] >= found[name.replace("stiction", "friction")]).all()
        for row in parts:
            variant(machine, row)  # stiction below friction is refused
