"""Machine code on disk: no process runs code for other types, or of an older file.

A process may read at any point between two steps of another. So a process is interrupted at every
step by a reader, or by another writer, in this process and therefore always in the same order.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from numba.core.caching import UserProvidedCacheLocator

from threadline.base.compiled import CacheFile, cache_folder, njit
from threadline.base.progress import COMPILING


def cache(folder: Path, stamp: str) -> CacheFile:
    return CacheFile(cache_path=str(folder), filename_base="f", source_stamp=stamp)


class Interrupted(CacheFile):
    """Calls another function before and after it writes a file."""

    def __init__(self, folder: Path, stamp: str, other: Callable[[], None]) -> None:
        super().__init__(cache_path=str(folder), filename_base="f", source_stamp=stamp)
        self._other = other

    @contextlib.contextmanager
    def _open_for_write(self, filepath: Any) -> Iterator[Any]:
        self._other()
        with super()._open_for_write(filepath) as file:
            yield file
        self._other()


def test_reader_during_a_write_never_gets_code_of_an_older_file(
    tmp_path: Path,
) -> None:
    """numba's own cache writes the code's name into its index while the old code is still there."""
    cache(tmp_path, "old file").save("a float", "old code")
    read = []
    writer = Interrupted(
        tmp_path, "new file", lambda: read.append(cache(tmp_path, "new file").load("a float"))
    )
    writer.save("a float", "new code")
    assert len(read) == 4  # before and after machine code, before and after the index
    assert set(read) == {None, "new code"}
    assert cache(tmp_path, "new file").load("a float") == "new code"
    # Files that nobody can read any more are removed.
    assert len(list(tmp_path.glob("*.nbc"))) == 1


def test_an_interrupt_leaves_no_half_of_machine_code(tmp_path: Path) -> None:
    """numba's own cache removes its unfinished file after an error, but not after an interrupt."""

    class Cut:
        def __reduce__(self) -> str:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cache(tmp_path, "file").save("a float", ["code", Cut()])
    with (
        pytest.raises(KeyboardInterrupt),
        cache(tmp_path, "file")._open_for_write(str(tmp_path / "half")) as file,
    ):
        file.write(b"half")
        raise KeyboardInterrupt
    assert not list(tmp_path.glob("*tmp*"))


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", ["empty", "cut", "a byte"])
def test_a_damaged_file_is_made_again(tmp_path: Path, ending: str, damage: str) -> None:
    """numba's own cache ends with an error of pickle, or runs bytes that are no machine code."""
    cache(tmp_path, "file").save("a float", b"code" * 400)
    (file,) = tmp_path.glob(f"*.{ending}")
    whole = file.read_bytes()
    places = range(0, len(whole), 7) if damage == "a byte" else [0 if damage == "empty" else 20]
    for at in places:
        changed = bytearray(whole if damage == "a byte" else whole[:at])
        if damage == "a byte":
            changed[at] ^= 0x55
        file.write_bytes(changed)
        reader = cache(tmp_path, "file")
        assert reader.load("a float") is None, at
        reader.save("a float", b"made again")
        assert cache(tmp_path, "file").load("a float") == b"made again"


def test_machine_code_is_on_the_disk_before_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a loss of power after a rename leaves an empty file of the right length."""
    order: list[str] = []
    fsync, replace = os.fsync, Path.replace
    monkeypatch.setattr("os.fsync", lambda file: (order.append("fsync"), fsync(file))[1])
    monkeypatch.setattr(
        Path, "replace", lambda self, to: (order.append(Path(to).suffix), replace(self, to))[1]
    )
    cache(tmp_path, "file").save("a float", "code")
    assert order == ["fsync", ".nbc", "fsync", ".nbi"]


def test_a_folder_that_cannot_be_written_keeps_nothing_and_stops_nobody(tmp_path: Path) -> None:
    (tmp_path / "f.nbi").mkdir()
    full = cache(tmp_path, "file")
    full.save("a float", "code")
    assert full.load("a float") is None


def test_functions_are_compiled_each_time_without_a_writable_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """numba's own decorator ends with an error there: the file system of a container, say."""
    (tmp_path / "a file").write_text("")
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path / "a file" / "numba"))
    # numba would write beside the module or into the home of the user, which this user may.
    monkeypatch.setattr("numba.core.caching.CacheImpl._locator_classes", [UserProvidedCacheLocator])
    monkeypatch.setattr(COMPILING, "cached", True)
    assert njit()(lambda x: 2.0 * x)(1.5) == 3.0
    assert not COMPILING.cached and cache_folder(cache) is None


def test_two_that_write_at_once_never_take_the_code_of_each_other(tmp_path: Path) -> None:
    """numba's own cache gives both codes the same name; here a lost one is compiled anew."""
    turns = []

    def another_writes() -> None:
        turns.append(len(turns))
        if len(turns) == 1:
            cache(tmp_path, "file").save("two floats", "code for two")

    Interrupted(tmp_path, "file", another_writes).save("a float", "code for one")
    assert cache(tmp_path, "file").load("a float") == "code for one"
    assert cache(tmp_path, "file").load("two floats") in (None, "code for two")


