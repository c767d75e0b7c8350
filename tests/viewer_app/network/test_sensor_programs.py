"""Sensors on several PCs: two programs publish, one fuses. One is killed and started again."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from devices.recorded.files import frame_interval_ns, open_source
from devices.simulated.real_time import PacedSensor
from fusion.body import KINECT_V2
from recordings import Session
from tests.helpers.network import free_address
from tests.helpers.programs import Program, running
from tests.helpers.recorded_pairs import write_view
from tests.helpers.session_text import rows_of
from tests.helpers.two_views import standing
from tests.helpers.waiting import eventually
from viewer_app.sensors.remote import interval_of

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install -e '.[zenoh]'")

SLOW_S = 180.0  # a machine that compiles all kernels first


def frames_in(saved):
    """Frames in the session that grows."""
    return rows_of(saved, "/fused/skeleton") if saved.exists() else 0


def goes_on(saved, frames=30):
    """Returns whether so many more frames are saved in time."""
    wanted = frames_in(saved) + frames
    # reading the whole file costs the programs under test their time
    return eventually(lambda: frames_in(saved) >= wanted, SLOW_S, every=0.5)


def test_one_of_two_sensor_programs_is_killed_and_started_anew(tmp_path):
    """S* continues with the other sensor, then with both."""
    address, saved, report = free_address(), tmp_path / "s.rrd", tmp_path / "s.json"

    def sensor(which):
        return Program("sensor", "--publish", f"lab/{which}", "--simulate", which, "--zenoh-connect", address)

    live = ["live", "--kinect-a", "zenoh:lab/a", "--kinect-b", "zenoh:lab/b", "--zenoh-listen", address]
    a, b = sensor("a"), sensor("b")
    again = None
    try:
        with running(*live, "--no-viewer", "--quiet", "--save", saved, "--report", report) as fusing:
            assert fusing.says("Running.", SLOW_S), fusing.said
            assert goes_on(saved)
            b.kill()
            assert fusing.says("zenoh:lab/b is silent", SLOW_S), fusing.said
            assert goes_on(saved)
            again = sensor("b")
            assert fusing.says("zenoh:lab/b is back.", SLOW_S), fusing.said
            assert goes_on(saved, 90)
            assert fusing.end() == 0, fusing.said
        assert a.end() == 0
        assert "frames published" in a.said
    finally:
        for program in (a, b, again):
            if program is not None:
                program.kill()
    for said in (fusing.said, a.said, b.said):
        assert "Traceback" not in said
    session = Session.open(saved)
    assert (np.diff(session.time_ns) > 0).all()
    seen_a = np.isfinite(session.skeleton_a.positions).any(axis=(1, 2))
    assert np.isfinite(session.fused[int(np.argmax(seen_a)) :]).all(), "before, B alone has no place"
    seen_b = np.isfinite(session.skeleton_b.positions).any(axis=(1, 2))
    assert seen_b[:30].any()
    alone = np.flatnonzero(~seen_b)
    assert len(alone) >= 30
    assert seen_b[alone[29] :].any()
    figures = json.loads(report.read_text())
    assert figures["network"]["b"]["restarts"] == 1
    assert figures["network"]["a"]["restarts"] == 0
    assert figures["streams"]["lost_and_back"] == {"a": 0, "b": 1}
    assert any("zenoh:lab/b is back." in event.text for event in session.events)


@pytest.mark.parametrize("fps", [5, 15, 30])
def test_the_rate_is_the_source_s_own(fps, tmp_path):
    """A recording is announced with its own rate, and live takes what is announced, whatever its --fps."""
    joints = np.tile(standing(KINECT_V2), (20, 1, 1))
    path = write_view(tmp_path / "a.csv", KINECT_V2, joints, every_us=round(1e6 / fps))
    with open_source(path) as source:
        interval_ns = frame_interval_ns(PacedSensor(source))
    assert interval_ns == pytest.approx(1e9 / fps, abs=1000)
    assert interval_of(SimpleNamespace(interval_ns=interval_ns), 30) == interval_ns
    assert interval_of(None, 15) == 66_666_667
