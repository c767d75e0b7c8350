"""Reads skeletons of the NTU RGB+D data set: ``.skeleton`` text files of a Kinect v2, without times."""

from pathlib import Path

import numpy as np

from devices.sensor import DeviceError
from devices.skeletons.name_tables import FilePoints
from devices.skeletons.read_file import Bodies, FoundPoints, found_of, text_bytes
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
    frames: list[Bodies] = []
    while len(frames) < stated_count or lines.more:
        people = []
        for _ in range(lines.whole_number("body count")):
            person = lines.take("body").split()[0]
            joints = lines.whole_number("joint count")
            if joints != len(KINECT_V2):
                raise DeviceError(
                    f"{lines.here}: a body has {joints} joints; Kinect v2 has {len(KINECT_V2)}."
                )
            rows = np.array([lines.joint() for _ in range(joints)])
            people.append((person, rows[:, :3] * _SENSOR_FROM_CAMERA_SPACE, rows[:, 3].astype(np.uint8)))
        frames.append(Bodies(len(frames) * FRAME_NS, people))
    told = (f"{path}: it states {stated_count} frames and has {len(frames)}; all were read.",)
    return found_of(path, _POINTS, "time_ns", frames, warnings=told if len(frames) > stated_count else ())


_POINTS = FilePoints(KINECT_V2, {name: k for k, name in enumerate(KINECT_V2.joints)})


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
