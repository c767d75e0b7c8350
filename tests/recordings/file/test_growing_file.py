"""A live session can be read while it grows, and survives a kill and a full disk."""

import errno
import os
import shutil
import signal
import threading
from contextlib import suppress
from dataclasses import replace
from functools import cache
from uuid import uuid4

import cv2
import numpy as np
import psutil
import pytest
import rerun as rr
import rerun.blueprint as rrb

from devices import output_file
from devices.events import Event
from devices.output_file import whole_file
from devices.sensor import ColorCamera, ColorImage
from fusion.body import KINECT_V1, KINECT_V2
from fusion.fuser import Fuser
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from recordings.data import layout
from recordings.data.session_arrays import SessionFrame
from recordings.errors import RecordingError
from recordings.file.rrd_file import RrdFile
from recordings.file.session_writer import whole_recording
from recordings.file.stored_images import FileImages
from recordings.fusing.pairs import fuse_one
from recordings.session import Session
from recordings.testing import assert_sessions_match
from recordings.writing.recorder import Recorder
from tests.helpers.command_line import duplex
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.machine import small_disk
from tests.helpers.recalibrated import recorder_to
from tests.helpers.telling_demo import telling_demo, wait_for_frames
from tests.helpers.two_views import calibration_of
from tests.helpers.waiting import eventually
from viewer_app.cli import main
from viewer_app.sinks import compact_copy, queued_file, session_file
from viewer_app.sinks.session_file import SessionFile

_MADE = []


@pytest.fixture(autouse=True)
def closed():
    """Ends the threads that a failed test leaves behind: Python would wait for them."""
    yield
    while _MADE:
        with suppress(OSError):
            _MADE.pop().close()


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(session_file, "_BLOCK_SECONDS", 0.02)
    monkeypatch.setattr(session_file, "_LOOK_SECONDS", 0.01)


@cache
def fused_frames(count, depth=False):
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V1)))
    pairs = frame_pairs(KINECT_V1, count, no_b=(5,), depth=depth)
    return fuser, [SessionFrame(pair, fuser.update(pair.skeletons), 0) for pair in pairs]


def file_of(path, fuser, **options):
    identity = uuid4()
    file = SessionFile(
        path,
        lambda: rr.RecordingStream(layout.APPLICATION_ID, recording_id=identity),
        lambda stream: Recorder(stream, fuser.setup, ("a", "b"), depth_every=1),
        **options,
    )
    _MADE.append(file)
    return file


def finished(file, frames):
    """Writes frames and ends the file."""
    for frame in frames:
        file.write(frame)
    file.finish()
    file.close()


def frames_in(path):
    """How many frames can be read; 0 while there is none."""
    try:
        return len(Session.open(path))
    except RecordingError:
        return 0


def test_it_is_the_same_session_as_one_written_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(compact_copy, "_BLOCK", 20)
    fuser, frames = fused_frames(50)
    file = file_of(tmp_path / "s.rrd", fuser)
    for number, frame in enumerate(frames):
        file.write(frame)
        if number in (9, 29):
            assert eventually(lambda: not file._queue)
            file.event(Event(f"after {number}", "WARN"))
    file.finish()
    file.close()
    assert file.written == 50
    at_once = record_fused(tmp_path / "o.rrd", [frame.pair for frame in frames], calibration_of(KINECT_V1))
    session = Session.open(tmp_path / "s.rrd")
    assert_sessions_match(session, at_once, position_mm=0.0)
    assert [(event.frame, event.text, event.level) for event in session.events] == [
        (9, "after 9", "WARN"),
        (29, "after 29", "WARN"),
    ]
    assert {path.name for path in tmp_path.iterdir()} == {"s.rrd", "o.rrd"}
    # as Rerun's own tools want it
    assert "/fused/skeleton" in rr.chunk.RrdReader(session.path).store().schema().entity_paths()


def test_the_file_waits_for_who_goes_first(tmp_path):
    asked, over = threading.Event(), threading.Event()
    fuser, frames = fused_frames(3)
    file = file_of(tmp_path / "s.rrd", fuser, turn=lambda seconds: (asked.set(), over.wait(5.0)))
    file.write(frames[0])
    assert asked.wait(5.0)
    assert len(file._queue) == 1
    over.set()
    assert eventually(lambda: file.written == 1)
    file.close()


