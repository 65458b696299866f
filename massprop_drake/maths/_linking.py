"""Machine code once for each kernel that Python calls; changes numba, so only `kernels` loads it.

numba optimizes a function together with all that it calls and makes machine code of them, for each function anew on
every level of calls, though nobody but the function above calls it: more than half of the time that compiling takes.
Here both wait until somebody asks for the address of a function, which is done for what Python calls alone.

References to arrays and bundles are counted in numba's way for code that many threads run at a time, which takes a
twentieth of a flight's time. The kernels of this package always hold Python's lock, and count without.
"""

from __future__ import annotations

import gc
import sys
from functools import cache, partial
from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.codegen import ll as llvm
from numba.core.codegen import llvmir as ir
from numba.core.event import Listener, register
from numba.core.registry import cpu_target
from numba.core.runtime import nrtdynmod

_OWN = "_ZN14massprop_drake"  # how the names of this package's functions begin
_COUNTS = ("NRT_incref", "NRT_decref")

_environments: dict[str, Any] = {}  # of functions that have no machine code yet, by the name of their variable


class _Library(JITCodeLibrary):
    """Functions compiled together, as numba has them, without machine code until it is asked for."""

    _waits = False

    def finalize(self) -> None:
        """Links what is called; the rest waits."""
        self._waits = True
        super().finalize()

    def _optimize_final_module(self) -> None:
        if not self._waits:
            super()._optimize_final_module()

    def _finalize_final_module(self) -> None:
        if self._waits:
            self._finalized = True
            return
        super()._finalize_final_module()
        for variable in self._final_module.global_variables:
            if variable.name in _environments:
                self._codegen.set_env(variable.name, _environments.pop(variable.name))

    def get_pointer_to_function(self, name: str) -> int:
        """The address of a function; zero if it is not one of these."""
        self._ensure_finalized()
        if self._waits:
            if not any(function.name == name for function in self.get_defined_functions()):
                return 0
            self._waits = False
            if any(function.name.startswith(_OWN) for function in self.get_defined_functions()):
                _count_alone(self._final_module)
            self._optimize_final_module()
            self._finalize_final_module()
        return int(super().get_pointer_to_function(name))


@cache
def _counts() -> Any:
    """Functions that count references for one thread at a time; None where many may run."""
    if not getattr(sys, "_is_gil_enabled", lambda: True)():
        return None
    module = ir.Module()
    word = nrtdynmod._word_type
    for function, operation in ((nrtdynmod._define_nrt_incref, "add"), (nrtdynmod._define_nrt_decref, "sub")):
        step = ir.Function(module, ir.FunctionType(word, [word.as_pointer()]), name=f"massprop_{operation}")
        step.linkage = "internal"
        builder, place = ir.IRBuilder(step.append_basic_block()), step.args[0]
        after = getattr(builder, operation)(builder.load(place), ir.Constant(word, 1))
        builder.store(after, place)
        builder.ret(after)
        function(module, step)
    return llvm.parse_assembly(str(module))


def _count_alone(module: Any) -> None:
    """Has the functions of a module count references without asking other threads."""
    counts = _counts()
    if counts is not None and all(_has(module, name) for name in _COUNTS):
        module.link_in(counts, preserve=True)
        for name in _COUNTS:
            module.get_function(name).linkage = "internal"


def _has(module: Any, name: str) -> bool:
    """Whether a module defines a function that another definition may replace."""
    try:
        function = module.get_function(name)
    except NameError:
        return False
    return not function.is_declaration and function.linkage == llvm.Linkage.linkonce_odr


def _set_environment(codegen: Any, name: str, environment: Any) -> None:
    """Tells compiled code where a function's environment is; later, where it has no machine code yet."""
    if codegen._engine.is_symbol_defined(name):
        type(codegen).set_env(codegen, name, environment)
    else:
        _environments[name] = environment


class _Uncollected(Listener):
    """No collection of garbage while something is compiled: it goes through all that the compiler has made so far."""

    def __init__(self) -> None:
        self._depth, self._collects = 0, False

    def on_start(self, event: Any) -> None:
        """Ends it when the outermost function begins."""
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """Begins it again."""
        self._depth -= 1
        if self._depth == 0 and self._collects:
            gc.enable()


def _unheard() -> None:
    """Ends the events of LLVM's lock, two at each call of LLVM, which nobody listens to."""
    ffi = llvm.ffi
    for callbacks in list(getattr(getattr(ffi.lib, "_lock", None), "_cblist", ())):
        ffi.unregister_lock_callback(*callbacks)


def wait() -> None:
    """Has machine code of what this process compiles from now on wait; where numba is another, it is made as ever."""
    register("numba:compile", _Uncollected())
    _unheard()
    codegen = cpu_target.target_context.codegen()
    there = (JITCodeLibrary, ("_optimize_final_module", "_finalize_final_module", "_ensure_finalized"))
    of_codegen = (codegen, ("_library_class", "_engine", "set_env"))
    if all(hasattr(where, name) for where, names in (there, of_codegen) for name in names):
        codegen._library_class = _Library
        codegen.set_env = partial(_set_environment, codegen)
