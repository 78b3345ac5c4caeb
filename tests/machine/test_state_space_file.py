"""State-space controllers and observing sensors in machine files: refusals, and their place."""

from __future__ import annotations

import numpy as np
import pytest

from tests.twin.test_state_space import ONE_AXIS
from threadline.errors import MachineError
from threadline.machine import load_machine

TEXT = ONE_AXIS.replace("POT", "").replace("FELT", "")


def load(folder, old: str = "", new: str = ""):
    assert TEXT.count(old) == 1 or not old
    file = folder / "mine.toml"
    file.write_text(TEXT.replace(old, new) if old else TEXT)
    return load_machine(file)


def line_of(old: str) -> int:
    return TEXT[: TEXT.index(old)].count("\n") + 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("A = [[0.9, 0.05], [-0.02, 0.7]]", "A = [[0.9, 0.05, 0.0], [-0.02, 0.7, 0.0]]",
         "controllers.all.A: 3 numbers in row 1, expected 2 x 2: states x states"),
        ("C = [[0.4, 0.7]]", "C = [[0.4, 0.7], [0.1, 0.2]]",
         "controllers.all.C: 2 rows, expected 1 x 2: drives x states"),
        ("D = [[1.1, -1.1, 0.8, -0.9]]", "D = [[1.1, -1.1, 0.8]]",
         "controllers.all.D: 3 numbers in row 1, expected 1 x 4: drives x (references + sensors)"),
        ("D = [[1.1, -1.1, 0.8, -0.9]]", "D = [[1.1, -1.1, 0.8, nan]]", "controllers.all.D"),
        ("D = [[1.1, -1.1, 0.8, -0.9]]", 'D = [["1.1 dac/count", -1.1, 0.8, 1]]',
         "controllers.all.D"),
        ('sensors = ["motor", "felt", "pot"]', 'sensors = ["pot", "felt", "motor"]',
         "controllers.all.sensors names the encoder 'pot'"),
        ('sensors = ["motor", "felt", "pot"]', 'sensors = ["motor", "felt", "por"]',
         "controllers.all.sensors names the sensor 'por'"),
        ("D = [[1.1, -1.1, 0.8, -0.9]]", "D = [[1.1, -1.1, 0.8, 1e300]]",
         "controllers.all.D.0.3: must be at most 1000000000000"),
        ("A = [[0.9, 0.05], [-0.02, 0.7]]", "A = [[0.9, 0.05], [-1e13, 0.7]]",
         "controllers.all.A.1.0: must be at least -1000000000000"),
        ('references = ["X"]', 'references = ["Y"]',
         "controllers.all.references names the axis 'Y'"),
        ('drives = ["motor"]', 'drives = ["motor", "more"]', "drives: 2 names"),
        ('reads = { head = "250 V/m exact, assumed" }',
         'reads = { head = "250 V/m exact, assumed" }\nrange = "1 A exact, assumed"',
         "sensors.pot.range"),
        ('reads = { head = "1 exact, assumed" }',
         'reads = { head = "1 exact, assumed" }\nnoise = "0.1 V exact, assumed"',
         "sensors.felt.noise"),
    ],
)  # fmt: skip
def test_an_error_names_key_and_line(tmp_path, old, new, message):
    with pytest.raises(MachineError) as caught:
        load(tmp_path, old, new)
    assert message in str(caught.value)
    inserted = 1 if "\n" in new else 0
    assert caught.value.place is not None
    assert caught.value.place.line == line_of(old) + inserted


def test_rows_of_a_matrix_over_several_lines_move_no_line_number(tmp_path):
    with pytest.raises(MachineError) as caught:
        load(
            tmp_path,
            "D = [[1.1, -1.1, 0.8, -0.9]]",
            "D = [\n  [1.1, -1.1, 0.8, -0.9],\n]\ndacs = 1",
        )
    assert caught.value.place is not None
    assert caught.value.place.line == line_of("D = [[1.1") + 3


def test_an_axis_needs_one_reference_and_a_drive_one_controller(tmp_path):
    extra = """
[controllers.other]
kind = "p"
clock = "tick"
sensor = "motor"
drive = "motor"
kp = "1 dac/count exact, assumed"
dac = { bits = "8 bit exact, assumed", range = "10 V exact, assumed" }
"""
    file = tmp_path / "mine.toml"
    file.write_text(TEXT + extra)
    from threadline.dynamics.groups import connected_groups

    with pytest.raises(MachineError, match="share the drive 'motor'"):
        connected_groups(load_machine(file))
    file.write_text(TEXT.replace('controller = "all"', 'controller = "other"') + extra)
    with pytest.raises(MachineError, match="the axes with this controller are none"):
        load_machine(file)


def test_state_space_controller_is_refused_where_a_single_loop_is_needed(tmp_path):
    from threadline.dynamics.inverse import closed_responses, inverse_of
    from threadline.dynamics.sampled import digital_filter

    machine = load(tmp_path)
    with pytest.raises(MachineError, match=r"controllers\.all has the kind state-space"):
        digital_filter(machine, "all")
    with pytest.raises(MachineError, match=r"state-space; options that need the\s+exact inverse"):
        inverse_of(machine, "X")
    with pytest.raises(MachineError, match="learning"):
        closed_responses(machine, "X", np.array([1.0]))


def test_an_accelerometer_that_a_motor_moves_at_once_closes_no_analysed_loop(tmp_path):
    from threadline.dynamics.linear_model import linear_model

    machine = load(tmp_path, 'reads = { head = "1 exact, assumed" }',
                   'reads = { motor = "1 exact, assumed" }')  # fmt: skip
    with pytest.raises(MachineError, match=r"reads sensors\.felt, whose body a motor accelerates"):
        linear_model(machine)


def test_an_encoder_of_another_loop_is_refused_in_words(tmp_path):
    """Its counts belong to one loop; a controller that needs both encoders moves both axes."""
    (tmp_path / "both.toml").write_text(BOTH)
    with pytest.raises(MachineError) as caught:
        load_machine(tmp_path / "both.toml")
    assert "controllers.all.sensors: it reads the encoder 'y', which controllers.y" in str(
        caught.value
    )
    assert caught.value.place is not None
    assert caught.value.place.line == BOTH[: BOTH.index("sensors =")].count("\n") + 1


BOTH = """base = "lathe-winder"
[controllers]
x = "none"
[controllers.all]
kind = "state-space"
clock = "servo"
references = ["X"]
sensors = ["x", "y"]
drives = ["x"]
D = [[6.0, -6.0, 0.1]]
dac = { bits = "12 bit exact, assumed", range = "10 V exact, assumed" }
[axes.X]
controller = "all"
"""