def test_it_can_be_read_while_it_grows(tmp_path):
    path = tmp_path / "s.rrd"
    fuser, frames = fused_frames(40, depth=True)
    file = file_of(path, fuser)
    for frame in frames[:20]:
        file.write(frame)
    assert eventually(lambda: frames_in(path) == 20)
    session = Session.open(path)
    assert (session.damage, session.frames_lost) == ("it was not ended", 0)
    assert [frame for frame, _ in session.depth("a")] == list(range(20))
    with pytest.warns(rr.error_utils.RerunWarning, match="no footer"):  # and Rerun reads it all the same
        chunks = rr.chunk.RrdReader(path).stream().to_chunks()
    assert sum(chunk.num_rows for chunk in chunks if chunk.entity_path == "/fused/skeleton") == 20 + 1
    finished(file, frames[20:])
    session = Session.open(path)
    assert (len(session), session.damage) == (40, None)
    assert [frame for frame, _ in session.depth("b")] == [n for n in range(40) if n != 5]


@pytest.mark.parametrize(("ended", "damage"), [(False, "it was not ended"), (True, "frame 12")])
def test_a_flipped_number_is_noticed_and_counted(ended, damage, tmp_path):
    fuser, frames = fused_frames(20)
    file = file_of(tmp_path / "s.rrd", fuser)
    for frame in frames:
        file.write(frame)
    assert eventually(lambda: frames_in(tmp_path / "s.rrd") == 20)
    if ended:
        file.finish()
    file.close()
    data = bytearray((tmp_path / "s.rrd").read_bytes())
    needle = Session.open(tmp_path / "s.rrd").rows.positions_a[12, 5].tobytes()  # it does not compress
    assert data.count(needle) == 1
    data[data.index(needle) + 2] ^= 1
    (tmp_path / "flipped.rrd").write_bytes(data)
    flipped = Session.open(tmp_path / "flipped.rrd")
    assert (len(flipped), flipped.frames_lost) == (12, 8)
    assert damage in flipped.damage


def grown(path, whole):
    """A file of 200 frames in blocks of ten."""
    fuser, frames = fused_frames(200)
    file = file_of(path, fuser)
    for number, frame in enumerate(frames):
        file.write(frame)
        if number % 10 == 9:
            assert eventually(lambda: file.written == number + 1)  # noqa: B023
    if whole:
        file.finish()
    file.close()
    assert frames_in(path) == 200
    return path


def test_small_blocks_become_large_ones_at_the_end(tmp_path):
    sizes = [grown(tmp_path / f"{whole}.rrd", whole).stat().st_size for whole in (True, False)]
    assert sizes[0] < 0.7 * sizes[1]


