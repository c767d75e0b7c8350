"""Values whose arrays cannot be written."""

from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", bound=np.generic)


def read_only(values: NDArray[Scalar]) -> NDArray[Scalar]:
    """The same array, which can no longer be written."""
    values.flags.writeable = False
    return values


class ReadOnlyArrays:
    """The base of a dataclass whose arrays cannot be written, also after copying and pickling.

    An array that can be written, or is a view of another one, is copied: its owner may go on with it.
    """

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray) and (value.flags.writeable or not value.flags.owndata):
                vars(self)[name] = read_only(value.copy(order="K"))

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        ReadOnlyArrays.__post_init__(self)


class cached_array(cached_property[NDArray[Scalar]]):  # noqa: N801
    """A ``cached_property`` whose array cannot be written."""

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        found = super().__get__(instance, owner)
        return found if instance is None else read_only(found)
