"""Compile LLVM modules to machine code for this processor.

Writing the module of a kernel takes as long as compiling it. Machine code is therefore cached by
its inputs: the shape, and a digest of the sources that write the module. The module is written only
if the cache has no entry. If several processes need the same code, one compiles it and the others
wait.
"""

from __future__ import annotations

import hashlib
import os
import uuid
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
from llvmlite import ir

from threadline.base.compiled import FileLock, cache_folder
from threadline.machine import controllers
from threadline.twin import timeline

_OPTIMISES = 3  # level of the code generator
_PASSES = "sroa", "instruction_combine", "simplify_cfg", "new_gvn", "dead_code_elimination"
"""Optimiser passes. Kernels are written as vectors with short loops, so all other passes would take
as long as the code generator and gain at most 5 %."""
MOST = 512
"""Largest number of files; the least recently used one is removed first."""
_DIGEST_BYTES = 32
_OTHERS = controllers, timeline
"""Modules outside this folder whose numbers are used in kernels."""


def _digest() -> str:
    """Return a digest of the sources that write kernels; empty if they cannot be read."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    files += [Path(str(module.__file__)) for module in _OTHERS]
    try:
        return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()
    except OSError:
        return ""


# Computed at import, because this process does not use later changes of the files.
WRITTEN_BY = _digest()


class CodeCache:
    """Files of machine code, each preceded by a digest of its bytes.

    A partial or modified file is ignored, because running it would crash.

    Parameters
    ----------
    folder
        Folder of the files; None for no cache.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._making: dict[Path, FileLock] = {}

    def read(self, made_from: str) -> bytes | None:
        """Return the machine code for the inputs ``made_from``; None if the caller must compile it.

        Other processes that need the same code then wait for ``write``.
        """
        if self._folder is None:
            return None
        path = self._path(self._folder, made_from)
        code = self._read(path)
        if code is None and path not in self._making:
            lock = FileLock(path.with_suffix(".lock"))
            code = self._read(path)
            if code is None:
                self._making[path] = lock
        return code

    @staticmethod
    def _read(path: Path) -> bytes | None:
        try:
            data = path.read_bytes()
        except OSError:
            return None
        digest, code = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
        if hashlib.sha256(code).digest() != digest:
            return None
        with suppress(OSError):
            os.utime(path)
        return code

    def write(self, made_from: str, code: bytes) -> None:
        """Write machine code; if that fails, the next process compiles again."""
        if self._folder is None:
            return
        path = self._path(self._folder, made_from)
        part = path.with_suffix(f".{uuid.uuid4().hex[:16]}")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            part.write_bytes(hashlib.sha256(code).digest() + code)
            part.replace(path)
            self._forget(self._folder)
        except OSError:
            return
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)
            lock = self._making.pop(path, None)
            if lock is not None:
                lock.remove()

    @staticmethod
    def _path(folder: Path, made_from: str) -> Path:
        return folder / f"kernel-{hashlib.sha256(made_from.encode()).hexdigest()}.bin"

    @staticmethod
    def _forget(folder: Path) -> None:
        files = list(folder.glob("kernel-*.bin"))
        if len(files) <= MOST:
            return
        aged = []
        for file in files:
            with suppress(OSError):  # another process may have removed it
                aged.append((file.stat().st_mtime, file))
        for _, file in sorted(aged)[: len(aged) - MOST]:
            file.unlink(missing_ok=True)


class Compiler:
    """Compiles modules for this processor, and owns the machine code.

    Parameters
    ----------
    kept
        Cache of machine code on disk; None for the cache folder of this file.
    """

    def __init__(self, code_cache: CodeCache | None = None) -> None:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        self._engines: list[Any] = []
        self._cache = CodeCache(cache_folder(_compiled)) if code_cache is None else code_cache

    def address(self, write: Callable[[], ir.Module], name: str, shape: str = "") -> int:
        """Compile the module that ``write`` returns; return the address of its function ``name``.

        ``shape`` identifies the input of ``write``, if that is a function of this package. With
        cached machine code, ``write`` is not called.
        """
        target = llvm.Target.from_default_triple()
        cpu, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
        machine = target.create_target_machine(cpu=cpu, features=features, opt=_OPTIMISES, jit=True)
        text = ""
        if not (shape and WRITTEN_BY):
            text = _text(write(), target, machine)
        versions = llvmlite.__version__, llvm.llvm_version_info, _OPTIMISES, _PASSES
        known = text or f"{WRITTEN_BY} {shape}"
        made_from = "\n".join([repr(versions), cpu, features, known])
        code = self._cache.read(made_from)
        if code is None:
            code = _compiled(text or _text(write(), target, machine), machine)
            self._cache.write(made_from, code)
        nothing = llvm.parse_assembly(f'target triple = "{target.triple}"')
        engine = llvm.create_mcjit_compiler(nothing, machine)
        engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
        self._engines.append(engine)
        return int(engine.get_function_address(name))


def _text(module: ir.Module, target: Any, machine: Any) -> str:
    module.triple = target.triple
    module.data_layout = str(machine.target_data)
    return str(module)


def _compiled(text: str, machine: Any) -> bytes:
    parsed = llvm.parse_assembly(text)
    parsed.verify()
    passes = llvm.create_new_module_pass_manager()
    for name in _PASSES:
        getattr(passes, f"add_{name}_pass")()
    passes.run(parsed, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    return bytes(machine.emit_object(parsed))