@pytest.mark.long(but="return FACTOR * x")
@pytest.mark.parametrize("change", ["return 2.0 * x", "return FACTOR * x"])
def test_a_function_is_compiled_anew_when_one_that_it_calls_has_changed(
    tmp_path: Path, change: str
) -> None:
    """numba's own cache checks only the file of the caller."""
    inner = "from threadline.base.compiled import njit\nFACTOR = 3.0\n@njit()\ndef inner(x):\n    "
    (tmp_path / "outer.py").write_text(
        "from inner import inner\nfrom threadline.base.compiled import njit\n\n"
        "@njit()\ndef outer(x):\n    return inner(x) + 0.5\n"
    )
    found = []
    for body in ("return x", change):
        (tmp_path / "inner.py").write_text(inner + body + "\n")
        ran = subprocess.run(
            [sys.executable, "-c", "from outer import outer; print(outer(1.0))"],
            cwd=tmp_path, capture_output=True, text=True, check=True,
        )  # fmt: skip
        found.append(float(ran.stdout))
    assert found == [1.5, 2.5 if "2.0" in change else 3.5]


def test_compiled_division_by_zero_gives_infinity() -> None:
    assert njit()(lambda x: 1.0 / x)(0.0) == math.inf


def test_one_process_compiles_a_function_while_others_wait(tmp_path: Path) -> None:
    """Each records when it compiles, and how long that took."""
    (tmp_path / "wanted.py").write_text(
        "import sys\nfrom threadline.base.compiled import njit\n"
        "from threadline.base.progress import COMPILING\n"
        "@njit()\ndef inner(x):\n    return 2.0 * x\n"
        "@njit()\ndef outer(x):\n    return inner(x) + 0.5\n"
        "print(flush=True)\nsys.stdin.readline()\nprint(outer(1.0), COMPILING.done_s > 0.0)\n"
    )
    started = [
        subprocess.Popen(
            [sys.executable, "-m", "wanted"], cwd=tmp_path, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )
        for _ in range(3)
    ]  # fmt: skip
    for process in started:
        assert process.stdout is not None
        process.stdout.readline()  # it is ready to compile
    for process in started:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    output = sorted(process.communicate()[0].split() for process in started)
    assert output == [["2.5", "False"], ["2.5", "False"], ["2.5", "True"]]
    assert not list((tmp_path / "__pycache__").glob("*.lock"))


def test_process_compiles_by_itself_after_the_lock_timeout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The process that was to compile it may have been stopped."""
    monkeypatch.setattr("threadline.base.compiled.LOCK_TIMEOUT_S", 0.1)
    stopped = cache(tmp_path, "file")
    assert stopped.load("a float") is None
    other = cache(tmp_path, "file")
    assert other.load("a float") is None
    other.save("a float", "code")
    assert stopped.load("a float") == "code"


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("NUMBA_DISABLE_JIT=1", "NUMBA_DISABLE_JIT is set, .* Unset it."),
        ("NUMBA_NUM_THREADS=0", "numba refuses the settings .* Number of threads"),
        ("NUMBA_NUM_THREADS=-3", "numba refuses the settings .* Number of threads"),
        ("NUMBA_CACHE_LOCATOR_CLASSES=Nowhere", "numba refuses the settings .* 'Nowhere'"),
    ],
)
def test_an_environment_without_a_compiler_is_one_line(setting: str, message: str) -> None:
    name, _, value = setting.partition("=")
    example = Path(__file__).parents[1] / "examples" / "x-180.prg"
    ran = subprocess.run(
        [sys.executable, "-m", "threadline", "prove", str(example), "-m", "lathe-winder"],
        env={**os.environ, name: value}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ran.returncode == 2
    assert re.fullmatch(rf"error: \[OPTION\] .*{message}.*\n", ran.stderr), ran.stderr


_INTERRUPTED = """
import gc, signal, sys
import llvmlite.binding.ffi as ffi
from threadline.base.compiled import njit

name, before = "LLVMPY_LinkModules", int(sys.argv[1])
given, calls = getattr(ffi.lib, name), []

def interrupted(*arguments):
    answer = given(*arguments)
    calls.append(name)
    if len(calls) == before + 1:
        signal.raise_signal(signal.SIGINT)
    return answer

ffi.lib._fntab[name] = interrupted
# A process whose parent ignores interrupts, as in the background of a shell, ignores them too.
signal.signal(signal.SIGINT, signal.default_int_handler)

@njit()
def twice(x):
    return 2.0 * x**3

try:
    twice(1.5)
except KeyboardInterrupt:
    print("interrupted")
gc.collect()
ffi.lib._fntab[name] = given
print(twice(1.5))
"""


@pytest.mark.long(but="2")
@pytest.mark.parametrize("before", [0, 2])  # as numba begins; as a function is compiled
def test_an_interrupt_while_llvm_takes_a_module_is_no_crash(tmp_path: Path, before: int) -> None:
    """llvmlite only notes afterwards that LLVM owns the module: it would free it a second time."""
    file = tmp_path / "interrupted.py"
    file.write_text(_INTERRUPTED)
    ran = subprocess.run(
        [sys.executable, str(file), str(before)],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kept")}, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, (ran.returncode, ran.stderr)
    assert ran.stdout == "interrupted\n6.75\n"


def test_nothing_goes_round_it() -> None:
    """A function that numba caches by itself has none of these guarantees."""
    source = Path(__file__).parents[1] / "src" / "threadline"
    importing = {
        file.name
        for file in source.rglob("*.py")
        if re.search(r"^\s*(import|from) numba", file.read_text(), re.MULTILINE)
    }
    assert importing == {"compiled.py"}
