"""``equal`` for designs on tapes: pystitch reads the files of Threadline's own writers."""

from __future__ import annotations

from pathlib import Path

import pytest

import threadline as tl
from threadline.errors import InputError
from threadline.readback.equal import Equal

FRAME = "table-embroiderer"
DESIGN = Path(__file__).resolve().parents[2] / "examples" / "rosette.dst"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("tapes")
    for target in "dst", "u01":
        tl.compile(DESIGN, FRAME, target, made / f"r.{target}")
    return made


def beside(file: Path) -> Equal:
    return tl.equal(DESIGN, FRAME, files=[f"{file.suffix[1:]}={file}"]).targets[0]


@pytest.mark.parametrize("target", ["dst", "u01"])
def test_a_tape_is_the_plan(target: str, folder: Path) -> None:
    one = beside(folder / f"r.{target}")
    assert (one.verdict, one.reader, one.place, one.note) == (
        "equal", "pystitch", 0.0, "a tape has no times: the machine makes its own",
    )  # fmt: skip


def test_a_card_that_nothing_else_reads_is_skipped(folder: Path) -> None:
    found = {one.target: one for one in tl.equal(DESIGN, FRAME, ["dst", "t15"]).targets}
    assert found["dst"].verdict == "equal" and found["t15"].verdict == "skipped"


@pytest.mark.parametrize(("target", "head", "byte"), [("dst", 512, 0), ("u01", 256, 1)])
def test_a_stitch_that_moved_is_found(
    target: str, head: int, byte: int, folder: Path, tmp_path: Path
) -> None:
    """One displacement of a stitch is a tenth of a millimetre longer: all later ones are off."""
    file = tmp_path / f"r.{target}"
    content = bytearray((folder / file.name).read_bytes())
    content[head + 3 * 40 + byte] ^= 0x01
    file.write_bytes(content)
    one = beside(file)
    assert one.verdict == "differs" and one.place == pytest.approx(1e-4)
    assert one.at.startswith("stitch ")


def test_a_change_that_moves_nothing_is_found(folder: Path, tmp_path: Path) -> None:
    """A digit of the head; the design cut off; zeros; no design."""
    whole = (folder / "r.dst").read_bytes()
    file = tmp_path / "r.dst"
    file.write_bytes(whole.replace(b"+X:", b"-X:", 1))
    assert "differs from the byte that compile writes" in beside(file).note
    assert beside(file).verdict == "differs"
    file.write_bytes(whole[: len(whole) // 2])
    one = beside(file)
    assert one.verdict == "differs" and "stitches, the plan has" in one.note
    file.write_bytes(bytes(600))
    assert beside(file).verdict == "differs"
    for content in b"", b"no design at all":
        file.write_bytes(content)
        with pytest.raises(InputError) as caught:
            beside(file)
        assert "\n" not in str(caught.value) and "r.dst" in str(caught.value)