def test_a_copy_that_fails_leaves_the_file_that_grew(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(compact_copy.shutil, "copyfile", full)
    fuser, frames = fused_frames(20)
    file = file_of(tmp_path / "s.rrd", fuser)
    finished(file, frames)
    assert file.failure is None
    session = Session.open(tmp_path / "s.rrd")
    assert (len(session), session.damage) == (20, None)
    assert [path.name for path in tmp_path.iterdir()] == ["s.rrd"]


def test_an_existing_file_stays_until_its_replacement_is_ready(tmp_path):
    path = tmp_path / "s.rrd"
    path.write_text("precious")
    fuser, frames = fused_frames(10)
    file = file_of(path, fuser, overwrite=True)
    file.event(Event("nobody there"))
    finished(file, [])
    assert path.read_text() == "precious"
    file = file_of(path, fuser, overwrite=True)
    finished(file, frames)
    assert frames_in(path) == 10
    assert [path.name for path in tmp_path.iterdir()] == ["s.rrd"]


def test_a_file_that_came_in_between_is_not_overwritten(tmp_path):
    path = tmp_path / "s.rrd"
    fuser, frames = fused_frames(10)
    file = file_of(path, fuser)
    path.write_text("precious")
    finished(file, frames)
    kept = tmp_path / "s-2.rrd"
    why = "another program made it meanwhile"
    assert file.failure == f"{path} could not be written: {why}; what was written is {kept}."
    assert (path.read_text(), frames_in(kept), file.lost) == ("precious", 10, 0)


# ------------------------------------------------------------------ the disk


class Disk:
    """The file of a test and the way in which saving fails."""

    def __init__(self, folder, fail, words, mend=None):
        self.folder, self.fail, self.words, self.mend = folder, fail, words, mend


@pytest.fixture(params=["full", "read-only", "limit", "gone"])
def disk(request, tmp_path, monkeypatch):
    folder = tmp_path / "disk"
    folder.mkdir()
    if request.param == "gone":
        yield Disk(folder, lambda: str(folder.rename(tmp_path / "elsewhere")), "moved or deleted")
    elif request.param == "full":
        with small_disk(folder / "small", 2048) as small:
            yield Disk(small, lambda: "", "No space left on device")
    else:
        number, most = {"read-only": (errno.EROFS, 0), "limit": (errno.EFBIG, 1_000_000)}[request.param]
        real, failing = output_file.FileIO.write, threading.Event()

        def write(file, block):
            room = most - file.tell() if failing.is_set() else len(block)
            if room <= 0:
                raise OSError(number, os.strerror(number))
            return int(real(file, block[:room]))

        monkeypatch.setattr(output_file, "FileIO", type("Failing", (output_file.FileIO,), {"write": write}))
        yield Disk(folder, failing.set, os.strerror(number), failing.clear)


@pytest.mark.parametrize("mended", [False, True])
def test_a_disk_that_fails_stops_the_saving_and_nothing_else_until_it_is_mended(disk, mended, monkeypatch):
    if mended and disk.mend is None:
        pytest.skip("it cannot be mended")
    monkeypatch.setattr(queued_file, "_AGAIN_S", 0.01)
    path = disk.folder / "s.rrd"
    fuser, frames = fused_frames(600)
    said = []
    file = file_of(path, fuser, on_failure=said.append)
    for number, frame in enumerate(frames):
        file.write(frame)
        if number == 9:
            assert eventually(lambda: file.written == 10)
            disk.fail()
        if number > 9 and number % 40 == 0:
            assert eventually(lambda: file.waited or not file._queue)
    if mended:
        assert eventually(lambda: file.waited)
        disk.mend()
    file.finish()
    file.close()
    if mended:
        assert said == [file.waited]
        assert disk.words in file.waited
        session = Session.open(path)
        assert (file.failure, len(session), session.damage) == (None, 600, None)
        assert [path.name for path in disk.folder.iterdir()] == ["s.rrd"]
        return
    assert disk.words in file.failure
    assert f"not saved from frame {file.written} on" in file.failure
    assert said == [file.waited, file.failure] if file.waited else [file.failure]
    found = path if path.exists() else disk.folder.parent / "elsewhere" / "s.rrd"
    session = Session.open(found)
    assert len(session) == file.written >= 10
    assert session.damage == "it was not ended", "cut after a whole block"
    assert [path.name for path in found.parent.iterdir()] == ["s.rrd"]


def test_a_nearly_full_disk_is_reported_and_used(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 10**9, 3_000_000))
    path = tmp_path / "s.rrd"
    main(["demo", "--seconds", "1", "--depth", "none", "--no-viewer", "--save", str(path)])
    assert "Only 3 MB are free" in capsys.readouterr().out
    assert frames_in(path) > 0


