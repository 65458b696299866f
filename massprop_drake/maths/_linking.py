"""Linking of machine code for kernels that Python calls; changes numba, so only `kernels` loads it.

numba optimizes a function together with all that it calls and makes machine code of them, for each function anew on
every level of calls, though nobody but the function above calls it: more than half of the time that compiling takes.
Here both wait until somebody asks for the address of a function, which is done for what Python calls alone.
"""

from __future__ import annotations

import gc
from functools import partial
from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.event import Listener, register
from numba.core.registry import cpu_target

_environments: dict[str, Any] = {}  # of functions that have no machine code yet, by the name of their variable


class _Library(JITCodeLibrary):
    """Library of functions compiled together, without machine code until it is asked for."""

    _waits = False

    def finalize(self) -> None:
        """Links the functions that this library calls; optimization and machine code wait."""
        self._waits = True
        super().finalize()

    def _optimize_final_module(self) -> None:
        """Optimizes the library's code, unless it still waits for a use by Python."""
        if not self._waits:
            super()._optimize_final_module()

    def _finalize_final_module(self) -> None:
        """Makes the library's machine code and sets environments; does nothing while the library waits."""
        if self._waits:
            self._finalized = True
            return
        super()._finalize_final_module()
        for variable in self._final_module.global_variables:
            if variable.name in _environments:
                self._codegen.set_env(variable.name, _environments.pop(variable.name))

    def get_pointer_to_function(self, name: str) -> int:
        """Returns the address of a function, its machine code made now; 0: it is not in this library."""
        self._ensure_finalized()
        if self._waits:
            if not any(function.name == name for function in self.get_defined_functions()):
                return 0
            self._waits = False
            self._optimize_final_module()
            self._finalize_final_module()
        return int(super().get_pointer_to_function(name))


def _set_environment(codegen: Any, name: str, environment: Any) -> None:
    """Sets a function's environment in compiled code, or stores it until its machine code exists."""
    if codegen._engine.is_symbol_defined(name):
        type(codegen).set_env(codegen, name, environment)
    else:
        _environments[name] = environment


class _Uncollected(Listener):
    """Pause of garbage collection while something is compiled, as it would scan all that the compiler has made."""

    def __init__(self) -> None:
        self._depth, self._collects = 0, False

    def on_start(self, event: Any) -> None:
        """Disables garbage collection when the outermost compilation begins."""
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """Enables garbage collection when the outermost compilation has ended, if it was on before."""
        self._depth -= 1
        if self._depth == 0 and self._collects:
            gc.enable()


def delay_machine_code() -> None:
    """Makes numba generate machine code only for kernels that Python calls, from now on in this process."""
    register("numba:compile", _Uncollected())
    codegen = cpu_target.target_context.codegen()
    there = (JITCodeLibrary, ("_optimize_final_module", "_finalize_final_module", "_ensure_finalized"))
    of_codegen = (codegen, ("_library_class", "_engine", "set_env"))
    if all(hasattr(where, name) for where, names in (there, of_codegen) for name in names):
        codegen._library_class = _Library
        codegen.set_env = partial(_set_environment, codegen)
