"""Angles and gait events of live frames, as LSL, WebSocket and Zenoh send them."""

import json
from dataclasses import replace
from itertools import chain
from uuid import uuid4

import numpy as np
import pytest

from devices.simulated.kinect import Scene, Truth, movement
from devices.simulated.rig import Rig
from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.movement.angles import ANGLES, joint_angles
from fusion.setup import FusionSetup
from recordings.appearance.floor import floor_under
from recordings.gait.events import find_gait
from recordings.replaying import Replay
from recordings.session import Session
from tests.helpers.demonstrations import fused_demonstration
from tests.helpers.footfalls import contacts
from tests.helpers.live_frames import frames
from viewer_app.commands.replay import with_floors
from viewer_app.outputs.lab_streaming import LabStreamingOutput
from viewer_app.outputs.live_movement import LiveMovement
from viewer_app.outputs.skeleton_json import SkeletonJson
from viewer_app.sinks.item_queue import QueuedFrame

SETUP = FusionSetup(nominal_calibration(AZURE_KINECT))


@pytest.fixture
def walk(fuser):
    """Twelve seconds of a person who starts to walk; S* is the truth."""
    template = frames(fuser, 1)[0]
    times = np.arange(360) * 33_333_333
    joints = Truth(Scene(movement("walk"), AZURE_KINECT), Rig()).positions_at(times + 2_000_000_000)
    sigma = np.full(len(AZURE_KINECT), 0.02)
    return [
        QueuedFrame(
            k, replace(template, fused=replace(template.fused, positions=at, sigma=sigma)), time_ns, time_ns
        )
        for k, (time_ns, at) in enumerate(zip(times.tolist(), joints, strict=True))
    ]


def test_every_event_of_a_walk_is_reported_once_and_soon(walk):
    live, told = LiveMovement(AZURE_KINECT), []
    for frame in walk:
        live.angles(frame)
        told += [(event, frame.time_ns) for event in live.new_events()]
    times = np.array([frame.time_ns for frame in walk])
    joints = np.array([frame.fused.positions for frame in walk])
    whole = find_gait(AZURE_KINECT, times, joints, (0.0, -1.0, 0.0))
    due = [(at, name.replace("_", " ")) for at, name in whole.events if at < times[-1] * 1e-9 - 0.6]
    found = sorted((event.time_ns * 1e-9, event.text) for event, _ in told)[: len(due)]
    assert [name for _, name in found] == [name for _, name in due]
    np.testing.assert_allclose([at for at, _ in found], [at for at, _ in due], atol=0.03)
    third = whole.steps[2].strike
    strikes = [(event, now) for event, now in told if event.text.startswith("heel")]
    assert max(now - event.time_ns for event, now in strikes if event.time_ns * 1e-9 > third) < 0.6e9


def test_live_toe_offs_and_strikes_are_when_the_feet_touch_the_floor(walk):
    live, late = LiveMovement(AZURE_KINECT), {"heel strike": [], "toe off": []}
    true = contacts("walk", 14.0)
    for frame in walk:
        live.angles(frame)
        for event in live.new_events():
            kind, _, side = event.text.rpartition(" ")
            touched = true[side][kind == "toe off"] - 2.0  # the walk is without its first two seconds
            off = event.time_ns * 1e-9 - touched
            late[kind].append(off[np.abs(off).argmin()])
    for of_kind in late.values():
        assert len(of_kind) > 12
        assert abs(np.mean(of_kind)) < 0.02
        assert np.abs(of_kind).max() < 0.05


def test_json_has_the_angles_and_their_uncertainty_and_null_where_unknown(walk):
    encoder = SkeletonJson(SETUP)
    assert json.loads(encoder.hello(SETUP))["angles"] == list(ANGLES)
    frame = walk[0]
    said = json.loads(encoder.frame(frame, None))
    expected = joint_angles(AZURE_KINECT, frame.fused.positions)
    np.testing.assert_allclose(said["angles"][:-2], expected[:-2], atol=0.006)
    assert all(0.0 < sigma < 180.0 for sigma in said["angle_sigma"])
    frame.fused.positions[AZURE_KINECT.joint("WRIST_LEFT")] = np.nan
    said = json.loads(encoder.frame(frame, None))
    assert said["angles"][ANGLES.index("elbow_flexion_left")] is None


