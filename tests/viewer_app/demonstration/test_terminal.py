"""What ``duplex demo`` tells a newcomer."""

from __future__ import annotations

from pathlib import Path

import pytest

from recordings import Session
from tests.helpers.command_line import duplex, one_line

QUICK = ("--depth", "none", "--no-viewer")


def test_the_demo_says_where_to_look_and_what_to_do_next(capsys: pytest.CaptureFixture[str]) -> None:
    assert duplex("demo", *QUICK, "--seconds", 5.5) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "At 4.4 s Kinect B exchanges left and right for a second; S* stays right." in said
    assert "loses the left arm" not in said  # that comes later than the demo ends
    assert said.endswith("Next: --motion walk, --bad-setup, or your own sensors (duplex doctor).")


def test_a_badly_placed_demo_is_told_what_to_mend(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    saved = tmp_path / "bad.rrd"
    assert duplex("demo", *QUICK, "--seconds", 3, "--bad-setup", "--save", saved) == 0
    said = capsys.readouterr().out
    assert "30° apart" in said
    assert "The sensors are badly placed" in said
    warned = {event.text.partition(":")[0] for event in Session.open(saved).events if event.level == "WARN"}
    assert {"Too close to sensor A", "Too close to sensor B"} <= warned
    for word in (
        "Too close to sensor A",
        "does not see both feet",
        "Move them further apart round the person",
    ):
        assert word in said


def test_a_bad_set_up_has_an_angle_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert duplex("demo", *QUICK, "--bad-setup", "--angle", 60) == 2
    assert "--bad-setup has an angle of its own, 30°" in one_line(capsys)
