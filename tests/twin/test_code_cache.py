"""Machine code of the twin on disk: made once, whole, and never taken from another module."""

from __future__ import annotations

import ast
import os
import threading
from ctypes import CFUNCTYPE, c_int64
from pathlib import Path

import llvmlite.binding as llvm
import pytest
from llvmlite import ir

from threadline.twin.kernel import compiler as compiling
from threadline.twin.kernel import run
from threadline.twin.kernel.compiler import CodeCache, Compiler
from threadline.twin.kernel.shape import Shape

INTEGER = ir.IntType(64)


def adds(number: int) -> ir.Module:
    """A module whose function ``f`` adds ``number``."""
    module = ir.Module("made")
    function = ir.Function(module, ir.FunctionType(INTEGER, [INTEGER]), "f")
    builder = ir.IRBuilder(function.append_basic_block())
    builder.ret(builder.add(function.args[0], ir.Constant(INTEGER, number)))
    return module


def answer(folder: Path, number: int) -> int:
    """Return ``100 + number``, by a compiler that has made nothing yet."""
    compiler = Compiler(CodeCache(folder))
    return int(CFUNCTYPE(c_int64, c_int64)(compiler.address(lambda: adds(number), "f"))(100))


def files(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


def test_another_process_need_not_make_it_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert answer(tmp_path, 7) == 107

    def makes(*_: object) -> None:
        raise AssertionError("made again")

    monkeypatch.setattr(llvm, "create_pass_builder", makes)
    assert answer(tmp_path, 7) == 107
    with pytest.raises(AssertionError, match="made again"):
        answer(tmp_path, 8)


@pytest.mark.parametrize("other", ["another-processor", "another version"])
def test_code_of_another_processor_or_version_is_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, other: str
) -> None:
    answer(tmp_path, 7)
    if other == "another version":
        monkeypatch.setattr("llvmlite.__version__", "0.0.0")
    else:
        monkeypatch.setattr(llvm, "get_host_cpu_features", lambda: llvm.FeatureMap(mmx=True))
    answer(tmp_path, 7)
    assert len(files(tmp_path)) == 2


@pytest.mark.parametrize("harm", ["cut", "changed", "emptied"])
def test_a_harmed_file_is_made_again(tmp_path: Path, harm: str) -> None:
    answer(tmp_path, 7)
    (file,) = files(tmp_path)
    whole = file.read_bytes()
    changed = whole[:200] + bytes([whole[200] ^ 255]) + whole[201:]
    file.write_bytes({"cut": whole[:-1], "changed": changed, "emptied": b""}[harm])
    assert answer(tmp_path, 7) == 107
    assert file.read_bytes() == whole


def test_kernel_is_made_each_time_without_a_writable_folder(tmp_path: Path) -> None:
    file = tmp_path / "no folder"
    file.write_text("a file")
    assert answer(file, 7) == 107
    assert file.read_text() == "a file"
    assert files(tmp_path) == [file]


def test_least_recently_used_code_is_removed_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiling, "MOST", 2)
    code = CodeCache(tmp_path)
    for age, name in ((9, "old"), (8, "asked for")):
        code.write(name, name.encode())
        for file in set(files(tmp_path)):
            if file.stat().st_mtime > 1000.0:
                os.utime(file, (100.0 - age, 100.0 - age))
    assert code.read("asked for") == b"asked for"
    code.write("new", b"new")
    assert code.read("old") is None
    assert code.read("asked for") == b"asked for"
    assert code.read("new") == b"new"


def by_shape(folder: Path, shape: str, number: int, written: list[int]) -> int:
    """Return ``100 + number`` from a module known by a shape, and record that it was written."""

    def write() -> ir.Module:
        written.append(number)
        return adds(number)

    compiler = Compiler(CodeCache(folder))
    return int(CFUNCTYPE(c_int64, c_int64)(compiler.address(write, "f", shape))(100))


def test_kernel_with_a_known_shape_is_not_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[int] = []
    assert by_shape(tmp_path, "seven", 7, written) == 107
    assert by_shape(tmp_path, "seven", 7, written) == 107
    assert written == [7]
    assert by_shape(tmp_path, "eight", 8, written) == 108
    assert written == [7, 8]
    # Other sources write another module for the same shape.
    monkeypatch.setattr(compiling, "WRITTEN_BY", "others")
    assert by_shape(tmp_path, "seven", 9, written) == 109
    # Without sources the text of the module identifies it.
    monkeypatch.setattr(compiling, "WRITTEN_BY", "")
    assert by_shape(tmp_path, "seven", 10, written) == 110
    assert by_shape(tmp_path, "seven", 11, written) == 111
    assert written == [7, 8, 9, 10, 11]


def test_the_kernel_of_a_machine_is_known_by_its_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    reports: list[str] = []
    monkeypatch.setattr(
        Compiler, "address", lambda _self, _write, _name, shape="": reports.append(shape) or 1
    )
    shape = Shape(
        lanes=1, width=1, matrix=((0,),), drives=(), controllers=(), axes=(), guards=(), inputs=0,
        lengths=1, terms=1, sections=1, peak=False, quantised=False, delayed=False, shared=False,
        kinds=(), uniform=(), observing=(),
    )  # fmt: skip
    for one in (shape, shape._replace(terms=2)):
        run._kernel.__wrapped__(one)
    assert reports == [repr(shape), repr(shape._replace(terms=2))]


def test_the_digest_is_of_all_sources_that_write_a_kernel() -> None:
    """All imports of ``run`` are in its folder or in ``_OTHERS``; arrays and caches write none."""
    folder = Path(str(compiling.__file__)).parent
    package = "threadline.twin.kernel."
    known = {module.__name__ for module in compiling._OTHERS}
    seen, outside, ahead = set(), set(), ["run"]
    while ahead:
        name = ahead.pop()
        seen.add(name)
        for node in ast.walk(ast.parse((folder / f"{name}.py").read_text("utf-8"))):
            if not isinstance(node, ast.ImportFrom) or not str(node.module).startswith("threadl"):
                continue
            module = str(node.module)
            if module.startswith(package):
                ahead += {module.removeprefix(package)} - seen
            else:
                outside |= (
                    {module} if module in known else {f"{module}.{a.name}" for a in node.names}
                )
    assert {"tick", "exits", "code", "names"} <= seen
    assert outside - known == {
        "threadline.base.arrays.FloatArray",
        "threadline.base.compiled.FileLock",
        "threadline.base.compiled.cache_folder",
    }


def test_second_process_waits_for_the_maker_of_the_same_kernel(tmp_path: Path) -> None:
    """This stands for another process: a lock on a file belongs to the one who opened it."""
    maker, other = CodeCache(tmp_path), CodeCache(tmp_path)
    assert maker.read("a kernel") is None
    found: list[bytes | None] = []
    waiting = threading.Thread(target=lambda: found.append(other.read("a kernel")))
    waiting.start()
    waiting.join(0.3)
    assert waiting.is_alive()
    maker.write("a kernel", b"made")
    waiting.join(30.0)
    assert found == [b"made"]
    assert [file.suffix for file in files(tmp_path)] == [".bin"]
