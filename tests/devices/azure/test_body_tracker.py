"""The binding to libk4abt, against a stand-in with its prototypes and struct sizes."""

import _ctypes
import ctypes
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from devices.azure.tracking.body_tracker import BodyTracker
from devices.azure.tracking.recorded_captures import CaptureMaker
from devices.azure.tracking.settings import TrackerSettings
from devices.azure.tracking.tracker_queue import TrackerQueue
from devices.sensor import DeviceError, SensorFrame
from fusion.skeleton import TrackingState

TIME_NS = 123_456_000


def _frame(time_ns=TIME_NS, millimetres=2500):
    image = np.full((576, 640), millimetres, np.uint16)
    return SensorFrame(time_ns, depth=image, ir=image)


class _Rig:
    """An open tracker and something to feed it."""

    def __init__(self, standin, **settings):
        self.maker = CaptureMaker(standin.path)
        self.calibration = self.maker.calibration(b"{}", "NFOV_UNBINNED")
        self.tracker = BodyTracker(TrackerSettings(library=standin.path, **settings))

    def open(self):
        self.tracker.open(ctypes.addressof(self.calibration))

    def enqueue(self, frame):
        with self.maker.capture(frame) as capture:
            self.tracker.enqueue(capture)

    def track(self, frame):
        self.enqueue(frame)
        return self.tracker.pop()


@contextmanager
def rig(standin, **settings):
    result = _Rig(standin, **settings)
    result.open()
    try:
        yield result
    finally:
        result.tracker.close()


def test_joints_come_in_metres_with_their_states_and_time(standin):
    with rig(standin) as r:
        bodies = r.track(_frame())
    assert bodies.time_ns == TIME_NS
    skeleton = bodies.people["7"]
    assert skeleton.time_ns == TIME_NS
    # The stand-in puts joint j at (j, -10 j, depth) mm, with confidence j mod 4.
    joints = np.arange(32)
    expected = np.stack((joints / 1000, joints / -100, np.full(32, 2.5)), axis=-1)
    seen = joints % 4 != 0
    np.testing.assert_allclose(skeleton.positions[seen], expected[seen], rtol=1e-6)
    assert np.isnan(skeleton.positions[~seen]).all()
    states = [TrackingState.NOT_TRACKED, TrackingState.INFERRED, TrackingState.TRACKED, TrackingState.TRACKED]
    assert skeleton.states.tolist() == [states[j % 4] for j in joints]


@pytest.mark.parametrize(
    ("bodies", "first_id", "ids"),
    [(3, 41, ["41", "42", "43"]), (0, 7, []), (1, 0xFFFFFFFF, [])],
    ids=["three people", "an empty room", "a body without an id"],
)
def test_every_body_with_an_id_is_given(standin, bodies, first_id, ids):
    standin.bodies, standin.first_id = bodies, first_id
    with rig(standin) as r:
        people = r.track(_frame()).people
    assert list(people) == ids
    assert [round(float(s.positions[1, 0]), 3) for s in people.values()] == [0.001, 1.001, 2.001][: len(ids)]


@pytest.mark.parametrize(
    ("processing", "number"), [("gpu", 0), ("cpu", 1), ("cuda", 2), ("tensorrt", 3), ("directml", 4)]
)
def test_the_configuration_reaches_the_library(standin, processing, number):
    with rig(standin, processing=processing):
        assert standin.processing == number


@pytest.mark.parametrize(("orientation", "number"), [(0, 0), (90, 2), (180, 3), (270, 1)])
def test_the_orientation_reaches_the_library_as_seen_from_before_the_sensor(standin, orientation, number):
    with rig(standin, orientation=orientation):
        assert standin.orientation == number


def test_every_wait_is_finite_and_nothing_is_smoothed_by_default(standin):
    with rig(standin, timeout_s=2.0) as r:
        assert standin.smoothing == 0.0
        assert r.tracker.pop(0.0) is None, "no result yet"
        r.enqueue(_frame())
        assert standin.wait_ms == 20_000  # ten times as long until the first result
        r.tracker.pop()
        assert standin.wait_ms == 20_000
        r.enqueue(_frame())
        assert standin.wait_ms == 2000
        r.tracker.pop(0.025)
        assert standin.wait_ms == 25


@pytest.mark.parametrize(
    ("step", "status", "message"),
    [
        ("enqueue", 2, "stalls: it took no capture"),
        ("enqueue", 1, r"refused a capture \(status 1\).*not pyk4a-bundle"),
        ("pop", 2, r"stalls: it gave no result for 20 s.*track later"),
        ("pop", 1, r"failed \(status 1\).*started again"),
    ],
)
def test_tracker_stalls_or_crashes_to_an_error_code(standin, step, status, message):
    with rig(standin, timeout_s=2.0) as r:
        setattr(standin, f"{step}_status", status)
        with pytest.raises(DeviceError, match=message):
            r.track(_frame())


