"""The people of a stream who are not followed: the bones of each, while there are any."""

from collections.abc import Iterable
from itertools import islice
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from devices.frame_pairs import FramePair
from recordings.data import layout
from recordings.data.checksums import image_checksum
from recordings.data.images import drawn_bones
from recordings.writing.arrow_columns import Column, Times, own_values
from recordings.writing.changes import set_time

_BLOCK = 300  # frames that are sent together
_GONE_NS = 500_000_000  # a sensor without a frame for longer shows nobody


class OthersLog:
    """Logs the people who are not followed, while there are any: the bones of each."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream, self._shown = stream, dict.fromkeys(layout.VIEWS, False)
        self._newest_ns = dict.fromkeys(layout.VIEWS, 0)  # of the frames of each sensor

    def bones(self, side: str, number: int, time_ns: int, bones: NDArray[np.float32]) -> None:
        """Logs :func:`recordings.data.images.drawn_bones` of a frame."""
        if not len(bones) and not self._shown[side]:
            return
        self._shown[side] = len(bones) > 0
        self._log(side, number, time_ns, bones)

    def _log(self, side: str, number: int, time_ns: int, bones: NDArray[np.float32]) -> None:
        set_time(self._stream, number, time_ns)
        self._stream.log(
            layout.others(side),
            rr.Arrows3D.from_fields(origins=bones[:, 0], vectors=bones[:, 1]),
            own_values(crc32=image_checksum(number, bones.tobytes())),
        )

    def all_bones(self, side: str, frames: Iterable[tuple[int, int, NDArray[np.float32]]]) -> None:
        """Logs those of frames that have some, or end them, by columns: number, time and bones of each."""
        waiting = iter(frames)
        while block := list(islice(waiting, _BLOCK)):
            numbers, times, drawn = zip(*block, strict=True)
            every = np.concatenate(drawn)
            arrows = rr.Arrows3D.columns(origins=every[:, 0], vectors=every[:, 1])
            checks = [image_checksum(n, bones.tobytes()) for n, bones in zip(numbers, drawn, strict=True)]
            columns: list[Any] = [
                *arrows.partition([len(bones) for bones in drawn]),
                Column.of_data("crc32", pa.array(checks, pa.int64()), len(block)),
            ]
            self._stream.send_columns(
                layout.others(side), Times.of_frames(np.array(numbers), np.array(times)), columns
            )

    def record(self, number: int, time_ns: int, pair: FramePair) -> None:
        """Logs those of a frame; a sensor without a frame keeps what it has for half a second."""
        views = (pair.a, pair.skeletons.a), (pair.b, pair.skeletons.b)
        for side, (frame, followed) in zip(layout.VIEWS, views, strict=True):
            if frame is None:
                if time_ns - self._newest_ns[side] > _GONE_NS:
                    self.bones(side, number, time_ns, np.zeros((0, 2, 3), np.float32))
                continue
            self._newest_ns[side] = time_ns
            others = [person.positions for person in frame.people.values() if person is not followed]
            body = next(iter(frame.people.values())).body if others else None
            drawn = np.zeros((0, 2, 3), np.float32) if body is None else drawn_bones(body, np.array(others))
            self.bones(side, number, time_ns, drawn)
