"""Comparisons as Rerun recordings: the skeletons in one scene, and their distances as plots."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from fusion.support.types import Array
from recordings.appearance.colors import JOINT_RADII, SKELETON_COLORS, Color
from recordings.appearance.entity_styles import annotation_context, skeleton_class
from recordings.comparing.session_comparison import Comparison, largest
from recordings.comparing.truth_comparison import SKELETONS, TruthComparison
from recordings.data import layout
from recordings.writing.changes import set_time

SECOND_SKELETON = "/second/skeleton"
DIFFERENCE = "/difference/joints"
"""Distance of each joint, millimetres."""
LARGEST = "/difference/largest"
MEANS = "/difference/means"
"""Mean distance of each skeleton to the truth, millimetres."""
_SECOND_COLOR, _RADIUS = (64, 168, 96), 0.015


def record_comparison(
    stream: rr.RecordingStream, comparison: Comparison, worst: list[tuple[int, int]]
) -> None:
    """Logs both S* to one scene, the distance of each joint, and the worst moments as events."""
    body, first = comparison.body, comparison.first
    both = (
        (layout.FUSED_SKELETON, 1, "first S*", SKELETON_COLORS["fused"], comparison.first),
        (SECOND_SKELETON, 2, "second S*", _SECOND_COLOR, comparison.second),
    )
    classes = [skeleton_class(body, number, label, color) for _, number, label, color, _ in both]
    stream.log(layout.ROOT, rr.ViewCoordinates.RDF, rr.AnnotationContext(classes), static=True)
    times = _times(first.frame, first.time_ns)
    for entity, number, _, color, rows in both:
        _log_skeleton(stream, entity, times, rows.fused, number, color, _RADIUS)
    _log_pelvis(stream, first.frame, first.time_ns, first.fused[:, body.root])
    _log_lines(stream, DIFFERENCE, times, 1e3 * comparison.apart, body.joints)
    _log_lines(stream, LARGEST, times, 1e3 * largest(comparison.apart, axis=1)[:, None], ["largest (mm)"])
    for t, j in worst:
        set_time(stream, first.frame[t], first.time_ns[t])
        text = f"{body.joints[j]} differs by {comparison.apart[t, j] * 1e3:.0f} mm"
        stream.log(layout.EVENTS, rr.TextLog(text, level="WARN"))


def record_truth_comparison(stream: rr.RecordingStream, comparison: TruthComparison) -> None:
    """Logs S_A, S_B, S* and the truth to one scene, and their distances to the truth."""
    body = comparison.body
    stream.log(layout.ROOT, rr.ViewCoordinates.RDF, annotation_context(body), static=True)
    times = _times(comparison.frame, comparison.time_ns)
    entities = {"a": layout.skeleton("a"), "b": layout.skeleton("b"), "fused": layout.FUSED_SKELETON}
    joints = comparison.found | {"truth": comparison.truth["fused"]}
    for key, entity in (entities | {"truth": layout.TRUTH_SKELETON}).items():
        color, radius = SKELETON_COLORS[key], JOINT_RADII[key]
        _log_skeleton(stream, entity, times, joints[key], layout.CLASS_IDS[key], color, radius)
    _log_pelvis(stream, comparison.frame, comparison.time_ns, joints["fused"][:, body.root])
    means = np.stack([comparison.mean_distance(key) for key in SKELETONS], axis=1)
    colors = [SKELETON_COLORS[key] for key in SKELETONS]
    _log_lines(stream, MEANS, times, 1e3 * means, [layout.SKELETON_NAMES[key] for key in SKELETONS], colors)
    known = comparison.joints
    names = [body.joints[j] for j in known]
    _log_lines(stream, DIFFERENCE, times, 1e3 * comparison.distance["fused"][:, known], names)


def _times(frame: NDArray[np.int64], time_ns: NDArray[np.int64]) -> list[rr.TimeColumn]:
    return [
        rr.TimeColumn(layout.FRAME, sequence=frame),
        rr.TimeColumn(layout.TIME, duration=time_ns.astype("timedelta64[ns]")),
    ]


def _log_skeleton(
    stream: rr.RecordingStream,
    entity: str,
    times: list[rr.TimeColumn],
    joints: NDArray[np.floating],
    number: int,
    color: Color,
    radius: float,
) -> None:
    """Logs (T, J, 3) joints with the class of this number."""
    T, J = joints.shape[:2]
    look = rr.Points3D.from_fields(
        class_ids=number, keypoint_ids=range(J), colors=color, radii=radius, show_labels=False
    )
    stream.log(entity, look, static=True)
    points = rr.Points3D.columns(positions=joints.astype(np.float32).reshape(-1, 3))
    stream.send_columns(entity, times, points.partition([J] * T))


def _log_pelvis(
    stream: rr.RecordingStream,
    frame: NDArray[np.int64],
    time_ns: NDArray[np.int64],
    pelvis: NDArray[np.floating],
) -> None:
    """Logs (T, 3) positions of the pelvis, where they are known: the eye follows them."""
    known = np.isfinite(pelvis).all(axis=1)
    moves = rr.Transform3D.columns(translation=pelvis[known].astype(np.float32))
    stream.send_columns(layout.PELVIS, _times(frame[known], time_ns[known]), moves)


def _log_lines(
    stream: rr.RecordingStream,
    entity: str,
    times: list[rr.TimeColumn],
    values: Array,
    names: Sequence[str],
    colors: list[Color] | None = None,
) -> None:
    """Logs (T, N) values as N lines of a plot."""
    T, N = values.shape
    stream.log(entity, rr.SeriesLines(names=names, colors=colors), static=True)
    stream.send_columns(entity, times, rr.Scalars.columns(scalars=values.ravel()).partition([N] * T))
