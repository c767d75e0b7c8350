"""Allocates the arrays of a NamedTuple from the shapes that its fields declare."""

from functools import cache
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np

T = TypeVar("T")


def new_arrays(kind: type[T], **sizes: int) -> T:
    """A NamedTuple of new arrays, as the kernels take it.

    A field is declared as ``Annotated[NDArray[dtype], shape]``, followed by a value where the array is not to
    be filled with 0. A field whose type is such a NamedTuple is allocated likewise.

    Args:
        sizes: Numbers for the names in the shapes, such as ``J=25`` for ``("J", 3)``.
    """
    make: Any = kind
    arrays: dict[str, Any] = {}
    for name, dtype, shape, value in _declared(make):
        if shape is None:
            arrays[name] = new_arrays(dtype, **sizes)
            continue
        arrays[name] = np.zeros([sizes[size] if isinstance(size, str) else size for size in shape], dtype)
        if value != 0:
            arrays[name][...] = value
    result: T = make(**arrays)
    return result


@cache
def _declared(kind: Any) -> list[tuple[str, Any, tuple[int | str, ...] | None, Any]]:
    """Name, type of an element, shape and value of each field; a nested NamedTuple has no shape."""
    fields: list[tuple[str, Any, tuple[int | str, ...] | None, Any]] = []
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if hasattr(hint, "_fields"):
            fields.append((name, hint, None, None))
            continue
        array, shape, value = (*get_args(hint), 0)[:3]
        fields.append((name, _element(array), shape, value))
    return fields


def _element(array: Any) -> Any:
    """The dtype of ``NDArray[dtype]``, an alias of its own from Python 3.12 on."""
    *_, of = get_args(array)
    return get_args(of)[0] if get_args(of) else of
