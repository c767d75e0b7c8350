"""The user's cache folder."""

import os
import sys
import tempfile
from pathlib import Path


def home() -> Path:
    """The user's home folder; a user without one, as in a container, has that of temporary files."""
    try:
        return Path.home()
    except RuntimeError:
        return Path(tempfile.gettempdir())


def user_cache(name: str) -> Path:
    """A folder of this program in the user's cache folder, by the platform's convention; it may not exist."""
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or home() / ".cache"
    return Path(base) / "duplex-kinects" / name
