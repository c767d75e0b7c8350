"""Public names of a package that are imported on first use, because numba alone takes a second."""

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def lazy_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package.

    The public names are those that its ``__init__.py`` imports under ``if TYPE_CHECKING:``, so that each is
    listed once, and type checkers know it. (lazy_loader of SPEC 1 reads a stub file instead, and allows only
    names of the package itself.)
    """
    blocks = [node for node in ast.parse(Path(file).read_text("utf-8")).body if isinstance(node, ast.If)]
    imports = [node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom)]
    homes = {alias.name: node.module for node in imports for alias in node.names}

    def getattr_(name: str) -> Any:
        home = homes.get(name)
        if home is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(home), name)

    return getattr_, lambda: sorted(homes), sorted(homes)
