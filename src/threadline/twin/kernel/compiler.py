"""Modules of LLVM to machine code of this processor."""

from __future__ import annotations

from typing import Any

import llvmlite
import llvmlite.binding as llvm
from llvmlite import ir

from threadline.compiled import where_kept
from threadline.twin.kernel.kept_code import KeptCode

_OPTIMISES = 3, 2  # levels of the code generator and of the passes before it


class Compiler:
    """Turns modules into machine code for this computer's processor, and keeps it.

    Parameters
    ----------
    kept
        Machine code that other processes made; beside this file when None.
    """

    def __init__(self, kept: KeptCode | None = None) -> None:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        self._engines: list[Any] = []
        self._kept = KeptCode(where_kept(_compiled)) if kept is None else kept

    def address(self, module: ir.Module, name: str) -> int:
        """Compile ``module`` and return the address of one of its functions."""
        target = llvm.Target.from_default_triple()
        cpu, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
        machine = target.create_target_machine(
            cpu=cpu, features=features, opt=_OPTIMISES[0], jit=True
        )
        module.triple = target.triple
        module.data_layout = str(machine.target_data)
        text = str(module)
        versions = llvmlite.__version__, llvm.llvm_version_info, _OPTIMISES
        made_from = "\n".join([repr(versions), cpu, features, text])
        code = self._kept.read(made_from)
        if code is None:
            code = _compiled(text, machine)
            self._kept.write(made_from, code)
        nothing = llvm.parse_assembly(f'target triple = "{target.triple}"')
        engine = llvm.create_mcjit_compiler(nothing, machine)
        engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
        self._engines.append(engine)
        return int(engine.get_function_address(name))


def _compiled(text: str, machine: Any) -> bytes:
    parsed = llvm.parse_assembly(text)
    parsed.verify()
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(_OPTIMISES[1]))
    builder.getModulePassManager().run(parsed, builder)
    return bytes(machine.emit_object(parsed))