@pytest.fixture(scope="module")
def live_run(tmp_path_factory):
    """A demonstration as the live loop fuses it, and its session."""
    run = fused_demonstration(AZURE_KINECT, 14.0, motion="walk")
    path = tmp_path_factory.mktemp("live") / "s.rrd"
    Session.of(run.parts).save(path)
    return run.frames, Session.open(path)


def sent(frames):
    """(T, K) angles of the stream; NaN where they are null."""
    encoder, start_ns = SkeletonJson(SETUP), None
    for k, frame in enumerate(frames):
        start_ns = frame.pair.time_ns if start_ns is None else start_ns
        queued = QueuedFrame(k, frame, frame.pair.time_ns - start_ns, 0)
        yield json.loads(encoder.frame(queued, None))["angles"] or [None] * len(ANGLES)


# rounded to 0.01; S* in the file to 1e-7 m, of bones of 0.1 m
NEAR = 0.006


def test_angles_sent_live_are_those_of_the_session(live_run):
    frames, session = live_run
    found = np.array(list(sent(frames)), dtype=float)
    np.testing.assert_allclose(found, session.angles.degrees, atol=NEAR)
    of_all = joint_angles(AZURE_KINECT, session.fused, session.up)
    assert np.nanmax(np.abs(of_all - session.angles.degrees)) > 0.5  # of another vertical


@pytest.mark.parametrize("live", [True, False])
def test_angles_sent_by_a_replay_are_those_of_its_session(live_run, live):
    session = live_run[1]
    if not live:  # as of recordings
        session = replace(session, rows=replace(session.rows, up=None))
    replay = Replay.of(session)
    blocks = list(replay.blocks())
    found = np.array(list(sent(with_floors(chain.from_iterable(blocks), session))), dtype=float)
    again = replay.fused(iter(blocks))
    for each in (session, again):
        np.testing.assert_allclose(found, each.angles.degrees, atol=NEAR)


@pytest.mark.parametrize("higher", [0.0, 1.5])
def test_the_floor_of_a_replay_is_that_of_its_session_also_above_the_sensors(live_run, higher):
    some, session = live_run
    fused = session.fused + higher * session.up
    session = replace(session, rows=replace(session.rows, fused=fused, up=None))
    floor = next(with_floors(some, session)).floor
    np.testing.assert_allclose(floor.translation, floor_under(session.rows).translation, atol=1e-9)
    assert (floor.translation @ session.up > 0.0) == (higher > 0.0)


@pytest.mark.parametrize("damage", [np.nan, 0.0, 1e30])
def test_a_damaged_vertical_is_that_of_all_frames(live_run, damage):
    session = live_run[1]
    up = session.rows.up.copy()
    up[100:200] = damage
    odd = replace(session, rows=replace(session.rows, up=up))
    expected = joint_angles(AZURE_KINECT, session.fused[100:200], session.up)
    np.testing.assert_allclose(odd.angles.degrees[100:200], expected, atol=1e-9)
    np.testing.assert_array_equal(odd.angles.degrees[200:], session.angles.degrees[200:])


def test_an_inlet_reads_angles_and_heel_strikes_at_their_times(walk):
    pylsl = pytest.importorskip("pylsl", exc_type=ImportError)
    name = f"test-{uuid4().hex[:8]}"
    output = LabStreamingOutput(name, AZURE_KINECT, 30.0)
    try:
        angles, events = (
            pylsl.StreamInlet(pylsl.resolve_byprop("name", f"{name}-{of}", timeout=30.0)[0])
            for of in ("angles", "events")
        )
        for inlet in (angles, events):
            inlet.open_stream(timeout=30.0)
        for frame in walk:
            output.send_frame(frame)
        sample, stamp = angles.pull_sample(timeout=30.0)
        assert len(sample) == 2 * len(ANGLES)
        np.testing.assert_allclose(
            sample[: 2 * 12 : 2], joint_angles(AZURE_KINECT, walk[0].fused.positions)[:12], atol=1e-3
        )
        text, happened = events.pull_sample(timeout=30.0)
        assert text == ["INFO: toe off right"]
        assert 0.0 < happened - stamp < 4.0
    finally:
        output.close()
