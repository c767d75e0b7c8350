"""The file behind a queue: whatever the disk does, each frame is written, or counted as lost and said."""

import errno
import os
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewer_app.sinks.queued_file import QueuedFile


class Disk(QueuedFile[float]):
    """A file of numbers on a disk with room for some; n + 0.5 is without images, text is no frame."""

    keep, keep_with_images, frame_type = 6, 3, float

    def __init__(self, room, placed=True, fault=None, **options):
        super().__init__(Path("s.rrd"), "test", **options)
        self.go, self.content = threading.Event(), []
        self.room, self.place, self.fault = room, SimpleNamespace(placed=placed), fault
        self._thread.start()

    def _write(self):
        self.go.wait(20.0)
        while items := self._queue.take(None, most=1):
            if self.fault is not None:
                raise self.fault
            if isinstance(items[0], str):
                continue
            with self._counting(1, self.place):
                if len(self.content) >= self.room:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                self.content += items

    def _without_images(self, item):
        return item + 0.5


@given(
    frames=st.lists(st.booleans(), max_size=12), room=st.integers(0, 8), placed=st.booleans(),
    late=st.integers(0, 2),
)  # fmt: skip
def test_each_frame_is_written_or_counted_and_said(frames, room, placed, late):
    said = []
    file = Disk(room, placed, on_failure=said.append)
    for number, is_frame in enumerate(frames):
        file._queue.put(float(number) if is_frame else "an event")
        assert len(file._queue) <= 6 + frames[: number + 1].count(False)
    waiting, thinned = list(file._queue), file.without_images
    file.go.set()
    file.close()
    for number in range(late):
        file._queue.put(float(number))
    file.close()
    kept = [item for item in waiting if not isinstance(item, str)]
    full = len(kept) > room
    assert file.content == kept[:room]
    assert file.written == (0 if full and not placed else len(file.content))
    assert file.lost + file.written == frames.count(True) + late
    assert thinned == sum(item % 1 == 0.5 for item in kept)
    assert said == [file.failure] * full
    assert full == (file.failure is not None and "No space left on device" in file.failure)
    why = "" if full else ": the disk was too slow"  # a failure says its own reason
    frames = "1 frame is" if file.lost == 1 else f"{file.lost} frames are"
    assert (f"{file.path}: {frames} not saved{why}." in file.missing) == (file.lost > 0)


def test_a_fault_of_the_writer_reaches_who_closes_once():
    file = Disk(9, fault=ValueError("broken"))
    file._queue.put(1.0)
    file.go.set()
    with pytest.raises(ValueError, match="broken"):
        file.close()
    file.close()
    assert (file.written, file.lost) == (0, 1)
