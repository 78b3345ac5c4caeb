"""``equal`` for step tables of an embroidery frame: by the documented format and the law alone."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import struct
from pathlib import Path

import pytest

import threadline as tl
from threadline.errors import InputError
from threadline.readback.equal import Equal

FRAME = "table-embroiderer"
DESIGN = Path(__file__).resolve().parents[2] / "examples" / "rosette.dst"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("tables")
    tl.compile(DESIGN, FRAME, "steps", made / "r.json")
    return made


def copied(folder: Path, tmp_path: Path) -> Path:
    for file in folder.iterdir():
        shutil.copy(file, tmp_path / file.name)
    return tmp_path / "r.json"


def signed(manifest: Path) -> None:
    """Make the manifest name the files as they are now."""
    meta = json.loads(manifest.read_text())
    for name in meta["files"]:
        meta["files"][name] = hashlib.sha256(manifest.with_name(name).read_bytes()).hexdigest()
    manifest.write_text(json.dumps(meta, indent=1, sort_keys=True) + "\n")


def beside(file: Path) -> Equal:
    return tl.equal(DESIGN, FRAME, files=[f"steps={file}"]).targets[0]


def test_tables_are_the_plan_within_a_step_and_a_period() -> None:
    """Each step comes when the law has it due, to half a count of rounding."""
    (one,) = tl.equal(DESIGN, FRAME, ["steps"]).targets
    assert one.verdict == "equal" and one.unit == "step"
    assert one.place is not None and 0.0 < one.place < 0.1
    assert one.time_s is not None and one.time_limit_s is not None
    assert 0.4 < one.time_s / one.time_limit_s <= 1.0
    assert one.tool_m == pytest.approx(0.0, abs=1e-6)


def test_an_interval_in_the_binary_file_is_found(folder: Path, tmp_path: Path) -> None:
    """One number of a table, and the hashes made to agree: the step comes 5 counts late."""
    manifest = copied(folder, tmp_path)
    binary = tmp_path / "r.tables.bin"
    content = bytearray(binary.read_bytes())
    at = 12
    for _ in range(38):
        at += 8 + 4 * struct.unpack_from("<I", content, at + 4)[0]
    before, behind = struct.unpack_from("<II", content, at + 8 + 40)
    struct.pack_into("<II", content, at + 8 + 40, before + 5, behind - 5)
    binary.write_bytes(content)
    one = beside(manifest)
    assert one.verdict == "differs" and "its SHA-256 is another one" in one.note
    signed(manifest)
    one = beside(manifest)
    assert one.verdict == "differs" and "table 38 of the text" in one.note
    assert one.time_s is not None and one.time_limit_s is not None
    assert 4.0 < one.time_s / one.time_limit_s < 6.0
    assert "step 11 of table 38" in one.at


def test_a_sign_in_a_turn_is_found_in_place(folder: Path, tmp_path: Path) -> None:
    """One move goes the other way: from there on the place is off by twice its length."""
    manifest = copied(folder, tmp_path)
    binary = tmp_path / "r.stitches.bin"
    content = bytearray(binary.read_bytes())
    row = 8 + 8 + 4 + 4 + 4 * 4 + 8
    (sign,) = struct.unpack_from("<i", content, 12 + 60 * row + 28)
    assert abs(sign) == 1
    struct.pack_into("<i", content, 12 + 60 * row + 28, -sign)
    binary.write_bytes(content)
    signed(manifest)
    one = beside(manifest)
    assert one.verdict == "differs" and one.at == "turn 60" and one.axis == "X"
    (table,) = struct.unpack_from("<i", content, 12 + 60 * row + 24)
    meta = json.loads(manifest.read_text())
    per_unit = 1e-4 * meta["steps_per_m"][0]
    assert one.place == pytest.approx(2 * (table + 1) * per_unit)
    assert one.tool_m == pytest.approx(2 * (table + 1) * 1e-4)


@pytest.mark.parametrize(
    ("name", "pattern", "to"),
    [
        ("r.tables.csv", rb"\n3,(\d)", rb"\n3,9\1"),
        ("r.stitches.csv", rb"\n7,(\d)", rb"\n7,9\1"),
        ("r.events.csv", rb"end", rb"and"),
        ("r.json", rb'"duration_ticks": (\d)', rb'"duration_ticks": 9\1'),
    ],
)
def test_a_digit_of_a_text_is_found(
    folder: Path, tmp_path: Path, name: str, pattern: bytes, to: bytes
) -> None:
    manifest = copied(folder, tmp_path)
    file = tmp_path / name
    changed = re.sub(pattern, to, file.read_bytes(), count=1)
    if changed == file.read_bytes():
        changed = file.read_bytes().replace(b"stop", b"stap", 1) + b"9"
    file.write_bytes(changed)
    one = beside(manifest)
    assert one.verdict == "differs" and one.note


def test_foreign_files_are_refused_in_one_line(folder: Path, tmp_path: Path) -> None:
    """Another job, machine, version; cut, empty, binary, missing beside it; another format."""
    manifest = copied(folder, tmp_path)
    text = manifest.read_text()
    for content, message in [
        (re.sub(r'(job_sha256": ")....', r"\g<1>0000", text), "another job"),
        (re.sub(r'(machine_sha256": ")....', r"\g<1>0000", text), "another machine file"),
        (re.sub(r'(threadline": ")\d', r"\g<1>9", text), "another version of Threadline"),
        (text[:-40], "no set of step tables"),
        ("", "is empty"),
        ("{}", "its format is not"),
        (text.replace("r.tables.bin", "../r.tables.bin"), "not beside it"),
        (text.replace("r.tables.bin", "q.tables.bin"), "q.tables.bin is missing beside it"),
        ("\x00\x01", "no set of step tables"),
    ]:
        manifest.write_text(content)
        with pytest.raises(InputError, match=re.escape(message)) as refused:
            beside(manifest)
        assert "\n" not in str(refused.value)
    manifest.write_text(text)
    binary = tmp_path / "r.stitches.bin"
    binary.write_bytes(binary.read_bytes()[:-3])
    with pytest.raises(InputError, match="are not 194 turns of 48 bytes"):
        beside(manifest)
