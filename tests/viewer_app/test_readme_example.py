"""README's example of a user's own test, run as it stands there."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Literal

import pytest

from fusion.body import KINECT_V1
from fusion.setup import FuserSettings
from recordings.testing import record_fused
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import calibration_of

ROOT = Path(__file__).parents[2]
_THEIR_OWN = """
from fusion.body import KINECT_V1
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import calibration_of

pairs, calibration = frame_pairs(KINECT_V1, 20), calibration_of(KINECT_V1)
"""


def example() -> str:
    """The one block of Python in README's section on sessions in tests."""
    section = (ROOT / "README.md").read_text(encoding="utf-8").split("## Sessions in your own tests\n")[1]
    (block,) = re.findall(r"```python\n(.*?)```", section.split("\n## ")[0], re.DOTALL)
    return str(block)


@pytest.mark.parametrize(
    ("weights", "noise", "says"),
    [
        ("paper", 0.02, "1 passed"),
        ("equal", 0.02, "S* differs by more than 0.01 mm"),
        ("paper", 0.03, "different captures"),
    ],
)
def test_the_example_passes_and_fails_as_it_should(
    weights: Literal["paper", "equal"], noise: float, says: str, tmp_path: Path
) -> None:
    pairs = frame_pairs(KINECT_V1, 20, noise=noise)
    settings = FuserSettings(weights=weights)
    record_fused(tmp_path / "expected.rrd", pairs, calibration_of(KINECT_V1), settings)
    (tmp_path / "test_mine.py").write_text(_THEIR_OWN + example(), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_mine.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert says in done.stdout
