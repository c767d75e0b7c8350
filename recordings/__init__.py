"""Sessions on disk: ``from recordings import Session``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recordings.session import Session

__all__ = ["Session"]


def __getattr__(name: str) -> Any:
    """Imports ``Session`` when it is asked for: a module that needs another part does not wait for it."""
    if name == "Session":
        from recordings.session import Session

        return Session
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
