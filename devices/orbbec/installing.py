"""Instructions for installing pyorbbecsdk2."""

from __future__ import annotations

import sys
from importlib.metadata import PackageNotFoundError, version

COMMAND = "pip install --no-deps pyorbbecsdk2"


def how_to_install(python: tuple[int, int] = sys.version_info[:2]) -> str:
    """Returns the instructions for installing a pyorbbecsdk2 that works with this program.

    Its declared requirements (numpy < 2 on Python 3.11, av 12 or 13, open3d) are those of its examples and
    clash with this program's. The bindings themselves need numpy only.

    Args:
        python: Major and minor version of the interpreter.
    """
    remove = ""
    if _installed("pyorbbecsdk"):
        remove = "Remove pyorbbecsdk, the bindings of SDK v1, first (pip uninstall pyorbbecsdk). "
    newest = "" if python <= (3, 13) else " There are wheels for Python 3.11 to 3.13 only."
    return f"{remove}{COMMAND} (without --no-deps it would replace numpy and av).{newest}"


def _installed(package: str) -> bool:
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True
