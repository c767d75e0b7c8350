"""Reads skeletons of the NTU RGB+D data set: ``.skeleton`` text files of a Kinect v2, without times."""

from pathlib import Path

import numpy as np

from devices.sensor import DeviceError
from devices.skeletons.read_file import FoundPoints, JointRows, found_of, text_bytes
from devices.skeletons.stated_format import UNSTATED, StatedFormat
from fusion.body import KINECT_V2
from fusion.support.progress import Progress, quietly

FRAME_NS = 33_333_333
"""Frame interval. The files contain no times; the frame rate is 30 Hz."""

# Camera space has x to the sensor's left and y up.
_SENSOR_FROM_CAMERA_SPACE = np.array([-1.0, -1.0, 1.0])


def read_skeleton(path: Path, stated: StatedFormat = UNSTATED, progress: Progress = quietly) -> FoundPoints:
    """Reads a ``.skeleton`` file.

    Raises:
        DeviceError: The file is empty or cut off, or has an invalid line; the message names the line.
    """
    stated.refuse_for(path)
    del progress
    lines = _Lines(path)
    stated_count = lines.whole_number("frame count")
    people: dict[str, int] = {}
    frame, person, rows = [], [], []
    count = 0
    while count < stated_count or lines.more:
        for _ in range(lines.whole_number("body count")):
            frame.append(count)
            person.append(people.setdefault(lines.take("body").split()[0], len(people)))
            joints = lines.whole_number("joint count")
            if joints != len(KINECT_V2):
                raise DeviceError(
                    f"{lines.here}: a body has {joints} joints; Kinect v2 has {len(KINECT_V2)}."
                )
            rows += [lines.joint() for _ in range(joints)]
        count += 1
    values = np.array(rows, dtype=np.float64).reshape(-1, 4)
    each = np.repeat(np.array(frame, dtype=np.int64), len(KINECT_V2))
    told = (f"{path}: it states {stated_count} frames and has {count}; all were read.",)
    found = JointRows(
        path, "time_ns", np.arange(count) * FRAME_NS, each, list(people),
        np.repeat(np.array(person, dtype=np.int64), len(KINECT_V2)), KINECT_V2.joints,
        np.tile(np.arange(len(KINECT_V2)), len(frame)), values[:, :3] * _SENSOR_FROM_CAMERA_SPACE,
        values[:, 3].astype(np.uint8), lambda row: f"in frame {each[row]}",
    )  # fmt: skip
    return found_of(found, told=told if count > stated_count else ())


class _Lines:
    def __init__(self, path: Path) -> None:
        self._path = path
        lines = text_bytes(path).decode("utf-8-sig").splitlines()
        self._lines = [(number, line) for number, line in enumerate(lines, start=1) if line.strip()][::-1]
        self._number = 0

    @property
    def here(self) -> str:
        return f"{self._path}, line {self._number}"

    @property
    def more(self) -> bool:
        return bool(self._lines)

    def take(self, what: str) -> str:
        """The next line that is not blank."""
        if not self._lines:
            ended = f"is cut off at line {self._number + 1}" if self._number else "is empty"
            raise DeviceError(f"{self._path} {ended}, where a {what} is expected.")
        self._number, line = self._lines.pop()
        return line

    def whole_number(self, what: str) -> int:
        line = self.take(what)
        try:
            number = int(line)
        except ValueError:
            number = -1
        if number < 0:
            raise DeviceError(f"{self.here}: {what} must be a whole number; got {line[:40]!r}.")
        return number

    def joint(self) -> tuple[float, float, float, float]:
        """Reads x, y, z in camera space and the state from a line of twelve numbers."""
        line = self.take("joint")
        try:
            values = [float(value) for value in line.split()]
        except ValueError:
            raise DeviceError(f"{self.here}: expected numbers only; got {line[:60]!r}.") from None
        if len(values) != 12 or values[11] not in (0.0, 1.0, 2.0):
            raise DeviceError(
                f"{self.here}: a joint has 12 numbers, the last a state 0, 1 or 2; got {line[:60]!r}. "
                "Is the file cut off?"
            )
        return values[0], values[1], values[2], values[11]
