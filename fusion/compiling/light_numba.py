"""numba without the optional packages that it imports: they load as long as numba, and no kernel needs them.

Other threads, and whoever imports these packages later, get them as usual. A program that has imported numba
before keeps the whole of it; in another one, its own kernels cannot call functions of cffi.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from threading import get_ident
from types import ModuleType

_OPTIONAL = ("cffi", "coverage", "scipy.linalg")


class _Absent(MetaPathFinder):
    """Finds no optional package for the thread that made it."""

    def __init__(self) -> None:
        self._thread = get_ident()

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        del path, target
        if name in _OPTIONAL and get_ident() == self._thread:
            raise ModuleNotFoundError(f"numba is loaded without {name}.", name=name)
        return None


_absent = [] if "numba" in sys.modules else [_Absent()]
sys.meta_path[:0] = _absent
try:
    import numba
    import numba.core.typing.cffi_utils
    import numba.np.arraymath
    from numba import typeof
    from numba.typed import List
finally:
    sys.meta_path[:] = [finder for finder in sys.meta_path if finder not in _absent]

__all__ = ["List", "numba", "typeof"]
