"""The result of one check of this machine."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from devices.sensor import DeviceError


@dataclass(frozen=True)
class Check:
    """Result of one check.

    Attributes:
        name: What was checked.
        ok: Whether it works.
        detail: What was found.
        advice: What to do if it fails; empty if it works.
        needed: Whether live capture requires it.
        alternative: Name of another check; if both fail, one of the two is enough. Empty if there is none.
    """

    name: str
    ok: bool
    detail: str
    advice: str = ""
    needed: bool = True
    alternative: str = ""


def failed(name: str, fault: DeviceError, needed: bool = True) -> Check:
    """A failed check from an error: its first sentence is the detail, the rest is the advice."""
    what, _, advice = str(fault).partition(". ")
    return Check(name, False, what, advice, needed)


def installed_version(package: str) -> str:
    """The version of a Python package; empty if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
