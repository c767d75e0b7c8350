"""Fixtures of the program's tests."""

import pytest

from fusion.fuser import Fuser
from tests.helpers.live_frames import known_fuser


@pytest.fixture
def fuser() -> Fuser:
    return known_fuser()
