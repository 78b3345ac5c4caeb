"""Path data of SVG, compared with an evaluator written from SVG 1.1, chapter 8 and F.6."""

from __future__ import annotations

import cmath
import math
import random
from itertools import pairwise

import numpy as np
import pytest

from threadline.errors import JobError
from threadline.geometry.svg import read_svg

HEAD = '<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="60mm" viewBox="0 0 100 60">'
U = np.linspace(0.0, 1.0, 7)
NUMBERS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}


def casteljau(control: list[complex]) -> list[complex]:
    """Points of a Bezier curve, by repeated halfway lines and not by powers."""
    found = []
    for u in U:
        level = control
        while len(level) > 1:
            level = [(1 - u) * a + u * b for a, b in pairwise(level)]
        found.append(level[0])
    return found


def arc(a: complex, b: complex, v: list[float]) -> list[complex]:
    """An elliptic arc: on the unit circle, the centre lies left or right of the chord."""
    rx, ry, turn = abs(v[0]), abs(v[1]), cmath.exp(1j * math.radians(v[2]))
    if rx == 0 or ry == 0:
        return casteljau([a, b])

    def squeezed(p: complex) -> complex:
        q = p / turn
        return complex(q.real / rx, q.imag / ry)

    def back(q: complex) -> complex:
        return complex(q.real * rx, q.imag * ry) * turn

    p, q = squeezed(a), squeezed(b)
    size = max(1.0, abs(q - p) / 2)
    left = (q - p) / abs(q - p) * 1j
    rise = math.sqrt(max(0.0, size**2 - abs(q - p) ** 2 / 4))
    # Y points down: an arc of increasing angle has its centre on the +1j side unless it is large.
    centre = (p + q) / 2 + left * rise * (1 if bool(v[3]) != bool(v[4]) else -1)
    first, last = cmath.phase(p - centre), cmath.phase(q - centre)
    sweep = (last - first) % (2 * math.pi)
    if not v[4]:
        sweep -= 2 * math.pi
    return [back(centre + size * cmath.exp(1j * (first + u * sweep))) for u in U]


def drawn(commands: list[tuple[str, list[float]]]) -> list[list[list[complex]]]:
    """Return subpaths of segments of points, from the commands by the specification."""
    paths: list[list[list[complex]]] = []
    here = start = 0j
    reflected: dict[str, complex] = {}
    fresh = False
    for letter, v in commands:
        base = here if letter.islower() else 0j
        kind = letter.upper()
        points = [base + complex(x, y) for x, y in zip(v[::2], v[1::2], strict=False)]
        kept: dict[str, complex] = {}
        segment: list[complex] | None = None
        before = here
        if kind == "M":
            paths.append([])
            here = start = points[0]
            fresh = False
        elif kind == "Z":
            # A path without motion is kept, so that a message can name it.
            if here != start or not (paths[-1] or fresh):
                segment = casteljau([here, start])
            here = start
        elif kind == "L":
            segment, here = casteljau([here, points[0]]), points[0]
        elif kind == "H":
            here = complex(base.real + v[0], here.imag)
            segment = casteljau([before, here])
        elif kind == "V":
            here = complex(here.real, base.imag + v[0])
            segment = casteljau([before, here])
        elif kind in "CS":
            if kind == "S":
                points.insert(0, reflected.get("cubic", here))
            segment, here = casteljau([here, *points]), points[2]
            kept["cubic"] = 2 * points[2] - points[1]
        elif kind in "QT":
            if kind == "T":
                points.insert(0, reflected.get("quadratic", here))
            segment, here = casteljau([here, *points]), points[1]
            kept["quadratic"] = 2 * points[1] - points[0]
        elif kind == "A":
            here = base + complex(v[5], v[6])
            if here != before:
                segment = arc(before, here, v)
        reflected = kept
        if segment is not None:
            if fresh:
                paths.append([])
                fresh = False
            paths[-1].append(segment)
        if kind == "Z":
            fresh = True
    return [path for path in paths if path]