def test_a_tracker_that_does_not_start_says_what_to_check(standin):
    standin.create_status = 1
    with pytest.raises(DeviceError, match=r"did not start \(status 1, gpu\).*onnx.*processing cpu"):
        _Rig(standin).open()


def test_a_depth_mode_the_tracker_cannot_use_is_refused(standin):
    maker = CaptureMaker(standin.path)
    calibration = maker.calibration(b"{}", "WFOV_UNBINNED")
    with pytest.raises(DeviceError, match="NFOV_UNBINNED nor WFOV_2X2BINNED"):
        BodyTracker(TrackerSettings(library=standin.path)).open(ctypes.addressof(calibration))


def test_a_calibration_that_the_sdk_refuses_is_reported(standin):
    standin.calibration_status = 1
    with pytest.raises(DeviceError, match="refuses the recording's calibration"):
        CaptureMaker(standin.path).calibration(b"{}", "NFOV_UNBINNED")


def test_a_frame_without_infrared_cannot_be_tracked(standin):
    depth = np.zeros((576, 640), np.uint16)
    with (
        pytest.raises(DeviceError, match="needs depth and infrared"),
        CaptureMaker(standin.path).capture(SensorFrame(0, depth=depth)),
    ):
        pass


def test_a_library_that_is_missing_none_or_another_is_reported(tmp_path):
    (tmp_path / "text.so").write_text("not a library")
    for library, message in (
        (tmp_path / "libk4abt.so", r"No library at .*libk4abt\.so.*`k4abt=PATH`"),
        (tmp_path / "text.so", "cannot be loaded.*Body Tracking SDK"),
        (Path(_ctypes.__file__), r"has no k4abt_tracker_create: it is not libk4abt 1\.1"),
    ):
        with pytest.raises(DeviceError, match=message):
            BodyTracker(TrackerSettings(library=library)).open(0)


def test_a_closed_tracker_refuses_work(standin):
    tracker = BodyTracker(TrackerSettings(library=standin.path))
    with pytest.raises(DeviceError, match="not open"):
        tracker.pop()
    tracker.close()


def test_opening_again_leaves_no_tracker_behind(standin):
    with rig(standin) as r:
        r.open()
        assert standin.alive == 1


class Hanging:
    """A tracker that gives nothing; time passes only while it is waited for."""

    patience_s = 5.0

    def __init__(self, results=()):
        self.now_ns, self.results, self.waits = 10**12, list(results), []

    def clock(self):
        return self.now_ns

    def enqueue(self, capture): ...

    def pop(self, wait_s):
        self.waits.append(wait_s)
        self.now_ns += max(round(wait_s * 1e9), 1000)
        return self.results.pop(0) if self.results else None


@pytest.mark.parametrize("frames", [1, 2, 3])
@pytest.mark.parametrize("elsewhere_s", [0.0, 0.005, 0.04])
def test_a_hanging_tracker_is_told_after_the_time_that_is_named(frames, elsewhere_s):
    tracker = Hanging([SensorFrame(1000)])
    queue = TrackerQueue(tracker, 0.025, clock=tracker.clock)
    queue.put(SensorFrame(1000), 1)
    assert len(list(queue.done())) == 1
    for k in range(frames):
        queue.put(SensorFrame(2000 + 1000 * k), 1)
    begun_ns = tracker.now_ns

    def run():
        while True:
            assert list(queue.done()) == []
            tracker.now_ns += round(elsewhere_s * 1e9)  # the next capture is fetched

    with pytest.raises(DeviceError, match="gave no result for 5 s"):
        run()
    assert 5.0 <= (tracker.now_ns - begun_ns) * 1e-9 < 5.3
    assert set(tracker.waits[1:]) == {0.25 if frames > 2 else 0.025}


def test_a_program_that_was_stopped_does_not_blame_its_tracker():
    tracker = Hanging()
    queue = TrackerQueue(tracker, 0.025, clock=tracker.clock)
    queue.put(SensorFrame(1000), 1)
    assert list(queue.done()) == []
    tracker.now_ns += 60 * 10**9
    tracker.results = [SensorFrame(1000)]
    tracker.pop, pop = lambda wait_s: tracker.waits.append(wait_s), tracker.pop
    assert list(queue.done()) == []
    tracker.pop = pop
    assert len(list(queue.done())) == 1


@pytest.mark.parametrize("ends", ["done", "flush"])
def test_waiting_for_a_tracker_ends_when_it_is_interrupted(ends):
    tracker = Hanging()
    stops_ns = tracker.now_ns + 10**9
    queue = TrackerQueue(tracker, 0.0, clock=tracker.clock, interrupted=lambda: tracker.now_ns >= stops_ns)
    for k in range(3):
        queue.put(SensorFrame(1000 + 1000 * k), 1)
    assert list(getattr(queue, ends)()) == []
    assert tracker.now_ns - stops_ns <= 0.25e9
