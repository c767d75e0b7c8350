"""Lab Streaming Layer and Zenoh, read back by an inlet and by a second session."""

import json
import time
from uuid import uuid4

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.events import Event
from devices.network.zenoh_session import LOOPBACK, ZenohAddresses, zenoh_session
from devices.sensor import DeviceError
from fusion.body import KINECT_V2
from tests.helpers.live_frames import frames
from tests.helpers.network import free_address
from tests.helpers.waiting import eventually
from viewer_app.addresses import zenoh_warning
from viewer_app.outputs.lab_streaming import LabStreamingOutput
from viewer_app.outputs.output import confidence
from viewer_app.outputs.zenoh_topic import ZenohOutput
from viewer_app.sinks.queued_sink import QueuedFrame


def lsl():
    try:
        import pylsl
    except (ImportError, RuntimeError, OSError):
        pytest.skip("no pylsl: pip install -e '.[lsl]'")
    return pylsl


def test_an_inlet_reads_joints_confidences_times_and_events(fuser):
    lsl()
    name = f"test-{uuid4().hex[:8]}"
    output = LabStreamingOutput(name, KINECT_V2, 30.0)
    import pylsl

    try:
        found = pylsl.resolve_byprop("name", name, timeout=30.0)
        assert len(found) == 1
        inlet = pylsl.StreamInlet(found[0])
        events = pylsl.StreamInlet(pylsl.resolve_byprop("name", f"{name}-events", timeout=30.0)[0])
        info = inlet.info(timeout=30.0)
        assert (info.type(), info.channel_count(), info.nominal_srate()) == ("MoCap", 100, 30.0)
        inlet.open_stream(timeout=30.0)
        events.open_stream(timeout=30.0)
        made = frames(fuser, 30)
        read = []
        for frame in made:
            output.write(frame)
            sample, stamp = inlet.pull_sample(timeout=30.0)
            read.append((sample, stamp))
        output.event(Event("sensor B lost", "WARN"))
        assert events.pull_sample(timeout=30.0)[0] == ["WARN: sensor B lost"]
        assert abs(pylsl.local_clock() - read[-1][1]) < 30.0
    finally:
        output.close()
    values = np.array([sample for sample, _ in read]).reshape(30, 25, 4)
    positions = np.array([frame.fused.positions for frame in made])
    np.testing.assert_allclose(values[..., :3], positions, atol=1e-6)
    np.testing.assert_allclose(values[..., 3], [confidence(f.fused) for f in made], atol=1e-6)
    assert (np.diff([stamp for _, stamp in read]) > 0.0).all()
    channel = info.desc().child("channels").child("channel")
    labels = []
    while not channel.empty():
        kinds = ("label", "marker", "type", "unit")
        labels.append(tuple(channel.child_value(kind) for kind in kinds))
        channel = channel.next_sibling()
    assert len(labels) == 100
    assert labels[0] == ("SpineBase_PositionX", "SpineBase", "PositionX", "meters")
    assert labels[3] == ("SpineBase_Confidence", "SpineBase", "Confidence", "normalized")
    assert info.desc().child("acquisition").child_value("manufacturer") == "duplex-kinects"


@given(
    delays_ms=st.lists(st.one_of(st.integers(5, 40), st.integers(5, 450)), min_size=2, max_size=60),
    interval_ms=st.sampled_from([1, 11, 33, 200]),
)
def test_lsl_stamps_go_forward_and_are_not_ahead_of_the_frames(fuser, monkeypatch, delays_ms, interval_ms):
    """A frame that took less time than all before it moves what is known of the clocks back."""
    stamps = []

    class Outlet:
        def __init__(self, info):
            self.records = info.name() == "x"

        def push_sample(self, _, stamp):
            if self.records:
                stamps.append(stamp)

    pylsl = lsl()
    monkeypatch.setattr(pylsl, "StreamOutlet", Outlet)
    ahead_s = pylsl.local_clock() - time.perf_counter()
    output, (frame,) = LabStreamingOutput("x", KINECT_V2, 30.0), frames(fuser, 1)
    written_s = []
    for number, delay_ms in enumerate(delays_ms):
        time_ms = number * interval_ms
        written_s.append(max((time_ms + delay_ms) * 1e-3, *written_s[-1:], 0.0))
        output.send_frame(QueuedFrame(number, frame, time_ms * 1_000_000, round(written_s[-1] * 1e9)))
    output.close()
    assert (np.diff(stamps) > 0.0).all()
    assert (np.array(stamps) - ahead_s <= np.array(written_s) + 1e-3).all()


def test_a_second_session_reads_the_description_frames_and_events(fuser):
    pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install -e '.[zenoh]'")
    address = free_address()
    got = {"hello": [], "frame": [], "event": []}

    def take(sample):
        got[str(sample.key_expr).rpartition("/")[2]].append(json.loads(bytes(sample.payload)))

    output = ZenohOutput("lab/person", ZenohAddresses(listen=(address,)), fuser.setup)
    try:
        with zenoh_session(ZenohAddresses(connect=(address,))) as other:
            other.declare_subscriber("lab/person/*", take)
            made = frames(fuser, 40)

            def reached():
                output.write(made[0])
                return bool(got["frame"])

            assert eventually(reached)
            assert eventually(lambda: output.counts.sent > 0)
            before = len(got["frame"])
            for frame in made:
                output.write(frame)
                assert eventually(lambda f=frame: got["frame"][-1]["time_s"] >= f.pair.time_ns * 1e-9 - 1e-5)
            output.event(Event("B lost", "WARN"))
            assert eventually(lambda: bool(got["event"]))
    finally:
        output.close()
    assert len(got["frame"]) - before >= 40
    np.testing.assert_allclose(got["frame"][-1]["positions"], made[-1].fused.positions, atol=1e-4)
    assert got["hello"][-1]["schema"] == "duplex-kinects/skeleton"
    # 1.3 s of frames: at the start, and again after a second for latecomers
    assert len(got["hello"]) <= 2
    assert got["event"][-1]["text"] == "B lost"


@pytest.mark.parametrize(
    ("listening", "reached"),
    [
        (LOOPBACK, ""),
        ("tcp/[::1]:7447", ""),
        ("udp/localhost:7447", ""),
        ("tcp/0.0.0.0:7447", "Anyone who can reach tcp/0.0.0.0:7447"),
        ("tcp/[::]:7447", "Anyone who can reach tcp/[::]:7447"),
        ("tcp/lab-pc:7447", "Anyone who can reach tcp/lab-pc:7447"),
    ],
)
def test_addresses_that_others_reach_are_warned_of(listening, reached):
    warning = zenoh_warning((LOOPBACK, listening))
    assert bool(warning) == bool(reached)
    assert warning.startswith(reached)
    assert LOOPBACK not in warning


def test_this_machine_only_unless_an_address_is_given():
    assert ZenohAddresses.of_meeting_point((), ()) == ZenohAddresses(listen=(LOOPBACK,))
    elsewhere = ("tcp/192.0.2.7:7447",)
    assert ZenohAddresses.of_meeting_point((), elsewhere) == ZenohAddresses(connect=elsewhere)
    with pytest.raises(DeviceError, match="not a Zenoh address"):
        ZenohAddresses.of_meeting_point(("192.0.2.7",), ())
