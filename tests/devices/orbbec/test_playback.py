"""Recordings of Orbbec's SDK v2, through the stand-in's ``PlaybackDevice``."""

import pytest

from devices.blazepose.blazepose import BlazePose
from devices.orbbec.playback import OrbbecRecording
from devices.recorded import recording_apart
from devices.recorded.files import frame_count, open_source
from devices.recorded.two_recordings import RecordingChoice, read_two
from devices.sensor import DeviceError
from devices.tracker_choice import TrackerChoice
from fusion.body import BLAZEPOSE
from fusion.skeleton import Skeleton
from tests.helpers.orbbec.standin import Bag, Orbbec
from tests.helpers.standin_camera import VirtualTime
from tests.helpers.two_views import A_FROM_B, moving

OURS = TrackerChoice("blazepose", "a test")


def _bag(bus, path, frames=5, **faults):
    path.touch()
    ends = bool(faults.pop("ends", True))
    bus.bags[str(path)] = Bag(Orbbec(path.stem, **faults), frames, ends)
    return path


def test_a_recording_gives_its_frames_and_ends(orbbecs, tmp_path):
    path = _bag(orbbecs, tmp_path / "a.bag")
    with OrbbecRecording(path) as recording:
        frames = list(recording.frames())
        assert (recording.intrinsics.width, recording.intrinsics.fx) == (640, 504)
        assert (recording.duration_ns, recording.interval_ns) == (166_000_000, 33_333_333)
    assert [frame.time_ns for frame in frames] == [1_000_000_000 + 33_333_000 * k for k in range(1, 6)]
    assert all(frame.depth is not None and frame.ir is not None for frame in frames)
    assert recording.warnings == []
    assert orbbecs.running == []
    with OrbbecRecording(_bag(orbbecs, tmp_path / "b.bag", skips=2)) as recording:
        assert len(list(recording.frames())) == 5
    assert "frames are missing: 8;" in recording.warnings[0]


def _recording(bus, path):
    """A recording that is played in virtual time."""
    bus.time = VirtualTime()
    return OrbbecRecording(path, lambda: 1e-9 * bus.time.now_ns())


def test_a_recording_that_never_reports_its_end_is_abandoned(orbbecs, tmp_path):
    with _recording(orbbecs, _bag(orbbecs, tmp_path / "a.bag", ends=False)) as recording:
        assert len(list(recording.frames())) == 5


@pytest.mark.parametrize("ends", [True, False])
def test_a_recording_that_ends_early_is_told(orbbecs, tmp_path, ends):
    with _recording(orbbecs, _bag(orbbecs, tmp_path / "a.bag", 90, ends=ends)) as recording:
        orbbecs.bags[str(recording.path)].frames = 30
        assert len(list(recording.frames())) == 30
    (said,) = recording.warnings
    assert "depth ended early: 30 frames of the first 1.0 of 3.0 s could be read" in said
    with (
        _recording(orbbecs, _bag(orbbecs, tmp_path / "b.bag", 0)) as recording,
        pytest.raises(DeviceError, match="holds no complete frame"),
    ):
        list(recording.frames())


def test_a_fault_of_closing_does_not_hide_what_was_read(orbbecs, tmp_path):
    path = _bag(orbbecs, tmp_path / "a.bag")
    with OrbbecRecording(path) as recording:
        frames = recording.frames()
        next(frames)
        orbbecs.bags[str(path)].sensor.plugged = False  # the stand-in's stop now fails
        frames.close()


def test_a_file_that_is_not_a_recording_is_refused(orbbecs, tmp_path):
    other = tmp_path / "other.bag"
    with pytest.raises(DeviceError, match="No file"):
        OrbbecRecording(other).__enter__()
    other.write_bytes(b"something else")
    with pytest.raises(DeviceError, match=r"other\.bag cannot be read \(Error reading.*OrbbecViewer"):
        OrbbecRecording(other).__enter__()
    blind = _bag(orbbecs, tmp_path / "blind.bag", sizes=())
    with pytest.raises(DeviceError, match=r"blind\.bag has no depth stream"):
        OrbbecRecording(blind).__enter__()


def test_two_recordings_are_tracked_by_our_tracker(orbbecs, tmp_path, monkeypatch):
    truth = moving(BLAZEPOSE, 20)
    for name in "ab":
        _bag(orbbecs, tmp_path / f"{name}.bag", 20)
    monkeypatch.setattr(BlazePose, "__enter__", lambda self: self)

    def track(_self, image, depth, _camera, time_ns):
        assert image.shape == depth.shape
        seen = truth[int(depth[0, 0]) - 2001]  # the stand-in's depth numbers its frames
        return {"1": Skeleton.of(BLAZEPOSE, A_FROM_B.inverse().apply(seen), time_ns=time_ns)}

    monkeypatch.setattr(BlazePose, "track", track)
    # the stand-in is in this process
    monkeypatch.setattr(recording_apart, "items_of", lambda function, *arguments, **_: function(*arguments))
    read = read_two(RecordingChoice(tmp_path / "a.bag"), RecordingChoice(tmp_path / "b.bag"), OURS)
    assert read.body is BLAZEPOSE
    assert len(read.pairing.pairs) == 20
    assert read.tracker == "blazepose full"
    with open_source(tmp_path / "a.bag", tracker=OURS) as source:
        assert frame_count(source) == 20


def test_k4abt_cannot_be_asked_for(orbbecs, tmp_path):
    path = _bag(orbbecs, tmp_path / "a.bag")
    with pytest.raises(DeviceError, match=r"a\.bag: k4abt accepts images of libk4a only"):
        open_source(path, tracker=TrackerChoice("k4abt", "asked for with --tracker", asked=True))
    assert open_source(path, tracker=TrackerChoice("k4abt", "it works")).body is BLAZEPOSE
