"""When a frame was captured, as all outputs and the session say it."""

import json
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_packet import OscPacket

from devices.capture.clock.capture_time import UNIX_NS, CaptureTime
from recordings.export.ros import capture_times
from recordings.session import Session
from tests.helpers.live_frames import frames
from tests.helpers.ros import messages, rosbags
from tests.helpers.two_views import FRAME_NS
from viewer_app.commands.replay import as_recorded
from viewer_app.outputs import lab_streaming
from viewer_app.outputs.avatars.osc import Address, OscOutput
from viewer_app.outputs.avatars.vmc import VmcEncoder
from viewer_app.outputs.lab_streaming import LabStreamingOutput
from viewer_app.outputs.mcap_file import McapOutput
from viewer_app.outputs.skeleton_json import SkeletonJson
from viewer_app.sinks.item_queue import QueuedFrame

MS = 1_000_000
MOMENTS = st.lists(st.tuples(st.integers(0, 40), st.integers(0, 900)), min_size=2, max_size=40)
"""Of each frame: milliseconds of jitter until its images arrive, and from there until S* is made."""


def captured(made, moments, interval_ns):
    """Frames as the loop has them: their times, when S* is made, and when they were captured."""
    capture, done_ns = CaptureTime(), 0
    for number, (frame, (jitter, late)) in enumerate(zip(made, moments, strict=False)):
        time_ns = number * interval_ns
        arrived_ns = time_ns + (20 + jitter) * MS
        done_ns = max(arrived_ns + late * MS, done_ns)
        unix_ns = capture.unix_ns(time_ns, arrived_ns)
        yield QueuedFrame(number, replace(frame, unix_ns=unix_ns), time_ns, done_ns)


@given(MOMENTS, st.sampled_from([11, 33, 200]))
def test_times_of_capture_leave_jitter_and_tracking_out(moments, interval_ms):
    """They are late by the constant delay and the least jitter so far, and half an interval apart."""
    capture, stamps = CaptureTime(), []
    for number, (jitter, _) in enumerate(moments):
        time_ns = number * interval_ms * MS
        stamps.append(capture.unix_ns(time_ns, time_ns + (20 + jitter) * MS) - UNIX_NS - time_ns)
        least = min(before for before, _ in moments[: number + 1])
        assert (20 + least) * MS <= stamps[-1] <= max((20 + least) * MS, stamps[max(number - 1, 0)])
    assert (np.diff(stamps) + interval_ms * MS >= interval_ms * MS // 2).all()


class Outlet:
    """What liblsl would send: the stamps of the stream of positions."""

    stamps: ClassVar = []

    def __init__(self, info):
        self._records = info.name() == "x"

    def push_sample(self, _, stamp):
        if self._records:
            self.stamps.append(stamp)


def stamps_of_lsl(monkeypatch, setup, queued):
    """(T,) seconds on ``time.perf_counter``."""
    pylsl = lab_streaming.load_pylsl(False)
    monkeypatch.setattr(pylsl, "StreamOutlet", Outlet)
    monkeypatch.setattr(Outlet, "stamps", [])
    output = LabStreamingOutput("x", setup.body, 30.0)
    for each in queued:
        output.send_frame(each)
    output.close()
    return np.array(Outlet.stamps) - output._clock_offset


def stamps_of_vmc(body, queued):
    """(T,) seconds since the first frame."""
    output = OscOutput("VMC", Address("127.0.0.1", 39539), "--vmc", VmcEncoder(body).encode)
    sent = []
    with closing(output):
        output._socket.close()
        output._socket = SimpleNamespace(sendto=lambda data, _: sent.append(data), close=lambda: None)
        for each in queued:
            output.send_frame(each)
    told = [packet.message for data in sent for packet in OscPacket(data).messages]
    return np.array([message.params[0] for message in told if message.address == "/VMC/Ext/T"])


@given(moments=MOMENTS, dropped=st.integers(2, 5))
def test_all_outputs_say_the_same_whatever_is_late_or_dropped(fuser, monkeypatch, moments, dropped):
    pytest.importorskip("pylsl", exc_type=ImportError)
    queued = list(captured(frames(fuser, 40), moments, FRAME_NS))
    expected = np.array([each.frame.unix_ns for each in queued])
    with monkeypatch.context() as patched:
        lsl = stamps_of_lsl(patched, fuser.setup, queued)
    np.testing.assert_allclose(lsl, 1e-9 * (expected - UNIX_NS), atol=1e-5)
    vmc = stamps_of_vmc(fuser.setup.body, queued[::dropped])
    np.testing.assert_allclose(vmc, 1e-9 * (expected[::dropped] - expected[0]), atol=1e-3)
    encoder = SkeletonJson(fuser.setup)  # of the WebSocket and of Zenoh, which drop frames
    said = [json.loads(encoder.frame(each))["unix_time_s"] for each in queued[::dropped]]
    np.testing.assert_allclose(said, 1e-9 * expected[::dropped], rtol=0.0, atol=1e-5)


@given(moments=MOMENTS)
def test_a_session_keeps_the_times_of_its_live_outputs(fuser, tmp_path_factory, moments):
    """The .mcap of the loop, that of the session, and a replay."""
    rosbags()
    folder = tmp_path_factory.mktemp("s")
    made = [each.frame for each in captured(frames(fuser, 40), moments, FRAME_NS)]
    expected = [frame.unix_ns for frame in made]
    output = McapOutput(folder / "live.mcap", fuser.setup, overwrite=False)
    for frame in made:
        output.write(frame)
    output.close()
    Session.of([(fuser.setup, made)]).save(folder / "s.rrd")
    session = Session.open(folder / "s.rrd")
    session.export(folder / "s.mcap")
    for name in ("live.mcap", "s.mcap"):
        assert [at for topic, at, _ in messages(folder / name) if topic == "/tf"] == expected
    bare = [replace(frame, unix_ns=None) for frame in made]
    assert [frame.unix_ns for frame in as_recorded(bare, session)] == expected
    np.testing.assert_array_equal(capture_times(session.part(slice(1, None))), expected[1:])


def test_a_replay_is_sent_to_lsl_when_it_is_played(fuser, monkeypatch):
    pytest.importorskip("pylsl", exc_type=ImportError)
    for begun_ns in (None, 10**18):
        queued = [
            QueuedFrame(
                k, replace(frame, unix_ns=begun_ns and begun_ns + k * FRAME_NS), k * FRAME_NS, 5 * 10**9
            )
            for k, frame in enumerate(frames(fuser, 10))
        ]
        with monkeypatch.context() as patched:
            lsl = stamps_of_lsl(patched, fuser.setup, queued)
        np.testing.assert_allclose(lsl, 5.0 + 1e-9 * FRAME_NS * np.arange(10), atol=1e-5)
