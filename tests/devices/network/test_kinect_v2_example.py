"""The example for a Kinect v2 per PC, with a stand-in for kinect-next, which runs on Windows only."""

import os
import subprocess
import sys

import numpy as np
import pytest

from devices.network.remote_sensor import RemoteSensor
from devices.network.zenoh_session import ZenohAddresses
from fusion.body import KINECT_V2
from tests.helpers.network import free_address
from tests.helpers.programs import ROOT

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install -e '.[zenoh]'")

STAND_IN = '''
import enum, time
from types import SimpleNamespace as Some

class StreamType(enum.IntFlag):
    BODY = 32

class KinectSensor:
    """Two people, of whom one is tracked, in Microsoft's axes: x to the sensor's left, y up."""

    def __init__(self, streams):
        assert streams == StreamType.BODY

    def __enter__(self):
        return self

    def __exit__(self, *fault): ...

    def poll_frames(self):
        for tick in range(10_000):
            joints = [
                Some(position=Some(x=0.1, y=0.2, z=2.0 + k / 100), tracking_state=2 if k else 1)
                for k in range(25)
            ]
            yield Some(tracked_bodies=[Some(tracking_id=72057594037, joints=joints)], relative_time_ns=tick)
            time.sleep(1 / 30)
'''


def test_a_kinect_v2_is_published_in_the_projects_axes(tmp_path):
    (tmp_path / "kinect_next.py").write_text(STAND_IN, encoding="utf-8")
    address = free_address()
    example = subprocess.Popen(
        [sys.executable, ROOT / "examples/kinect_v2_on_another_pc.py", "lab/a", address],
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(tmp_path)))},
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        with RemoteSensor("lab/a", ZenohAddresses(listen=(address,)), appear_s=60.0) as far:
            assert far.body is KINECT_V2
            frame = next(iter(far.frames()))
    finally:
        example.kill()
        _, said = example.communicate()
    assert "Traceback" not in said
    (person,) = frame.people.values()
    assert list(frame.people) == ["72057594037"]
    expected = np.array([(-0.1, -0.2, 2.0 + k / 100) for k in range(25)], dtype=np.float32)
    assert np.array_equal(person.positions, expected)
    assert person.states.tolist() == [1] + [2] * 24
