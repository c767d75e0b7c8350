"""Every log call. What never changes is logged once; frames go out one by one (live) or by columns (offline).

Both ways give the same layout, because both come from the same list of what a frame is: :func:`_streams`.
"""

from __future__ import annotations

import colorsys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from fusion.body import Body
from fusion.fuser import Fuser
from recordings import layout
from recordings.arrays import RecordedFrame, SessionArrays


class Recorder:
    """Writes one session to a Rerun recording stream, which the caller owns and closes.

    Args:
        stream: Where to log to; its sinks decide whether that is a viewer, a file or both.
        fuser: Whose settings, calibration and intrinsics the session keeps.
        sources: What the sensors are called, K_A first.
    """

    def __init__(self, stream: rr.RecordingStream, fuser: Fuser, sources: tuple[str, str]) -> None:
        self._stream = stream
        self._calibration = fuser.calibration
        self._frames = 0
        self._start_ns: int | None = None
        self._last_ns = 0
        self._sources = sources
        self._log_static(fuser)
        self.calibrate(fuser)

    def calibrate(self, fuser: Fuser) -> None:
        """Keeps the calibration and settings with which the frames that follow are fused."""
        calibration = self._calibration = fuser.calibration
        self._stream.set_time(layout.FRAME, sequence=self._frames)
        self._stream.set_time(layout.TIME, duration=np.timedelta64(self._last_ns, "ns"))
        self._stream.log(
            layout.CALIBRATION,
            rr.AnyValues(
                how=calibration.how,
                rotation=calibration.a_from_b.rotation.ravel(),
                translation=calibration.a_from_b.translation,
                bone_lengths=calibration.bone_lengths,
            ),
        )
        for name, values in self._properties(fuser).items():
            self._stream.send_property(name, rr.AnyValues(**values))

    def record(self, frame: RecordedFrame) -> None:
        """Logs one frame at once, for live use."""
        rows = self._stack([frame])
        self._stream.set_time(layout.FRAME, sequence=int(rows.frame[0]))
        self._stream.set_time(layout.TIME, duration=np.timedelta64(int(rows.time_ns[0]), "ns"))
        for stream in _streams(rows):
            self._stream.log(stream.entity, stream.archetype(**stream.of_frame(0)))

    def record_all(self, frames: Sequence[RecordedFrame]) -> SessionArrays:
        """Logs many frames by columns, for offline use; may be called again with the frames that follow.

        Returns:
            What was logged.
        """
        rows = self._stack(frames)
        times = [
            rr.TimeColumn(layout.FRAME, sequence=rows.frame),
            rr.TimeColumn(layout.TIME, duration=rows.time_ns.astype("timedelta64[ns]")),
        ]
        for stream in _streams(rows):
            self._stream.send_columns(stream.entity, times, stream.columns())
        return rows

    def event(self, text: str, level: str = "INFO") -> None:
        """Logs what happened, at the time of the last frame."""
        self._stream.log(layout.EVENTS, rr.TextLog(text, level=level))

    def _stack(self, frames: Sequence[RecordedFrame]) -> SessionArrays:
        if self._start_ns is None:
            self._start_ns = frames[0].pair.time_ns
        rows = SessionArrays.stack(
            self._calibration.body, self._calibration.bone_lengths, frames, self._frames, self._start_ns
        )
        self._frames += len(frames)
        self._last_ns = int(rows.time_ns[-1])
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

    def _properties(self, fuser: Fuser) -> dict[str, dict[str, Any]]:
        """What a replay needs, and what a person asks of a file."""
        calibration = self._calibration
        registration = calibration.registration

        def camera(intrinsics: Any) -> list[float]:
            i = intrinsics
            return [i.width, i.height, i.fx, i.fy, i.cx, i.cy, *i.distortion]

        return {
            "session": {
                "layout_version": layout.VERSION,
                "written_by": f"duplex-kinects {version('duplex-kinects')}",
                "body": calibration.body.name,
                "source_a": self._sources[0],
                "source_b": self._sources[1],
            },
            "settings": {
                "h": fuser.settings.h,
                "solver": fuser.settings.solver,
                "weights": fuser.settings.weights,
            },
            "calibration": {
                "how": calibration.how,
                "rotation": calibration.a_from_b.rotation.ravel(),
                "translation": calibration.a_from_b.translation,
                "bone_names": [name or "root" for name in calibration.body.bones],
                "bone_lengths": calibration.bone_lengths,
                "residual_median": np.nan if registration is None else registration.residual_median,
                "residual_rms": np.nan if registration is None else registration.residual_rms,
            },
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


def _streams(rows: SessionArrays) -> Iterator[_Stream]:
    """Everything that is logged a frame."""
    joints = len(rows.body)
    for side, positions, states, weights in (
        ("a", rows.positions_a, rows.states_a, rows.weights_a),
        ("b", rows.positions_b, rows.states_b, rows.weights_b),
    ):
        yield _Stream(layout.skeleton(side), rr.Points3D, {"positions": positions}, joints)
        yield _Stream(layout.states(side), rr.AnyValues, {"state": states}, joints)
        yield _Stream(layout.weights(side), rr.Scalars, {"scalars": weights.astype(np.float64)}, joints)
    yield _Stream(
        layout.kinect("b"), rr.Transform3D, {"mat3x3": rows.rotation, "translation": rows.translation}
    )
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
            {"scalars": np.stack([*lengths[:, :, joint], target], axis=1)},
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