# ------------------------------------------------------------------ kill -9


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_a_killed_demo_leaves_all_but_the_last_second(tmp_path):
    path, frames = tmp_path / "s.rrd", 70
    child = telling_demo(path, "--depth", "half", "--quiet")
    wait_for_frames(child, frames - 10)
    readable = frames_in(path)
    wait_for_frames(child, 10)
    child.kill()
    _, more = child.communicate()
    assert more == b"." * len(more)
    told = frames + len(more)
    # on a machine that does other things too, a second's work takes longer
    working = 1 + int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))  # the demo, and the tests beside it
    busy = max(1.0, max(os.getloadavg()[0], working) / (os.cpu_count() or 1))
    if busy > 1.0 and not path.exists():
        pytest.skip("this machine is too busy to write a first block so soon")
    session = Session.open(path)
    assert len(session) >= max(told - 30 * busy, readable)
    assert (session.damage is None, session.frames_lost) == (False, 0)
    images = [frame for frame, _ in session.depth("a")]
    # a demo that is late leaves out images
    assert images == sorted(set(images) & set(range(len(session))))
    assert images != []
    with whole_file(tmp_path / "next", overwrite=False) as hidden:  # the next run tidies
        hidden.touch()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["next", "s.rrd"]
    assert duplex("info", path) == 0
    assert duplex("replay", path, "--verify", "--no-viewer") == 0


def test_the_threads_end_with_the_file(tmp_path):
    fuser, frames = fused_frames(3)
    before = threading.active_count()
    for k in range(3):
        finished(file_of(tmp_path / f"{k}.rrd", fuser), frames[:1])
    assert threading.active_count() == before
    np.testing.assert_array_equal([frames_in(tmp_path / f"{k}.rrd") for k in range(3)], 1)


# --- Colour images in a session: read as given, and damage is always reported.


ALL = range(100)
_TURN = RigidTransform.of([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [-0.032, 0.002, 0.004])
_CAMERA = ColorCamera(Intrinsics(64, 48, 60.5, 61.5, 31.5, 24.5, (0.1, -0.2, 0.3)), _TURN)


@pytest.fixture
def images():
    """Noise, which nothing can compress: the file holds these very bytes."""
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (4, 48, 64, 3), dtype=np.uint8)
    return [ColorImage(cv2.imencode(".jpg", image)[1].tobytes(), _CAMERA) for image in noise]


@pytest.fixture
def session(images, tmp_path):
    """Four frames, of which A has colour in all and B in none."""
    return written(tmp_path / "s.rrd", images)


def written(path, images):
    """A session with these images of A, one for each frame."""
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V2)))
    made = []
    for pair, image in zip(frame_pairs(KINECT_V2, len(images)), images, strict=True):
        made.append(fuse_one(fuser, replace(pair, a=replace(pair.a, color=image))))
    with recorder_to(path, fuser.setup, depth_every=1) as recorder:
        recorder.record_all(made)
    return path


def images_of(path):
    with RrdFile(path) as file:
        return FileImages(path, file.identity(), {})


def test_images_come_back_with_lens_and_place(session, images):
    read = list(images_of(session).color("a", ALL))
    assert [(frame, image.jpeg) for frame, image in read] == [(k, i.jpeg) for k, i in enumerate(images)]
    for _, image in read:
        assert image.camera.intrinsics == _CAMERA.intrinsics
        np.testing.assert_array_equal(image.camera.color_from_depth.rotation, _TURN.rotation)
        np.testing.assert_array_equal(image.camera.color_from_depth.translation, _TURN.translation)
    assert list(images_of(session).color("b", ALL)) == []


def test_a_gap_in_the_images_is_no_damage(images, tmp_path):
    given = [images[0], *[None] * 12, images[1]]
    read = images_of(written(tmp_path / "s.rrd", given)).color("a", ALL)
    assert [frame for frame, _ in read] == [0, 13]
    assert read.damaged == 0


# --- A process that writes many files keeps no threads of their streams, and the layout is whole.


LAYOUT = rrb.Blueprint(
    rrb.Horizontal(rrb.Spatial3DView(origin="/points", name="scene"), rrb.TextLogView(origin="/log")),
    rrb.TimePanel(state="collapsed"),
)


def write(path):
    with whole_recording(path, LAYOUT) as stream:
        stream.set_time("frame", sequence=0)
        stream.log("points", rr.Points3D(np.zeros((5, 3))))


def test_no_threads_of_earlier_files_remain(tmp_path):
    process = psutil.Process()
    write(tmp_path / "0.rrd")
    write(tmp_path / "1.rrd")
    threads = process.num_threads()
    for k in range(2, 8):
        write(tmp_path / f"{k}.rrd")
    assert eventually(lambda: process.num_threads() <= threads)
