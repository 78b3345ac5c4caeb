"""A drawing that would explode is refused beforehand, and a long one stays within its budget."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from functools import partial
from pathlib import Path

import ezdxf
import ezdxf.tools.text
import pytest

from threadline.errors import JobError
from threadline.geometry import read_dxf
from threadline.geometry.svg import read_svg


def saved(folder: Path, document: ezdxf.document.Drawing) -> Path:
    path = folder / "made.dxf"
    document.saveas(path)
    return path


def read(path: Path) -> read_dxf.Drawing:
    return read_dxf.read_dxf(path.read_bytes(), str(path))


def nested(levels: int) -> ezdxf.document.Drawing:
    """Return blocks that each hold ten copies of the next block."""
    document = ezdxf.new(units=4)
    document.blocks.new("B0").add_line((0, 0), (1, 0))
    for k in range(1, levels):
        block = document.blocks.new(f"B{k}")
        for j in range(10):
            block.add_blockref(f"B{k - 1}", (j, 0))
    document.modelspace().add_blockref(f"B{levels - 1}", (0, 0))
    return document


def test_nine_levels_of_ten_copies_are_refused_before_they_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They would make a thousand million lines; the reader follows none of them."""
    path = saved(tmp_path, nested(10))
    monkeypatch.setattr(read_dxf, "entity_pieces", None)  # calling it would be a TypeError
    with pytest.raises(JobError) as caught:
        read(path)
    assert "make more than 200000 entities" in str(caught.value)
    assert "made.dxf:" in str(caught.value)
    assert caught.value.place is not None and caught.value.place.line > 0


def test_copies_within_the_budget_are_all_there(tmp_path: Path) -> None:
    assert len(read(saved(tmp_path, nested(4))).strokes) == 1000


def test_a_repeated_insert_counts_as_often(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    document = ezdxf.new(units=4)
    document.blocks.new("B").add_line((0, 0), (1, 0))
    attributes = {"row_count": 30, "column_count": 30, "row_spacing": 2, "column_spacing": 2}
    document.modelspace().add_blockref("B", (0, 0), dxfattribs=attributes)
    path = saved(tmp_path, document)
    assert len(read(path).strokes) == 900
    monkeypatch.setattr(read_dxf, "MAX_LINES", 899)
    with pytest.raises(JobError, match="more than 899 entities"):
        read(path)


@pytest.mark.parametrize("kind", ["TEXT", "MTEXT"])
def test_only_the_beginning_of_a_text_is_looked_at(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ezdxf needs the square of a text's length to make it plain: a minute for a megabyte."""
    document = ezdxf.new(units=4)
    document.modelspace().add_line((0, 0), (1, 0))
    getattr(document.modelspace(), f"add_{kind.lower()}")("collar " * 20_000)
    path = saved(tmp_path, document)
    lengths = []

    def noted(original: Callable[[str], str], text: str) -> str:
        lengths.append(len(text))
        return original(text)

    for name in ("plain_text", "fast_plain_mtext"):
        original = getattr(ezdxf.tools.text, name)
        monkeypatch.setattr(ezdxf.tools.text, name, partial(noted, original))
    (refusal,) = read(path).refusals

    assert "'collar collar collar collar collar colla'" in refusal.message
    assert len(lengths) == 1 and lengths[0] <= 1000


def test_a_line_of_a_drawing_takes_little_memory(tmp_path: Path) -> None:
    """A line takes 4 kB with all that ezdxf keeps, so 200 000 lines fit into a gigabyte."""
    document = ezdxf.new(units=4)
    for k in range(2000):
        document.modelspace().add_line((k, 0), (k, 1))
    path = saved(tmp_path, document)
    read(path)  # modules that are loaded once do not count
    tracemalloc.start()
    drawing = read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()

    assert len(drawing.strokes) == 2000
    assert peak < 2000 * 8192


def test_clones_of_an_svg_have_a_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(read_svg.__globals__, "MAX_LINES", 5)
    body = '<path id="a" stroke="red" d="M0 0H9"/>' + '<use href="#a"/>' * 5
    text = f'<svg xmlns="http://www.w3.org/2000/svg" width="9mm" height="9mm">{body}</svg>'
    with pytest.raises(JobError, match=r"t\.svg:1: the drawing and its clones have more than 5"):
        read_svg(text.encode(), "t.svg")


@pytest.mark.parametrize(
    ("code", "metres"), [(1, 0.0254), (9, 2.54e-5), (14, 0.1), (21, 1200 / 3937), (24, 1609.347219)]
)
def test_every_unit_of_a_dxf(code: int, metres: float, tmp_path: Path) -> None:
    """Mils and surveyors' units once ended in a traceback."""
    document = ezdxf.new(units=code)
    document.modelspace().add_line((0, 0), (1, 0))
    (stroke,) = read(saved(tmp_path, document)).strokes
    assert stroke.pieces.ends()[1][0][0] == pytest.approx(metres, rel=1e-9)
