"""Every log call. What never changes is logged once; frames go out one by one (live) or by columns (offline).

Both ways give the same layout, because both come from the same list of what a frame is: :func:`_streams`.
"""

from __future__ import annotations

import colorsys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from fusion.body import Body
from fusion.fuser import Fuser
from recordings import layout
from recordings.arrays import RecordedFrame, SessionArrays
from recordings.checksums import (
    frame_checksums,
    fused_checksums,
    image_checksum,
    properties_checksum,
    text_checksum,
)
from recordings.rvl import MEDIA_TYPE, encode_depth


class Recorder:
    """Writes one session to a Rerun recording stream, which the caller owns and closes.

    Args:
        stream: Where to log to; its sinks decide whether that is a viewer, a file or both.
        fuser: Whose settings, calibration and intrinsics the session keeps.
        sources: What the sensors are called, K_A first.
        depth_every: Keep the depth images of every so many pairs; 0 for none.
        about: More to say of the session's origin, kept among its properties.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        fuser: Fuser,
        sources: tuple[str, str],
        depth_every: int = 0,
        about: Mapping[str, str | int] | None = None,
    ) -> None:
        self._stream = stream
        self._calibration = fuser.calibration
        self._frames = 0
        self._start_ns: int | None = None
        self._last: tuple[int, int] | None = None
        self._depth_every = depth_every
        self._log_static(fuser)
        properties = self._properties(fuser, sources, about or {})
        for name, values in properties.items():
            stream.send_property(name, rr.AnyValues(**values))
        stream.send_property("check", rr.AnyValues(crc32=properties_checksum(properties)))
        self.calibrate(fuser)
        # what a reader needs first must stand first in the file; columns would overtake it
        stream.flush(timeout_sec=0.0)

    def calibrate(self, fuser: Fuser) -> None:
        """Keeps the calibration with which the frames that follow are fused, by a new fuser."""
        calibration = self._calibration = fuser.calibration
        registration = calibration.registration
        values: dict[str, Any] = {
            "how": calibration.how,
            "rotation": calibration.a_from_b.rotation.ravel(),
            "translation": calibration.a_from_b.translation,
            "bone_lengths": calibration.bone_lengths,
            "residual_median": np.nan if registration is None else registration.residual_median,
            "residual_rms": np.nan if registration is None else registration.residual_rms,
        }
        self._stream.set_time(layout.FRAME, sequence=self._frames)
        self._stream.set_time(layout.TIME, duration=np.timedelta64(self._last[1] if self._last else 0, "ns"))
        check = properties_checksum({"calibration": {"frame": self._frames, **values}})
        self._stream.log(layout.CALIBRATION, rr.AnyValues(**values, calibration_crc32=check))

    def record(self, frame: RecordedFrame) -> None:
        """Logs one frame at once, for live use."""
        rows = self._stack([frame])
        self._stream.set_time(layout.FRAME, sequence=int(rows.frame[0]))
        self._stream.set_time(layout.TIME, duration=np.timedelta64(int(rows.time_ns[0]), "ns"))
        for stream in _streams(rows):
            self._stream.log(stream.entity, stream.archetype(**stream.of_frame(0)))
        self._log_depth([frame], rows)
        self._last = (int(rows.frame[0]), int(rows.time_ns[0]))

    def record_all(self, frames: Sequence[RecordedFrame]) -> SessionArrays:
        """Logs many frames by columns, for offline use; may be called again with the frames that follow.

        Returns:
            What was logged.
        """
        rows = self._stack(frames)
        self.record_rows(rows)
        self._log_depth(frames, rows)
        return rows

    def record_rows(self, rows: SessionArrays, fused_crc: NDArray[np.uint32] | None = None) -> None:
        """Logs frames that are arrays already, under the numbers and times they have.

        Args:
            rows: The frames.
            fused_crc: (T,) checksums of S* in float64, where `rows` have it from a file, in float32.
        """
        times = [
            rr.TimeColumn(layout.FRAME, sequence=rows.frame),
            rr.TimeColumn(layout.TIME, duration=rows.time_ns.astype("timedelta64[ns]")),
        ]
        for stream in _streams(rows, fused_crc):
            self._stream.send_columns(stream.entity, times, stream.columns())
        self._frames = max(self._frames, int(rows.frame[-1]) + 1)
        self._last = (int(rows.frame[-1]), int(rows.time_ns[-1]))

    def record_depth(self, side: str, frame: int, time_ns: int, depth: NDArray[np.uint16]) -> None:
        """Logs a depth image: (height, width) millimetres, without loss."""
        blob = encode_depth(depth)
        self._stream.set_time(layout.FRAME, sequence=frame)
        self._stream.set_time(layout.TIME, duration=np.timedelta64(time_ns, "ns"))
        self._stream.log(
            layout.depth(side),
            rr.EncodedDepthImage(blob, media_type=MEDIA_TYPE, meter=1000.0),
            rr.AnyValues(crc32=image_checksum(frame, blob)),
        )

    def event(self, text: str, level: str = "INFO", at: tuple[int, int] | None = None) -> None:
        """Logs what happened, at the time of the last frame.

        Args:
            text: What.
            level: How bad: INFO, WARN or ERROR.
            at: Number and time (ns since the first pair) of the frame meant, where it is not the last.
        """
        at = at or self._last
        if at is not None:
            self._stream.set_time(layout.FRAME, sequence=at[0])
            self._stream.set_time(layout.TIME, duration=np.timedelta64(at[1], "ns"))
        self._stream.log(
            layout.EVENTS, rr.TextLog(text, level=level), rr.AnyValues(crc32=text_checksum(text, level))
        )

    def finish(self) -> None:
        """Says that the session is whole; a reader takes one without this for cut off."""
        self._stream.send_property("end", rr.AnyValues(frames=self._frames))

    def _log_depth(self, frames: Sequence[RecordedFrame], rows: SessionArrays) -> None:
        for frame, number, time_ns in zip(frames, rows.frame.tolist(), rows.time_ns.tolist(), strict=True):
            if self._depth_every == 0 or number % self._depth_every:
                continue
            for side, seen in (("a", frame.pair.a), ("b", frame.pair.b)):
                if seen is not None and seen.depth is not None:
                    self.record_depth(side, number, time_ns, seen.depth)

    def _stack(self, frames: Sequence[RecordedFrame]) -> SessionArrays:
        if self._start_ns is None:
            self._start_ns = frames[0].pair.time_ns
        rows = SessionArrays.stack(
            self._calibration.body, self._calibration.bone_lengths, frames, self._frames, self._start_ns
        )
        self._frames += len(frames)
        return rows

    def _log_static(self, fuser: Fuser) -> None:
        body = self._calibration.body
        stream = self._stream

        def once(entity: str, *what: Any) -> None:
            stream.log(entity, *what, static=True)

        once(layout.ROOT, rr.ViewCoordinates.RDF, _annotations(body))
        once(layout.kinect("a"), rr.Transform3D.from_fields(translation=(0.0, 0.0, 0.0)))
        for side, intrinsics in (("a", fuser.intrinsics_a), ("b", fuser.intrinsics_b)):
            once(layout.skeleton(side), _joint_look(body, side))
            once(
                layout.depth(side),
                rr.Pinhole(
                    focal_length=(intrinsics.fx, intrinsics.fy),
                    principal_point=(intrinsics.cx, intrinsics.cy),
                    width=intrinsics.width,
                    height=intrinsics.height,
                    camera_xyz=rr.ViewCoordinates.RDF,
                    image_plane_distance=0.25,
                    color=layout.SKELETON_COLORS[side],
                ),
            )
            once(layout.weights(side), _weight_lines(body))
        once(layout.FUSED_SKELETON, _joint_look(body, "fused"))
        once(layout.TRUTH_SKELETON, _joint_look(body, "truth"))
        for joint in body.bone_joints:
            once(layout.bone(body.bones[joint]), _BONE_LINES)
        for name in layout.QUALITY_NAMES:
            once(layout.quality(name), _QUALITY_LINES[name])

    def _properties(
        self, fuser: Fuser, sources: tuple[str, str], about: Mapping[str, str | int]
    ) -> dict[str, dict[str, Any]]:
        """What a replay needs, and what a person asks of a file."""

        def camera(intrinsics: Any) -> list[float]:
            i = intrinsics
            return [i.width, i.height, i.fx, i.fy, i.cx, i.cy, *i.distortion]

        return {
            "session": {
                "layout_version": layout.VERSION,
                "written_by": f"duplex-kinects {version('duplex-kinects')}",
                "body": self._calibration.body.name,
                "bone_names": [name or "root" for name in self._calibration.body.bones],
                "source_a": sources[0],
                "source_b": sources[1],
                **about,
            },
            "settings": asdict(fuser.settings),
            "intrinsics": {"a": camera(fuser.intrinsics_a), "b": camera(fuser.intrinsics_b)},
        }


@dataclass(frozen=True)
class _Stream:
    """One entity's values over T frames: ``values[field]`` is (T, …), with `per_frame` instances a frame."""

    entity: str
    archetype: Any
    values: dict[str, NDArray[Any]]
    per_frame: int | None = None

    def of_frame(self, t: int) -> dict[str, Any]:
        return {name: values[t] for name, values in self.values.items()}

    def columns(self) -> rr.ComponentColumnList:
        if self.per_frame is None:
            columns: rr.ComponentColumnList = self.archetype.columns(**self.values)
            return columns
        flat = {
            name: values.reshape(-1, *values.shape[2:]) if values.ndim > 1 else values
            for name, values in self.values.items()
        }
        frames = len(next(iter(self.values.values())))
        columns = self.archetype.columns(**flat)
        return columns.partition([self.per_frame] * frames)


