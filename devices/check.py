"""The result of one check of this machine."""

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from operator import attrgetter
from typing import Literal

from devices.sensor import DeviceError


@dataclass(frozen=True)
class Check:
    """Result of one check."""

    name: str  # what was checked
    ok: bool  # whether it works
    detail: str  # what was found
    advice: str = ""  # what to do if it fails; empty if it works
    needed: bool = True  # whether live capture requires it
    about: Literal["sensor", "library", "machine"] = "machine"  # of a library, one of all is enough
    missing: bool = False  # whether it fails because something is not installed, rather than broken
    serves: str = ""  # of a library: its sensors
    install: str = ""  # of a library: how it is installed, in a few words


def failed(name: str, fault: DeviceError, needed: bool = True) -> Check:
    """A failed check from an error: its first sentence is the detail, the rest is the advice."""
    what, _, advice = str(fault).partition(". ")
    return Check(name, False, what, advice, needed, missing=is_missing(fault))


def is_missing(fault: DeviceError) -> bool:
    """Whether a library's loader fails because it is not installed, rather than because it is broken."""
    cause = fault.__cause__
    return isinstance(cause, ModuleNotFoundError) or (cause is None and "is not installed" in str(fault))


def words_of(fault: Exception) -> str:
    """What an exception of another library says, in one line."""
    return " ".join(str(fault).split()) or type(fault).__name__


def missing_names(module: object, names: Iterable[str]) -> list[str]:
    """Those of some dotted names that a vendor's module lacks, because it is of another version."""

    def has(name: str) -> bool:
        try:
            attrgetter(name)(module)
        except AttributeError:
            return False
        return True

    return [name for name in names if not has(name)]


def installed_version(package: str) -> str:
    """The version of a Python package; empty if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def extra_command(extra: str) -> str:
    """The command that adds an extra to the installed program, from any folder and without an activated
    environment; pip asks no index for a package that is installed. Windows' shell knows no single quotes."""
    python = f'"{sys.executable}"' if " " in sys.executable else sys.executable
    return f'{python} -m pip install "duplex-kinects[{extra}]"'
