"""The user's cache folder."""

import os
import sys
from pathlib import Path


def user_cache(name: str) -> Path:
    """A folder of this program in the user's cache folder, by the platform's convention; it may not exist."""
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "duplex-kinects" / name