def _streams(rows: SessionArrays, fused_crc: NDArray[np.uint32] | None = None) -> Iterator[_Stream]:
    """Everything that is logged a frame."""
    joints = len(rows.body)
    for side, positions, states, weights, clock in (
        ("a", rows.positions_a, rows.states_a, rows.weights_a, rows.clock_a),
        ("b", rows.positions_b, rows.states_b, rows.weights_b, rows.clock_b),
    ):
        yield _Stream(layout.skeleton(side), rr.Points3D, {"positions": positions}, joints)
        yield _Stream(layout.states(side), rr.AnyValues, {"state": states}, joints)
        yield _Stream(layout.weights(side), rr.Scalars, {"scalars": weights.astype(np.float64)}, joints)
        yield _Stream(layout.clock(side), rr.AnyValues, {"captured_ns": clock[:, None]}, 1)
    yield _Stream(
        layout.kinect("b"), rr.Transform3D, {"mat3x3": rows.rotation, "translation": rows.translation}
    )
    # R row by row, then t
    placement = np.concatenate([rows.rotation.reshape(-1, 9), rows.translation], axis=1)
    yield _Stream(layout.PLACEMENT, rr.AnyValues, {"rotation_translation": placement}, 12)
    if fused_crc is None:
        fused_crc = fused_checksums(rows.fused)
    checks = np.stack([frame_checksums(rows), fused_crc], axis=1)
    yield _Stream(layout.CHECKS, rr.AnyValues, {"frame_crc32": checks}, 2)
    yield _Stream(layout.FUSED_SKELETON, rr.Points3D, {"positions": rows.fused.astype(np.float32)}, joints)
    yield _Stream(
        layout.FUSED_TRUST, rr.AnyValues, {"misleading": rows.misleading, "predicted": rows.predicted}, joints
    )
    if rows.truth is not None:
        yield _Stream(
            layout.TRUTH_SKELETON, rr.Points3D, {"positions": rows.truth.astype(np.float32)}, joints
        )
    lengths = rows.bone_length_of_each  # (3, T, J)
    for joint in rows.body.bone_joints:
        target = np.full(len(rows), rows.bone_lengths[joint])
        yield _Stream(
            layout.bone(rows.body.bones[joint]),
            rr.Scalars,
            {"scalars": np.round(np.stack([*lengths[:, :, joint], target], axis=1) / _FINEST) * _FINEST},
            4,
        )
    for name, values in _quality(rows).items():
        yield _Stream(
            layout.quality(name), rr.Scalars, {"scalars": values.astype(np.float64)}, values.shape[1]
        )


