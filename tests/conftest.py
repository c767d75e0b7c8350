"""Where the reference material stands, for the tests that use it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest_plugins = ("standin", "standin_pyk4a")

_PROJECT = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of reference material beside the project; tests skip where it is missing."""
    folder = Path(os.environ.get("DUPLEX_SHARED", _PROJECT.parent / "shared"))
    if not folder.is_dir():
        pytest.skip(f"needs the reference material in {folder} (DUPLEX_SHARED names another place)")
    return folder
