"""Zenoh, read back by a second session."""

import json

import numpy as np
import pytest

from devices.events import Event
from devices.network.zenoh_session import LOOPBACK, ZenohAddresses, zenoh_session
from devices.sensor import DeviceError
from tests.helpers.live_frames import frames
from tests.helpers.network import free_address
from tests.helpers.waiting import eventually
from viewer_app.addresses import zenoh_warning
from viewer_app.outputs.zenoh_topic import ZenohOutput

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install -e '.[zenoh]'")


def test_a_second_session_reads_the_description_frames_and_events(fuser):
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
        ("tcp/0.0.0.0:7447", "Whoever reaches tcp/0.0.0.0:7447"),
        ("tcp/[::]:7447", "Whoever reaches tcp/[::]:7447"),
        ("tcp/lab-pc:7447", "Whoever reaches tcp/lab-pc:7447"),
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