def _quality(rows: SessionArrays) -> dict[str, NDArray[Any]]:
    """(T, n) figures by name; the keys are layout.QUALITY_NAMES."""
    return {
        "fuse_ms": rows.fuse_ms[:, None],
        "skew_ms": rows.skew_ns[:, None] * 1e-6,
        "bone_error_mm": rows.bone_error[:, None] * 1e3,
        "disagreement_mm": rows.disagreement[:, None] * 1e3,
        "iterations": rows.iterations[:, None],
        "predicted_joints": rows.predicted.sum(axis=1)[:, None],
        "stale": np.stack([rows.stale_a, rows.stale_b], axis=1),
    }


def _annotations(body: Body) -> rr.AnnotationContext:
    joints = [rr.AnnotationInfo(id=j, label=name) for j, name in enumerate(body.joints)]
    bones = [(int(body.parents[joint]), int(joint)) for joint in body.bone_joints]
    return rr.AnnotationContext(
        [
            rr.ClassDescription(
                info=rr.AnnotationInfo(
                    id=layout.CLASS_IDS[key],
                    label=layout.SKELETON_NAMES[key],
                    color=layout.SKELETON_COLORS[key],
                ),
                keypoint_annotations=joints,
                keypoint_connections=bones,
            )
            for key in layout.CLASS_IDS
        ]
    )


