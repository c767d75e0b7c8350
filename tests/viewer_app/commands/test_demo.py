"""``duplex demo``: what it tells a newcomer, its hard moments, and where its sensors stand."""

import json
from functools import cache

import numpy as np
import pytest

from devices.depth.camera import project
from devices.findings.finding import word_of
from devices.findings.rules import RULES
from devices.simulated.demonstration import MIRRORED, MISPLACED, bad_rig, demonstrated, good_rig
from devices.simulated.person.anatomy import landmarks_of
from devices.simulated.person.movements import MOTIONS
from fusion.body import AZURE_KINECT, BODIES, KINECT_V1, KINECT_V2
from fusion.intrinsics import NOMINAL_INTRINSICS
from recordings import Session
from tests.helpers.command_line import duplex, one_line
from tests.helpers.demonstrations import findings_over, fused_demonstration
from tests.helpers.machine import small_disk
from tests.helpers.session_text import rows_of

QUICK = ("--depth", "none", "--no-viewer")


@pytest.mark.parametrize(
    ("other", "does"), [("walks", "walks about"), ("sits", "sits down in front of them")]
)
def test_a_demo_of_two_people_says_that_there_are_others(other, does, tmp_path, capsys):
    saved = tmp_path / "two.rrd"
    two = "--people", 2, "--other", other
    assert duplex("demo", *QUICK, "--seconds", 3, *two, "--motion", "squat", "--save", saved) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"A simulated person (squat) and another one who {does} in front of two Kinects" in said
    assert "others seen in" in said
    assert any(event.topic == "others" for event in Session.open(saved).events)


def test_a_badly_placed_demo_is_told_what_to_mend(tmp_path, capsys):
    saved = tmp_path / "bad.rrd"
    assert duplex("demo", *QUICK, "--seconds", 3, "--bad-setup", "--save", saved) == 0
    said = capsys.readouterr().out
    assert "30° apart" in said
    assert "The sensors are badly placed" in said
    warned = {event.topic for event in Session.open(saved).events if event.level == "WARN"}
    assert {"distance_a", "distance_b"} <= warned
    for word in ("You are 1.", "Step back"):
        assert word in said


def test_a_demo_replaces_no_existing_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("viewer_app.commands.demo.has_display", lambda: False)
    precious = tmp_path / "demo.rrd"
    precious.write_text("precious")
    assert duplex("demo", *QUICK, "--seconds", 0.3, "--save", "demo.rrd") == 2
    assert "demo.rrd exists already" in one_line(capsys)
    assert duplex("demo", "--seconds", 0.3, "--depth", "none") == 0
    assert "MB per second" not in capsys.readouterr().out
    assert duplex("demo", "--seconds", 0.3) == 0
    assert "Saving to demo-3.rrd, 4 MB per second" in capsys.readouterr().out
    assert precious.read_text() == "precious"
    assert rows_of(tmp_path / "demo-2.rrd", "/fused/skeleton") > 0


SECONDS = 17.0  # two rounds of both
BODIES_TRIED = [AZURE_KINECT, KINECT_V2]


@cache
def demo(body):
    return fused_demonstration(body, SECONDS)


@pytest.mark.parametrize("body", BODIES_TRIED, ids=lambda body: body.name)
def test_the_events_name_what_happened_and_when(body):
    run = demo(body)
    for start in MISPLACED.starts_before(SECONDS):
        lost = [t for t, text in run.events if text.startswith("A loses the left arm")]
        # told half a second after it began, when it is certain that it is no outlier
        assert any(start + 0.5 <= t <= start + 0.8 for t in lost), (start, run.events)
    for start in MIRRORED.starts_before(SECONDS):
        told = [t for t, text in run.events if text.startswith("B reports left and right exchanged")]
        assert any(start <= t <= start + MIRRORED.seconds for t in told), (start, run.events)


def test_the_demo_says_at_which_seconds_to_look():
    told = {moment.fault: list(moment.starts) for moment in demo(AZURE_KINECT).shown.moments}
    assert told == {
        "Kinect A loses the left arm": [7.0, 15.0],
        "Kinect B exchanges left and right": [4.4, 12.4],
    }


ANGLES_SHOWN = 45.0, 90.0, 135.0


def share_inside(rig, body, motion):
    """The share of frames in a minute in which both images show all joints."""
    joints = demonstrated(motion).landmarks(np.arange(0.0, 60.0, 0.1))[:, landmarks_of(body)]
    camera = NOMINAL_INTRINSICS[body.name]
    inside = np.ones(len(joints), dtype=bool)
    for which in (0, 1):
        pixels = project(camera, rig.world_from_sensor(which).inverse().apply(joints))
        inside &= ((pixels >= 0.0) & (pixels < (camera.width, camera.height))).all(axis=(1, 2))
    return float(inside.mean())


@pytest.mark.parametrize("body", BODIES.values(), ids=lambda body: body.name)
def test_both_images_show_the_whole_person_in_every_movement(body):
    for motion in MOTIONS:
        for angle in ANGLES_SHOWN:
            assert share_inside(good_rig(body, angle), body, motion) >= 0.99, (motion, angle)
    assert share_inside(bad_rig(), body, "badminton") == 0.0


@pytest.mark.parametrize(
    ("body", "angle"),
    [(KINECT_V1, 90.0), (KINECT_V2, 90.0), (AZURE_KINECT, 45.0), (AZURE_KINECT, 135.0)],
    ids=str,
)
def test_the_coach_finds_no_fault_with_the_placement_in_any_movement(body, angle):
    wrong = {
        motion: [found.rule for found in findings_over(good_rig(body, angle), body, motion)]
        for motion in MOTIONS
    }
    expected = ["angle"] if word_of(RULES["angle"], angle) != "good" else []  # the one that was asked for
    assert wrong == dict.fromkeys(MOTIONS, expected)


def test_the_walk_of_the_benchmarks_leaves_the_range_of_a_kinect_v1():
    assert demonstrated("walk") is not MOTIONS["walk"]
    assert all(demonstrated(motion) is MOTIONS[motion] for motion in MOTIONS if motion != "walk")


def test_where_saving_fails_the_report_is_of_all_frames_all_the_same(tmp_path, capsys):
    with small_disk(tmp_path / "small", 400) as disk:
        shown = "--no-viewer", "--seconds", 2, "--save", disk / "s.rrd", "--report", tmp_path / "r.json"
        assert duplex("demo", *shown) == 2
        assert "s.rrd could not be written: No space left on device" in one_line(capsys)
    figures = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    assert figures["fused_frames"] >= figures["paired"] > 30  # a busy machine leaves some frames alone
