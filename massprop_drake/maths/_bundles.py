"""Bundles in compiled code: references to their fields; loads numba, so only `kernels` loads it.

numba has a named tuple in as many variables as it has numbers, pointers and lengths, in every function and at every
call: with the state and the parameters of a filter that is most of what is compiled. Here a named tuple of this package
is a reference in compiled code: made once, passed in one variable, and never changed, as in Python. To Python it is the
named tuple that it was.
"""

from __future__ import annotations

import hashlib
import inspect
from typing import Any

from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.typing import signature
from numba.core.typing.typeof import typeof_impl
from numba.experimental import structref
from numba.experimental.jitclass.base import imp_dtor
from numba.extending import NativeValue, box, lower_builtin, register_model, unbox

_PACKAGE = __name__.partition(".")[0] + "."


def _is_bundle(kind: type) -> bool:
    """Tests whether a class is a named tuple of this package."""
    return issubclass(kind, tuple) and hasattr(kind, "_fields") and kind.__module__.startswith(_PACKAGE)


@structref.register
class BundleType(types.StructRef):
    """Type of a bundle, by its class and the types of its fields."""

    def __init__(self, bundle: type, kinds: tuple[Any, ...]):
        self.bundle = bundle
        super().__init__(tuple(zip(bundle._fields, kinds, strict=True)))  # type: ignore[attr-defined]
        digest = hashlib.sha256(repr(self._fields).encode()).hexdigest()[:12]
        self.name = f"{bundle.__name__}_{digest}"  # short, since it is in the name of every function that takes one

    def preprocess_fields(self, fields: Any) -> Any:
        """Returns the fields' names and types, types of literal constants widened to plain ones."""
        return tuple((name, types.unliteral(kind)) for name, kind in fields)

    @property
    def kinds(self) -> tuple[Any, ...]:
        """Types of the fields, in order."""
        return tuple(kind for _, kind in self._fields)

    @property
    def as_tuple(self) -> Any:
        """Type of the named tuple with these fields that numba itself would use."""
        return types.BaseTuple.from_types(self.kinds, self.bundle)


class BundleClass(types.Callable, types.Opaque):
    """Type of a bundle's class, whose call makes a bundle."""

    def __init__(self, bundle: type):
        self.bundle = bundle
        super().__init__(f"class({bundle.__module__}.{bundle.__qualname__})")

    def get_call_type(self, _context: Any, args: Any, kws: Any) -> Any:
        """Returns numba's signature of a call to the class, arguments in the order of the fields."""
        named = inspect.signature(self.bundle)
        given = named.bind(*args, **dict(kws)).args
        return signature(BundleType(self.bundle, given), *given).replace(pysig=named)

    def get_call_signatures(self) -> Any:
        """Returns the signatures known before a call: none."""
        return (), True

    def get_impl_key(self, _signature: Any) -> Any:
        """Returns numba's key of the constructor's implementation: one serves all calls."""
        return type(self)


register_model(BundleClass)(models.OpaqueModel)

_typeof_class, _typeof_tuple = typeof_impl.dispatch(type), typeof_impl.dispatch(tuple)


@typeof_impl.register(type)  # type: ignore[untyped-decorator]
def _typeof_bundle_class(value: type, context: Any) -> Any:
    """Returns the compiled type of a named tuple class of this package; numba's own for other classes."""
    return BundleClass(value) if _is_bundle(value) else _typeof_class(value, context)


@typeof_impl.register(tuple)  # type: ignore[untyped-decorator]
def _typeof_bundle(value: Any, context: Any) -> Any:
    """Returns the compiled type of a bundle, numba's own for other tuples; None where a field has none."""
    if not _is_bundle(type(value)):
        return _typeof_tuple(value, context)
    kinds = tuple(typeof_impl(field, context) for field in value)
    return None if None in kinds else BundleType(type(value), kinds)


def _allocate_bundle(context: Any, builder: Any, kind: BundleType, fields: Any, *, checked: bool = True) -> Any:
    """Generates the code that allocates a bundle and moves its fields into it."""
    payload, nrt = kind.get_data_type(), context.nrt
    layout = context.data_model_manager[payload].get_value_type()
    size = context.get_constant(types.uintp, context.get_abi_sizeof(layout))
    allocated = nrt.meminfo_alloc_dtor if checked else nrt.meminfo_alloc_dtor_unchecked
    dropped = imp_dtor(context, builder.module, kind)
    dropped.linkage = "linkonce_odr"  # each module that makes such bundles has its own
    reference = allocated(builder, size, dropped)
    place = builder.bitcast(nrt.meminfo_data(builder, reference), layout.as_pointer())
    data = cgutils.create_struct_proxy(payload)(context, builder, ref=place)
    for (name, _), field in zip(kind._fields, fields, strict=True):
        setattr(data, name, field)
    result = context.make_helper(builder, kind)
    result.meminfo = reference
    return result._getvalue()


@lower_builtin(BundleClass, types.VarArg(types.Any))  # type: ignore[untyped-decorator]
def _construct(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Generates the code of a bundle's constructor: casts each argument and stores it in its field."""
    kind, fields = sig.return_type, []
    for own, given, value in zip(kind.kinds, sig.args, args, strict=True):
        field = context.cast(builder, value, given, own)
        context.nrt.incref(builder, own, field)
        fields.append(field)
    return _allocate_bundle(context, builder, kind, fields)


def _load_constant(c: Any, value: Any) -> Any:
    """Adds a Python object to the constants of compiled code; returns a borrowed reference to it."""
    return c.env_manager.read_const(c.env_manager.add_const(value))


@box(BundleType)  # type: ignore[untyped-decorator]
def _to_python(kind: BundleType, value: Any, c: Any) -> Any:
    """Generates the code that converts a compiled bundle to Python's named tuple."""
    data = structref._Utils(c.context, c.builder, kind).get_data_struct(value)
    parts = []
    for name, own in kind.field_dict.items():
        field = getattr(data, name)
        c.context.nrt.incref(c.builder, own, field)
        parts.append(c.box(own, field))
    there = c.pyapi.tuple_pack(parts)
    found = c.pyapi.call_function_objargs(_load_constant(c, tuple.__new__), (_load_constant(c, kind.bundle), there))
    for part in (*parts, there):
        c.pyapi.decref(part)
    c.context.nrt.decref(c.builder, kind, value)
    return found


@unbox(BundleType)  # type: ignore[untyped-decorator]
def _from_python(kind: BundleType, value: Any, c: Any) -> Any:
    """Generates the code that converts Python's named tuple to a compiled bundle."""
    read = c.unbox(kind.as_tuple, value)
    fields = [c.builder.extract_value(read.value, place) for place in range(len(kind.kinds))]
    made = _allocate_bundle(c.context, c.builder, kind, fields, checked=False)
    return NativeValue(made, is_error=read.is_error, cleanup=read.cleanup)
