"""A design that cannot be sewn is refused in one line, with status 2, and nothing is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from threadline.cli.main import main

ROSETTE = Path(__file__).resolve().parents[2] / "examples" / "rosette.dst"


def refused(capsys: pytest.CaptureFixture[str], *asked: str) -> str:
    with pytest.raises(SystemExit) as left:
        main(list(asked))
    out, err = capsys.readouterr()
    assert (left.value.code, out) == (2, "")
    assert err.count("\n") == 1
    assert err.startswith("error: [")
    return err


SUFFIXES = ("dst", "exp", "pes", "jef", "vp3", "hus", "xxx", "u01", "t15")
EMPTY = [(suffix, b"") for suffix in SUFFIXES]
ODD = [(suffix, b"\xff" * 1200) for suffix in SUFFIXES if suffix != "exp"]  # it is stitches there


@pytest.mark.parametrize(("suffix", "content"), EMPTY + ODD)
def test_an_empty_design(
    suffix: str, content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / f"empty.{suffix}"
    file.write_bytes(content)
    assert file.name in refused(capsys, "prove", str(file), "-m", "schiffli-frame")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ('[shaft]\nwindow = "0 deg exact, assumed"', "must be greater than zero"),
        ('[shaft]\nwindow = "0.001 deg exact, assumed"', "into one period of the timer"),
        ('[links.x_train]\nstiffness = "0 N/m exact, assumed"', "its drive does not turn when"),
    ],
)
def test_a_window_too_short_for_the_timer_and_a_frame_that_hangs_on_nothing(
    change: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "odd.toml"
    file.write_text(f'base = "schiffli-frame"\nname = "odd"\n{change}\n', encoding="utf-8")
    assert message in refused(capsys, "prove", str(ROSETTE), "-m", str(file))


@pytest.mark.parametrize("feed", ["0 stitch/min", "-5 stitch/min", "400 stitch/min"])
def test_a_speed_that_is_none(feed: str, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["prove", str(ROSETTE), "-m", "schiffli-frame", f"--feed={feed}"]
    assert feed.split(maxsplit=1)[0] in refused(capsys, *asked)


@pytest.mark.parametrize(("records", "count"), [(bytes(40), 20), (b"\x14\x00", 1)])
def test_a_design_that_leads_nowhere_is_refused(
    records: bytes, count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Twenty stitches in one place, or one stitch alone, move nothing that could be judged."""
    file = tmp_path / "still.exp"
    file.write_bytes(records)
    message = refused(capsys, "prove", str(file), "-m", "schiffli-frame")
    assert f"the needle enters {count} times, all in one place" in message


@pytest.mark.parametrize("suffix", ["jef", "pes", "vp3", "xxx"])
def test_a_damaged_design_names_the_byte_and_no_error_of_its_reader(
    suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The reader raises TypeError, IndexError and others where bytes are lacking."""
    file = tmp_path / f"cut.{suffix}"
    begun = {"pes": b"#PES0001\x00", "vp3": b"%vsm%\x00\x00\x38P"}
    file.write_bytes(begun.get(suffix, b"\x80" * 9))
    message = refused(capsys, "prove", str(file), "-m", "schiffli-frame")
    assert "byte 9" in message and "Error" not in message


@pytest.mark.long(shown_by="test_a_damaged_design_names_the_byte_and_no_error_of_its_reader")
def test_a_card_is_not_named_as_another_format(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The ending names the format, so a card with the ending of another could not be read again."""
    asked = ["compile", str(ROSETTE), "-m", "schiffli-frame", "--target", "t15", "-o"]
    message = refused(capsys, *asked, str(tmp_path / "card.dst"))
    assert "card.t15" in message and "ends in .dst" in message
    assert not list(tmp_path.iterdir())
    for name, warned in (("card", 1), ("card.T15", 0)):
        with pytest.raises(SystemExit) as left:
            main([*asked, str(tmp_path / name)])
        err = capsys.readouterr().err
        assert (left.value.code, err.count("known by the ending .t15")) == (0, warned)


def test_a_design_that_stands_still_on_an_axis_is_sewn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Twenty stitches along X leave Y at rest."""
    file = tmp_path / "still.exp"
    file.write_bytes(b"\x14\x00" * 20)
    with pytest.raises(SystemExit) as left:
        main(["prove", str(file), "-m", "schiffli-frame", "--nominal"])
    assert left.value.code == 0, capsys.readouterr().err
