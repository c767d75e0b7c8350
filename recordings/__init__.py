"""Sessions, in memory and on disk: ``from recordings import Session, fuse``."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from devices.events import Event
    from recordings.errors import RecordingError
    from recordings.fusing.files import fuse
    from recordings.fusing.sensors import fuse_live
    from recordings.session import QualitySeries, Session, SkeletonSeries
    from recordings.session_arrays import RecordedFrame, SessionArrays

__all__ = [
    "Event",
    "QualitySeries",
    "RecordedFrame",
    "RecordingError",
    "Session",
    "SessionArrays",
    "SkeletonSeries",
    "fuse",
    "fuse_live",
]

_HOMES = {
    "RecordingError": "recordings.errors",
    "fuse": "recordings.fusing.files",
    "fuse_live": "recordings.fusing.sensors",
    "Event": "devices.events",
    "Session": "recordings.session",
    "RecordedFrame": "recordings.session_arrays",
    "SessionArrays": "recordings.session_arrays",
    "QualitySeries": "recordings.session",
    "SkeletonSeries": "recordings.session",
}
"""Module of each public name. Modules are imported on first access, because importing numba takes a
second."""


def __getattr__(name: str) -> Any:
    """Imports and returns a name of ``__all__``."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Lists the public names."""
    return sorted([*globals(), *__all__])
