"""Arrays of a NamedTuple by reference: a kernel takes one pointer instead of all their addresses and shapes.

Passed by value, a hundred arrays are a thousand arguments of each kernel, and most of the time that its
compilation takes. By reference a kernel reads what it uses from a table of eight-byte words: of a number its
bits; of an array its address, shape and strides; of a tuple the words of its items.

This module imports numba.
"""

# mypy: allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cached_property
from itertools import accumulate
from typing import Any, TypeVar, cast

import numpy as np
from numba import typeof
from numba.core import types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import NativeValue, infer_getattr, lower_getattr_generic, models, register_model, unbox
from numba.np.arrayobj import make_array, populate_array

T = TypeVar("T", bound=tuple[Any, ...])
_Type: Any = types.Type
_Template: Any = AttributeTemplate


def by_reference(values: T) -> T:
    """A NamedTuple of arrays, numbers and tuples of these, as kernels take it fastest.

    It has the fields of the NamedTuple. The arrays' values may change; the arrays themselves may not.
    """
    return cast(T, _Reference(values))


class _Reference:
    def __init__(self, values: Any) -> None:
        self._values = values
        self._table = np.fromiter(_words(values), dtype=np.int64)
        self.address = self._table.ctypes.data

    def __getattr__(self, name: str) -> Any:
        return getattr(self._values, name)

    @cached_property
    def _numba_type_(self) -> Any:
        return ReferenceType(typeof(self._values))


def _words(value: Any) -> Iterator[int]:
    if isinstance(value, np.ndarray):
        yield from (value.ctypes.data, *value.shape, *value.strides)
    elif isinstance(value, tuple):
        for item in value:
            yield from _words(item)
    elif isinstance(value, float):
        yield int(np.float64(value).view(np.int64))
    else:
        yield int(value)


class ReferenceType(_Type):  # type: ignore[misc]
    """numba's type of a reference, from numba's type of the NamedTuple."""

    def __init__(self, of: Any) -> None:
        self.fields = dict(zip(of.fields, zip(of.types, _begins(of), strict=False), strict=True))
        digest = hashlib.sha256(str(of).encode()).hexdigest()[:12]
        super().__init__(f"Reference({of.instance_class.__name__} {digest})")


def _begins(of: Any) -> list[int]:
    """The first word of each item of a tuple type, and the number of words of all."""
    return list(accumulate(map(_size, of.types), initial=0))


def _size(kind: Any) -> int:
    if isinstance(kind, types.Array):
        return 1 + 2 * kind.ndim
    return _begins(kind)[-1] if isinstance(kind, types.BaseTuple) else 1


@infer_getattr
class _Attributes(_Template):  # type: ignore[misc]
    key = ReferenceType

    def generic_resolve(self, reference: Any, name: str) -> Any:
        kind, _ = reference.fields.get(name, (None, 0))
        return ReferenceType(kind) if isinstance(kind, types.NamedTuple) else kind


register_model(ReferenceType)(models.OpaqueModel)


@unbox(ReferenceType)
def _pointer(_kind: Any, reference: Any, c: Any) -> Any:
    address = c.pyapi.object_getattr_string(reference, "address")
    pointer = c.pyapi.long_as_voidptr(address)
    c.pyapi.decref(address)
    return NativeValue(pointer)


@lower_getattr_generic(ReferenceType)
def _field(context: Any, builder: Any, reference: Any, pointer: Any, name: str) -> Any:
    kind, first = reference.fields[name]
    return _loaded(context, builder, kind, pointer, first)


def _loaded(context: Any, builder: Any, kind: Any, pointer: Any, first: int) -> Any:
    """The value that begins at a word of the table."""
    word = context.get_value_type(types.intp)

    def at(k: int) -> Any:
        return builder.gep(builder.bitcast(pointer, word.as_pointer()), [word(first + k)])

    def read(k: int, of: Any = word) -> Any:
        value = builder.load(builder.bitcast(at(k), of.as_pointer()))
        value.set_metadata("invariant.load", builder.module.add_metadata([]))  # no kernel writes the table
        return value

    if isinstance(kind, types.NamedTuple):
        return builder.bitcast(at(0), pointer.type)
    if isinstance(kind, types.BaseTuple):
        parts = [_loaded(context, builder, *one) for one in _items(kind, pointer, first)]
        return context.make_tuple(builder, kind, parts)
    if isinstance(kind, types.Array):
        array, item = make_array(kind)(context, builder), context.get_data_type(kind.dtype)
        shape, strides = ([read(n + k) for n in range(kind.ndim)] for k in (1, 1 + kind.ndim))
        populate_array(array, read(0, item.as_pointer()), shape, strides, context.get_abi_sizeof(item), None)
        return array._getvalue()
    if isinstance(kind, types.Float):
        return read(0, context.get_value_type(kind))
    return context.cast(builder, read(0), types.intp, kind)


def _items(kind: Any, pointer: Any, first: int) -> Iterator[tuple[Any, Any, int]]:
    for item, begin in zip(kind.types, _begins(kind), strict=False):
        yield item, pointer, first + begin
