"""Modules of LLVM to machine code of this processor, in memory."""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir


class Compiler:
    """Turns modules into machine code for this computer's processor, and keeps it."""

    def __init__(self) -> None:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        self._kept: list[Any] = []

    def address(self, module: ir.Module, name: str) -> int:
        """Compile ``module`` and return the address of one of its functions."""
        target = llvm.Target.from_default_triple()
        machine = target.create_target_machine(
            cpu=llvm.get_host_cpu_name(),
            features=llvm.get_host_cpu_features().flatten(),
            opt=3,
            jit=True,
        )
        module.triple = target.triple
        module.data_layout = str(machine.target_data)
        parsed = llvm.parse_assembly(str(module))
        parsed.verify()
        builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(2))
        builder.getModulePassManager().run(parsed, builder)
        engine = llvm.create_mcjit_compiler(parsed, machine)
        engine.finalize_object()
        self._kept.append(engine)
        return int(engine.get_function_address(name))
