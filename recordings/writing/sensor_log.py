"""Writes what one recorded sensor saw, in the sensor's own frame: skeletons, depth and colour images.

This is no session: nothing is fused. It shows a recording as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from devices.sensor import ColorImage, Sensor, SensorFrame
from fusion.body import Body
from fusion.intrinsics import NOMINAL_INTRINSICS, Intrinsics
from fusion.skeleton import TrackingState
from recordings import layout
from recordings.appearance import entity_styles

_BLOCK = 300
"""Frames without images per write: ten seconds, so that a viewer shows the beginning at once."""


@dataclass(frozen=True)
class SensorEntities:
    """Where the data of one sensor is.

    Attributes:
        sensor: The entity of the sensor; its children are the people, by the tracker's ids.
    """

    sensor: str

    @property
    def depth(self) -> str:
        """The depth camera and its images."""
        return f"{self.sensor}/depth"

    @property
    def color(self) -> str:
        """The colour camera and its images."""
        return f"{self.sensor}/color"

    @property
    def events(self) -> str:
        """What is wrong with the recording."""
        return f"{self.sensor}/events"

    @property
    def people(self) -> str:
        """The entity of which each person is a child."""
        return f"{self.sensor}/people"

    def person(self, name: str) -> str:
        """The skeletons of one person."""
        return f"{self.people}/{rr.escape_entity_path_part(name)}"


class SensorLog:
    """Writes the frames of an open sensor to a stream, which the caller owns.

    Args:
        stream: Receives the data.
        sensor: A recorded sensor, open.
        prefix: The entity below which all data is placed; empty for the root.

    Attributes:
        entities: Where the data is.
        camera: Intrinsics of the depth camera; of skeletons without a camera, those of a usual sensor.
        person_at: (3,) metres: the middle of the people in the first ten seconds with anyone; None without.
    """

    def __init__(self, stream: rr.RecordingStream, sensor: Sensor, prefix: str = "") -> None:
        self._stream, self._sensor = stream, sensor
        self.entities = SensorEntities(f"{prefix.strip('/')}/sensor".strip("/"))
        self.camera: Intrinsics = sensor.intrinsics or NOMINAL_INTRINSICS[sensor.body.name]
        self.person_at: NDArray[np.float64] | None = None
        self._begun_ns: int | None = None
        self._seen: set[str] = set()
        self._has_color = False

    def write(self) -> None:
        """Writes all frames, then what the sensor warns of.

        Raises:
            DeviceError: The recording has no complete frame.
        """
        waiting: list[SensorFrame] = []
        first = 0
        for number, frame in enumerate(self._sensor.frames()):
            if self._begun_ns is None:
                self._begun_ns = frame.time_ns
                self._log_static()
            if frame.depth is not None or frame.color is not None:
                self._log_images(number, frame)
            waiting.append(SensorFrame(frame.time_ns, frame.people))
            if len(waiting) == _BLOCK:
                self._log_people(first, waiting)
                first, waiting = number + 1, []
        if waiting:
            self._log_people(first, waiting)
        for warning in self._sensor.warnings:
            self._stream.log(self.entities.events, rr.TextLog(warning, level="WARN"))

    def _log_static(self) -> None:
        once, entities = self._stream.log, self.entities
        look = entity_styles.annotation_context(self._sensor.body)
        once(entities.sensor, rr.ViewCoordinates.RDF, look, static=True)
        once(entities.depth, entity_styles.camera(self.camera, "a"), entity_styles.DEPTH, static=True)
        once(f"{entities.depth}/edge", entity_styles.image_edge(self.camera), static=True)

    def _log_people(self, first: int, frames: Sequence[SensorFrame]) -> None:
        """Writes skeletons by columns; a person who is not seen has no positions."""
        body = self._sensor.body
        names = self._seen | {name for frame in frames for name in frame.people}
        for name in sorted(names):
            entity = self.entities.person(name)
            if name not in self._seen:
                self._seen.add(name)
                self._stream.log(entity, _joint_look(body), static=True)
            positions = np.full((len(frames), len(body), 3), np.nan, dtype=np.float32)
            colors = np.full((len(frames), len(body)), _rgba(layout.SKELETON_COLORS["a"]), dtype=np.uint32)
            for t, frame in enumerate(frames):
                if name in frame.people:
                    skeleton = frame.people[name]
                    positions[t] = skeleton.positions
                    inferred = skeleton.states == TrackingState.INFERRED
                    colors[t, inferred] = _rgba(layout.STATE_COLORS[TrackingState.INFERRED])
            if self.person_at is None and np.isfinite(positions).any():
                self.person_at = np.nanmedian(positions.reshape(-1, 3).astype(np.float64), axis=0)
            columns = rr.Points3D.columns(positions=positions.reshape(-1, 3), colors=colors.ravel())
            times = [
                rr.TimeColumn(layout.FRAME, sequence=range(first, first + len(frames))),
                rr.TimeColumn(layout.TIME, duration=[np.timedelta64(self._since(f), "ns") for f in frames]),
            ]
            self._stream.send_columns(entity, times, columns.partition([len(body)] * len(frames)))

    def _log_images(self, number: int, frame: SensorFrame) -> None:
        from recordings.images.rvl import MEDIA_TYPE, encode_depth  # imports numba: a second

        self._stream.set_time(layout.FRAME, sequence=number)
        self._stream.set_time(layout.TIME, duration=np.timedelta64(self._since(frame), "ns"))
        if frame.depth is not None:
            image = rr.EncodedDepthImage(encode_depth(frame.depth), media_type=MEDIA_TYPE, meter=1000.0)
            self._stream.log(self.entities.depth, image)
        if frame.color is not None:
            self._log_color(frame.color)

    def _log_color(self, color: ColorImage) -> None:
        entity = self.entities.color
        if not self._has_color:
            self._has_color = True
            pose = color.camera.color_from_depth.inverse()
            place = rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation)
            camera = entity_styles.camera(color.camera.intrinsics, "a")
            self._stream.log(entity, place, camera, static=True)
        self._stream.log(entity, rr.EncodedImage(contents=color.jpeg, media_type="image/jpeg"))

    def _since(self, frame: SensorFrame) -> int:
        """Nanoseconds since the first frame."""
        return frame.time_ns - (self._begun_ns or 0)


def _joint_look(body: Body) -> rr.Points3D:
    return rr.Points3D.from_fields(
        class_ids=layout.CLASS_IDS["a"],
        keypoint_ids=range(len(body)),
        radii=layout.JOINT_RADII["a"],
        show_labels=False,
    )


def _rgba(color: layout.Color) -> int:
    red, green, blue = color
    return red << 24 | green << 16 | blue << 8 | 255
