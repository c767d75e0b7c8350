"""Lab Streaming Layer, read back by a pylsl inlet."""

from uuid import uuid4

import numpy as np
import pytest

from devices.events import Event
from fusion.body import KINECT_V2
from tests.helpers.live_frames import frames
from viewer_app.outputs.lab_streaming import LabStreamingOutput
from viewer_app.outputs.output import confidence


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