def _joint_look(body: Body, key: str) -> rr.Points3D:
    return rr.Points3D.from_fields(
        class_ids=layout.CLASS_IDS[key],
        keypoint_ids=range(len(body)),
        colors=layout.SKELETON_COLORS[key],
        radii=layout.JOINT_RADII[key],
        show_labels=False,
    )


def _weight_lines(body: Body) -> rr.SeriesLines:
    """Hues around the wheel; a joint and its mirror image share one, the right side is paler."""
    prominent = [body.joint(name) for name in layout.PROMINENT_JOINTS]
    hue = {joint: k // 2 / (len(prominent) // 2) for k, joint in enumerate(prominent)}
    colors = []
    for joint, mirror in enumerate(body.mirror):
        first = min(joint, int(mirror))
        rgb = colorsys.hsv_to_rgb(
            0.1 + hue.get(joint, first / len(body)), 0.85 if joint == first else 0.45, 0.9
        )
        colors.append((int(255 * rgb[0]), int(255 * rgb[1]), int(255 * rgb[2])))
    return rr.SeriesLines(
        names=body.joints, colors=colors, visible_series=[j in hue for j in range(len(body))]
    )


_FINEST = 2.0**-14
"""Metres to which plotted bone lengths are rounded, 0.06 mm: round numbers compress. S* is not rounded."""

_BONE_LINES = rr.SeriesLines(
    names=[*(layout.SKELETON_NAMES[key] for key in ("a", "b", "fused")), "target"],
    colors=[*(layout.SKELETON_COLORS[key] for key in ("a", "b", "fused")), layout.TARGET_COLOR],
    widths=[1.0, 1.0, 2.5, 1.0],
)

_QUALITY_LINES = {
    "stale": rr.SeriesLines(
        names=["stale A", "stale B"], colors=[layout.SKELETON_COLORS["a"], layout.SKELETON_COLORS["b"]]
    ),
    **{
        name: rr.SeriesLines(names=name.replace("_mm", " (mm)").replace("_ms", " (ms)").replace("_", " "))
        for name in layout.QUALITY_NAMES
        if name != "stale"
    },
}
