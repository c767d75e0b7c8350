"""Sessions, in memory and on disk: ``from recordings import Session, fuse``."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recordings.errors import RecordingError
    from recordings.events import Event
    from recordings.fusing import fuse
    from recordings.live_fusing import fuse_live
    from recordings.session import Session
    from recordings.session_arrays import RecordedFrame, SessionArrays
    from recordings.session_series import QualitySeries, SkeletonSeries

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
    "fuse": "recordings.fusing",
    "fuse_live": "recordings.live_fusing",
    "Event": "recordings.events",
    "Session": "recordings.session",
    "RecordedFrame": "recordings.session_arrays",
    "SessionArrays": "recordings.session_arrays",
    "QualitySeries": "recordings.session_series",
    "SkeletonSeries": "recordings.session_series",
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
