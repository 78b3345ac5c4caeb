"""``equal`` beside hostile files: one line, soon, and no wrong answer."""

from __future__ import annotations

import errno
import io
import json
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import threadline as tl
from threadline.errors import InputError
from threadline.readback.equal import Equal
from threadline.readback.equal_schedule import Controller
from threadline.readback.scan_language import read_body, read_units
from threadline.readback.scan_units import of_plcopen
from threadline.readback.scan_words import ScanError

WINDER, FRAME = "lathe-winder", "table-embroiderer"
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
DESIGN = EXAMPLES / "rosette.dst"
Change = Callable[[dict[str, Any]], object]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("tables")
    (made / "a.prg").write_text("G91 G1 X2 A10 F600\nX-2 A-5\nM30\n")
    for target in ("csv", "ticks", "npz", "grbl"):
        tl.compile(made / "a.prg", WINDER, target, made / f"a.{target}")
    tl.compile(DESIGN, FRAME, "steps", made / "r.json")
    return made


def beside(folder: Path, target: str, file: Path) -> Equal:
    return tl.equal(folder / "a.prg", WINDER, files=[f"{target}={file}"]).targets[0]


@pytest.mark.parametrize("target", ["csv", "grbl"])
def test_a_full_disk_is_told_by_the_folder_that_may_be_changed(
    target: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``equal`` writes temporary files: the user named none of them, and cannot name others."""

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("threadline.base.writing.os.replace", full)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(InputError, match="do not fit on the disk of") as caught:
        tl.equal(folder / "a.prg", WINDER, [target])
    assert str(tmp_path) in str(caught.value) and "TMPDIR" in caught.value.remedy
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    ("target", "pattern", "to", "message"),
    [
        ("ticks", r"\n1,0,", "\n1000000000000,0,", "far more than the plan"),
        ("ticks", r"\n1,0,", "\n-5,0,", "-5 ticks"),
        ("ticks", r"\n1,0,", f"\n1,{'9' * 30},", "no count"),
        ("csv", r"\n30,-?\d+,", f"\n30,{'9' * 30},", "no count"),
        ("csv", r'"1/200"', '"1e99999999"', "no time"),
        ("csv", r'"1/200"', "Infinity", "no time"),
        ("csv", r"# clock: .*\n", "", "'clock' is missing"),
        ("csv", r"(# counts_per_unit: ).*\n", "\\g<1>3\n", "not iterable"),
        ("csv", r"(# start_counts: ).*\n", '\\g<1>"abc"\n', "one count for each"),
        ("csv", r"(# start_counts: ).*\n", "\\g<1>[0.4, 0, 0]\n", "no count"),
        ("csv", r"(# start_counts: ).*\n", f"\\g<1>{'[' * 100_000}\n", "too deep"),
        ("csv", r"\n30,", f"\n{'x' * 200_000},", "field larger"),
    ],
)
def test_a_hostile_text_table_is_refused(
    folder: Path, tmp_path: Path, target: str, pattern: str, to: str, message: str
) -> None:
    text = (folder / f"a.{target}").read_text()
    changed = re.sub(pattern, to, text, count=1)
    assert changed != text
    (tmp_path / f"a.{target}").write_text(changed)
    with pytest.raises(InputError, match=re.escape(message)) as refused:
        beside(folder, target, tmp_path / f"a.{target}")
    assert f"no table of target {target}" in str(refused.value)


def archive(folder: Path, file: Path, **parts: bytes) -> Path:
    """Write the archive of the plan with other parts."""
    with zipfile.ZipFile(folder / "a.npz") as own, zipfile.ZipFile(file, "w") as made:
        for name in own.namelist():
            made.writestr(name, parts.pop(name.partition(".")[0], own.read(name)))
        for name, content in parts.items():
            made.writestr(f"{name}.npy", content)
    return file


def array(values: np.ndarray[Any, Any]) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array(file, values)
    return file.getvalue()


def counts_of(folder: Path) -> np.ndarray[Any, Any]:
    with np.load(folder / "a.npz") as own:
        return np.array(own["counts"])


def test_an_archive_with_one_changed_bit_is_not_equal(folder: Path, tmp_path: Path) -> None:
    """No checksum covers the heads of its members: dates, sizes, attributes."""
    own, file = (folder / "a.npz").read_bytes(), tmp_path / "a.npz"
    heads = [m.start() for m in re.finditer(b"PK..", own, re.S)]
    assert len(heads) > 8
    random = np.random.default_rng(39)
    places = [*(at + k for at in (heads[0], heads[-2], heads[-1]) for k in (5, 11, 14))]
    places += random.integers(len(own), size=5).tolist()
    for place in places:
        changed = bytearray(own)
        changed[place] ^= 1 << int(random.integers(8))
        file.write_bytes(changed)
        try:
            verdict = beside(folder, "npz", file).verdict
        except InputError:
            continue
        assert verdict == "differs", place


def test_an_archive_of_other_numbers_is_refused(folder: Path, tmp_path: Path) -> None:
    """NaN, fractions, and a count whose difference wraps round in 64 bits."""
    counts = counts_of(folder)
    assert beside(folder, "npz", archive(folder, tmp_path / "same.npz")).verdict == "equal"
    nan, part = counts.astype(float), counts.astype(float)
    nan[20, 0], part[20, 0] = np.nan, part[20, 0] + 0.4
    wraps = counts.copy()
    wraps[20, 0] = -(2**63)
    for values, message in [(nan, "float64"), (part, "float64"), (wraps, "beyond")]:
        with pytest.raises(InputError, match=message):
            beside(folder, "npz", archive(folder, tmp_path / "a.npz", counts=array(values)))


def test_an_archive_that_says_it_is_huge_is_refused(folder: Path, tmp_path: Path) -> None:
    """A short file that claims 240 TB is a wrong file, and not a job that is too long."""
    head = io.BytesIO()
    shape = {"descr": "<i8", "fortran_order": False, "shape": (10**13, 3)}
    np.lib.format.write_array_header_1_0(head, shape)
    file = archive(folder, tmp_path / "a.npz", counts=head.getvalue())
    with pytest.raises(InputError, match=r"a\.npz: .*shorter than it says"):
        beside(folder, "npz", file)


def test_an_archive_with_a_spoilt_part_is_refused(folder: Path, tmp_path: Path) -> None:
    """Bytes that cannot be unpacked, and an archive that is locked by a password."""
    packed = tmp_path / "packed.npz"
    with (
        zipfile.ZipFile(folder / "a.npz") as own,
        zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as made,
    ):
        for name in own.namelist():
            made.writestr(name, own.read(name))
        inside = made.getinfo("counts.npy")
    content = bytearray(packed.read_bytes())
    begin = inside.header_offset + 30 + len("counts.npy")
    content[begin : begin + 40] = b"\xff" * 40
    packed.write_bytes(bytes(content))
    with pytest.raises(InputError, match="no table of target npz"):
        beside(folder, "npz", packed)
    locked = bytearray((folder / "a.npz").read_bytes())
    for at in (m.start() for m in re.finditer(rb"PK\x01\x02", bytes(locked))):
        locked[at + 8] |= 1
    packed.write_bytes(bytes(locked))
    with pytest.raises(InputError, match="no table of target npz"):
        beside(folder, "npz", packed)


def test_an_added_part_of_an_archive_is_told(folder: Path, tmp_path: Path) -> None:
    one = beside(folder, "npz", archive(folder, tmp_path / "a.npz", more=array(np.zeros(3))))
    assert one.verdict == "differs" and "'more'" in one.note


@pytest.mark.parametrize("mark", ["\x0b", "\x0c", "\x1c", "\x85", "\u2028"])
def test_a_line_end_that_no_controller_knows_is_found(
    folder: Path, tmp_path: Path, mark: str
) -> None:
    """Python ends a line at each of these, and a controller reads on as one long line."""
    file = tmp_path / "a.csv"
    file.write_text((folder / "a.csv").read_text().replace("\n", mark, 1), encoding="utf-8")
    one = beside(folder, "csv", file)
    assert one.verdict == "differs" and "line 1 is " in one.note


def test_a_blank_that_no_controller_knows_is_found(folder: Path, tmp_path: Path) -> None:
    """A no-break space at the end of a line is no blank."""
    file = tmp_path / "a.csv"
    text = (folder / "a.csv").read_text().replace("ticks: ", "ticks: \u00a0")
    file.write_text(text.rstrip("\n") + "\u00a0\n", encoding="utf-8")
    assert beside(folder, "csv", file).verdict == "differs"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda meta: meta.update(timer_s="1e99999999"), "no time"),
        (lambda meta: meta.update(timer_s="abc"), "no time"),
        (lambda meta: meta.pop("timer_s"), "'timer_s' is missing"),
        (lambda meta: meta.pop("job_sha256"), "'job_sha256' is missing"),
        (lambda meta: meta.pop("law"), "'law' is missing"),
        (lambda meta: meta.update(axes=[*meta["axes"], "Z"]), "it has the axes"),
        (lambda meta: meta.update(files=3), "no attribute 'items'"),
    ],
)  # fmt: skip
def test_a_hostile_manifest_is_refused(
    folder: Path, tmp_path: Path, change: Change, message: str
) -> None:
    manifest = _copied(folder, tmp_path)
    meta = json.loads(manifest.read_text())
    change(meta)
    manifest.write_text(json.dumps(meta))
    with pytest.raises(InputError, match=message) as refused:
        tl.equal(DESIGN, FRAME, files=[f"steps={manifest}"])
    assert "no set of step tables" in str(refused.value)


def test_a_manifest_that_is_too_deep_is_refused(folder: Path, tmp_path: Path) -> None:
    manifest = _copied(folder, tmp_path)
    manifest.write_text("[" * 100_000)
    with pytest.raises(InputError, match=r"no set of step tables: .* too deep"):
        tl.equal(DESIGN, FRAME, files=[f"steps={manifest}"])


def test_a_set_without_tables_is_refused(folder: Path, tmp_path: Path) -> None:
    manifest = _copied(folder, tmp_path)
    (tmp_path / "r.tables.bin").write_bytes(b"TLSTEPT1" + bytes(4))
    with pytest.raises(InputError, match="it has no tables"):
        tl.equal(DESIGN, FRAME, files=[f"steps={manifest}"])


def _copied(folder: Path, tmp_path: Path) -> Path:
    for file in folder.glob("r.*"):
        shutil.copy(file, tmp_path / file.name)
    return tmp_path / "r.json"


DECLARED = "PROGRAM p VAR i : DINT; j : DINT; s : STRING := 'ab'; END_VAR {} END_PROGRAM"
NESTED = (
    "i := 0; WHILE i < 90000 DO i := i + 1; j := 0; "
    "WHILE j < 90000 DO j := j + 1; END_WHILE; END_WHILE;"
)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (NESTED, "its loop never ends"),
        ("i := i + 3; i := i * i;", "larger than any number"),
        ("s := s + s;", "no numbers"),
        ("i := 1000000000000 * 1000000000000;", "larger than any number"),
    ],
)
def test_a_body_that_grows_without_end_ends(body: str, message: str) -> None:
    controller = Controller(list(read_units(DECLARED.format(body))))

    def run() -> None:
        for scan in range(60):
            controller.scan({}, scan)

    with pytest.raises(ScanError, match=message):
        run()


def test_blocks_inside_themselves_are_refused() -> None:
    """Two that contain each other, and a tower in which each block has two of the next."""
    each = (
        "FUNCTION_BLOCK a VAR x : b; END_VAR END_FUNCTION_BLOCK "
        "FUNCTION_BLOCK b VAR x : a; END_VAR END_FUNCTION_BLOCK "
        "PROGRAM p VAR x : a; END_VAR END_PROGRAM"
    )
    with pytest.raises(ScanError, match="inside itself"):
        Controller(list(read_units(each)))
    tower = "".join(
        f"FUNCTION_BLOCK b{k} VAR x : b{k + 1}; y : b{k + 1}; END_VAR END_FUNCTION_BLOCK "
        for k in range(40)
    )
    last = "FUNCTION_BLOCK b40 VAR x : BOOL; END_VAR END_FUNCTION_BLOCK "
    with pytest.raises(ScanError, match="deep in one another"):
        Controller([*read_units(tower + last + "PROGRAM p VAR x : b0; END_VAR END_PROGRAM")])


@pytest.mark.parametrize(
    "text",
    [
        f"PROGRAM p VAR i : INT := {'9' * 6000}; END_VAR END_PROGRAM",
        f"PROGRAM p VAR t : TIME := T#{'9' * 400}s; END_VAR END_PROGRAM",
        "PROGRAM p VAR a : ARRAY [0..2] OF INT := ['x'(3)]; END_VAR END_PROGRAM",
        "PROGRAM p VAR a : ARRAY [0..2] OF INT := [999999999(3)]; END_VAR END_PROGRAM",
    ],
)
def test_constants_beyond_any_controller_are_refused(text: str) -> None:
    with pytest.raises(ScanError):
        list(read_units(text))
    with pytest.raises(ScanError):
        read_body(f"i := {'9' * 6000};")


@pytest.mark.parametrize("encoding", ["gb2312", "nonsense"])
def test_an_encoding_that_xml_lacks_is_refused(tmp_path: Path, encoding: str) -> None:
    file = tmp_path / "a.xml"
    file.write_text(f'<?xml version="1.0" encoding="{encoding}"?><project/>')
    with pytest.raises(ScanError, match="encoding"):
        of_plcopen(file)
