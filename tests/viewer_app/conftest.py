"""Fixtures of the program's tests."""

from __future__ import annotations

import pytest

from fusion.fuser import Fuser
from tests.helpers.live_frames import known_fuser


@pytest.fixture
def fuser() -> Fuser:
    return known_fuser()
