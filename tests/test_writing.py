"""All files of a command appear together or none, and no other file is overwritten."""

from __future__ import annotations

import os
import signal
import tempfile
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from threadline.base.reading import noting_inputs, open_binary
from threadline.base.writing import check_output, remove_with, staged_file, staging_folder, together
from threadline.errors import OptionError
from threadline.report.document import Document
from threadline.report.publish import write_document


def write(path: Path, text: str = "new") -> None:
    with staged_file(path) as file:
        file.write(text.encode())


def tree(folder: Path) -> dict[str, str]:
    return {
        str(f.relative_to(folder)): f.read_text() for f in sorted(folder.rglob("*")) if f.is_file()
    }


def test_files_appear_together(tmp_path: Path) -> None:
    made = tmp_path / "made" / "deep" / "a"
    with together(made):
        write(made)
        write(tmp_path / "b")
        assert not (tmp_path / "b").exists()
    assert tree(tmp_path) == {"b": "new", "made/deep/a": "new"}


def test_none_appears_where_a_later_one_fails(tmp_path: Path) -> None:
    """Neither a file nor its new folder; the old file stays."""
    (tmp_path / "old").write_text("old")
    with pytest.raises(ZeroDivisionError), together(tmp_path / "made" / "deep" / "a"):
        write(tmp_path / "made" / "deep" / "a")
        write(tmp_path / "old")
        raise ZeroDivisionError
    assert tree(tmp_path) == {"old": "old"}
    assert [p.name for p in tmp_path.iterdir()] == ["old"]


