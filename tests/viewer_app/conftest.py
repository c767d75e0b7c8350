"""Fixtures of the program's tests."""

import pytest

from tests.helpers.live_frames import known_fuser


@pytest.fixture
def fuser():
    return known_fuser()