def written(commands: list[tuple[str, list[float]]], chance: random.Random) -> str:
    """Return the commands as text: optional letters left out, any separators, tight signs."""
    text, last = "", ""
    for letter, values in commands:
        implied = {"M": "L", "m": "l"}.get(last, last)
        hidden = letter == implied and letter not in "Zz" and chance.random() < 0.5
        for k, value in enumerate(values):
            flag = letter in "Aa" and k in (3, 4)
            number = str(int(value)) if flag else f"{value:.{chance.randint(1, 4)}f}"
            number = number if flag else repr(value)
            if k == 0 and not hidden:
                text += chance.choice(["", " ", "\n"]) + letter + chance.choice(["", " "])
            elif number.startswith("-") and chance.random() < 0.5:
                pass
            elif letter in "Aa" and k in (4, 5) and chance.random() < 0.5:
                pass  # flags are one digit and need nothing after them
            else:
                text += chance.choice([" ", ",", " , ", "\t"])
            text += number
        if not values:
            text += letter
        last = letter
    return text


def commands(chance: random.Random) -> list[tuple[str, list[float]]]:
    letters = "M" + "".join(chance.choice("MmLlHhVvCcSsQqTtAaZzSsTtQqCc") for _ in range(9))
    found = []
    for letter in letters:
        v = [round(chance.uniform(-50, 50), 3) for _ in range(NUMBERS[letter.upper()])]
        if letter in "Aa":
            v[3], v[4] = float(chance.random() < 0.5), float(chance.random() < 0.5)
        found.append((letter, v))
    return found


def sampled(data: str) -> list[list[np.ndarray]]:
    """Return the read path in the drawing's own millimetres, segment by segment."""
    drawing = read_svg(f'{HEAD}<path stroke="red" d="{data}"/></svg>'.encode(), "t.svg")
    found = []
    for stroke in drawing.strokes:
        points = [
            stroke.pieces.evaluate(np.full(len(U), k), U)[0] * 1e3
            for k in range(len(stroke.pieces))
        ]
        found.append([np.column_stack([p[:, 0], 60 - p[:, 1]]) for p in points])
    return found


@pytest.mark.parametrize("seed", range(300))
def test_random_paths_over_all_commands(seed: int) -> None:
    """Within 1e-9 mm: rounding of numbers of some 100 mm, and of radii scaled up."""
    chance = random.Random(seed)
    expected_values = commands(chance)
    data = written(expected_values, chance)
    found, expected = sampled(data), drawn(expected_values)

    assert [len(path) for path in found] == [len(path) for path in expected], data
    for got, path in zip(found, expected, strict=True):
        for points, segment in zip(got, path, strict=True):
            place = np.array([[p.real, p.imag] for p in segment])
            assert np.abs(points - place).max() < 1e-9, data


def test_smooth_curves_reflect_within_their_family_only() -> None:
    """SVG 1.1, 8.3.6: after a command of another family the control point is the current point."""
    for data, control in (
        ("M0 0Q10 20 20 0S30 10 40 0", (20.0, 0.0)),
        ("M0 0C0 20 20 20 20 0S30 10 40 0", (20.0, -20.0)),
    ):
        *_, last = sampled(data)[0]
        by_hand = casteljau([20 + 0j, complex(*control), 30 + 10j, 40 + 0j])
        assert last[:, 1] == pytest.approx([p.imag for p in by_hand], abs=1e-9)
    after_cubic = sampled("M0 0C0 20 20 20 20 0T40 10")[0][-1]
    assert after_cubic[:, 1] == pytest.approx(10 * U**2, abs=1e-9)  # control point: (20, 0)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ("L 3 4", "does not begin with a move"),
        ("M0 0 C1 2 3", "ends too early"),
        ("M0 0 L,1 2", "',1' at character 7"),
        ("M0 0 A5 5 0 2 0 9 9", "'2' at character 13"),
        ("M0 0 L1e999 2", "not a finite number"),
        ("M0 0 L1 2;", "';' at character 10"),
        ("M0 0 L0x10 2", "'x10' at character 8"),
    ],
)
def test_path_data_outside_the_grammar_is_refused_with_its_place(data: str, text: str) -> None:
    with pytest.raises(JobError) as caught:
        read_svg(f'{HEAD}\n<path stroke="red" d="{data}"/></svg>'.encode(), "t.svg")
    assert text in str(caught.value)
    assert "t.svg:2: " in str(caught.value)