@pytest.mark.parametrize("failing", range(4))
def test_moves_are_undone_where_a_later_one_fails(
    failing: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of four moves fails in turn; one of them removes a file."""
    for name in ("a", "c"):
        (tmp_path / name).write_text("old")
    moved, replace, unlink = [], Path.replace, Path.unlink

    def fails(path: Path) -> None:
        moved.append(path)
        if len(moved) == failing + 1:
            raise OSError(28, "No space left on device")

    def replaces(self: Path, target: Path) -> Path:
        if self.name != "old":  # the saved file is put back
            fails(target)
        return replace(self, target)

    def unlinks(self: Path, missing_ok: bool = False) -> None:
        if self.name == "c":
            fails(self)
        unlink(self, missing_ok)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", replaces)
        patched.setattr(Path, "unlink", unlinks)
        with pytest.raises(OSError, match="No space left"), together(tmp_path / "made" / "b"):
            write(tmp_path / "a")
            write(tmp_path / "made" / "b")
            remove_with(tmp_path / "c")
            write(tmp_path / "d")
    assert len(moved) == failing + 1
    assert tree(tmp_path) == {"a": "old", "c": "old"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "c"]


def test_an_interrupt_between_the_moves_waits_for_the_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace = Path.replace

    def interrupted(self: Path, target: Path) -> Path:
        os.kill(os.getpid(), signal.SIGINT)
        return replace(self, target)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(Path, "replace", interrupted)
    try:
        with pytest.raises(KeyboardInterrupt), together():
            write(tmp_path / "a")
            write(tmp_path / "b")
    finally:
        signal.signal(signal.SIGINT, before)
    assert tree(tmp_path) == {"a": "new", "b": "new"}


@pytest.mark.parametrize("makes", ["tempfile.mkstemp", "tempfile.mkdtemp", "pathlib.Path.mkdir"])
def test_an_interrupt_behind_what_is_made_leaves_nothing_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, makes: str
) -> None:
    """It comes when the file or folder exists, and nothing has recorded that yet."""
    module, name = makes.removesuffix(".mkdir"), makes.rpartition(".")[2]
    owner = Path if module == "pathlib.Path" else tempfile
    make = getattr(owner, name)

    def interrupted(*args: object, **keywords: object) -> object:
        made = make(*args, **keywords)
        os.kill(os.getpid(), signal.SIGINT)
        return made

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), together():
            monkeypatch.setattr(owner, name, interrupted)
            if name == "mkstemp":
                write(tmp_path / "a")
            else:
                with staging_folder(tmp_path / "new") as folder:
                    (folder / "a").write_text("new")
    finally:
        signal.signal(signal.SIGINT, before)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_was_read_is_kept_however_it_is_reached(tmp_path: Path) -> None:
    """By its name, by links of both kinds, by another spelling; read before or in between."""
    read = tmp_path / "read"
    read.write_text("mine")
    (tmp_path / "soft").symlink_to("read")
    (tmp_path / "hard").hardlink_to(read)
    (tmp_path / "loop").mkdir()
    names = [read, tmp_path / "soft", tmp_path / "hard", tmp_path / "loop" / ".." / "read"]
    for name in names:
        with noting_inputs():
            open_binary(read).close()
            with pytest.raises(OptionError, match="would be overwritten"):
                write(name)
        with noting_inputs(), pytest.raises(OptionError, match="overwritten"), together():
            write(name)
            open_binary(read).close()
    assert set(tree(tmp_path).values()) == {"mine"}
    write(read)  # nobody has read it now
    assert tree(tmp_path)["soft"] == "new"


def test_links_are_followed(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    for name, old in (("full", "old"), ("dangling", None)):
        target, link = tmp_path / "there" / name, tmp_path / name
        link.symlink_to(target)
        if old is not None:
            target.write_text(old)
        write(link)
        assert link.is_symlink()
        assert target.read_text() == "new"
    circle = tmp_path / "circle"
    circle.symlink_to(circle)
    with pytest.raises(OptionError, match="cannot write"):
        write(circle)


def test_read_only_files_and_folders_stay(tmp_path: Path) -> None:
    """This also holds if the user could write everything, as root can."""
    kept = tmp_path / "kept"
    kept.write_text("old")
    kept.chmod(0o444)
    with pytest.raises(OptionError, match="it is read-only"):
        write(kept)
    with pytest.raises(OptionError, match="it is a folder"):
        write(tmp_path)
    with pytest.raises(OptionError, match="pipe or a device"):
        check_output(Path("/dev/full"))
    assert kept.read_text() == "old"


def test_one_file_is_not_written_twice(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("a")
    with pytest.raises(OptionError, match="is written twice"), together():
        write(tmp_path / "a")
        write(tmp_path / "link")
    assert tree(tmp_path) == {}


def test_permissions_are_the_usual_ones_or_those_that_were_there(tmp_path: Path) -> None:
    (tmp_path / "old").write_text("")
    (tmp_path / "old").chmod(0o640)
    before = os.umask(0o027)
    try:
        write(tmp_path / "old")
        write(tmp_path / "new")
    finally:
        os.umask(before)
    assert [(tmp_path / n).stat().st_mode & 0o777 for n in ("old", "new")] == [0o640, 0o640]


def test_a_folder_of_files_appears_file_by_file(tmp_path: Path) -> None:
    (tmp_path / "report" / "report.html").mkdir(parents=True)
    with pytest.raises(OptionError, match="it is a folder"), together():
        write(tmp_path / "run.csv")
        with staging_folder(tmp_path / "report") as made:
            (made / "a.svg").write_text("new")
            (made / "report.html").write_text("new")
    assert tree(tmp_path) == {}


def test_old_figures_go_with_the_page_that_had_them(tmp_path: Path) -> None:
    """And no other file goes."""

    def report(*names: str) -> list[str]:
        document = Document(
            title="a", subtitle="b", verdicts=[], tables=[], facts=[], captions={},
            figures={name: Figure(figsize=(1, 1)) for name in names},
        )  # fmt: skip
        write_document(document, tmp_path, "report")
        return sorted(path.name for path in tmp_path.iterdir())

    (tmp_path / "report-mine.svg").write_text("no figure of ours")
    report("one", "two")
    assert report("two", "three") == [
        "report-mine.svg", "report-three.png", "report-three.svg", "report-two.png",
        "report-two.svg", "report.html", "report.pdf",
    ]  # fmt: skip
