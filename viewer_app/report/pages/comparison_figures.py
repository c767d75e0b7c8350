"""How two fusions of one capture differ, in words and tables that the terminal and the page share."""

from collections.abc import Iterator, Sequence

import numpy as np

from recordings.comparing.session_comparison import Comparison
from recordings.session import Session
from viewer_app.report.words import Line, in_mm

JOINTS_TITLE = "Joints, mm: distance of the two S*, and noise of each"
JOINTS_HEAD = ("joint", "median", "95 %", "max", "noise 1", "noise 2", "swapped")
BONES_TITLE = "Bones, mm: length, and largest deviation from it"
BONES_HEAD = ("bone", "length 1", "length 2", "deviation 1", "deviation 2")


def other_settings(sessions: Sequence[Session]) -> Iterator[str]:
    """The settings in which two sessions differ."""
    for name, values in sessions[0].about["settings"].items():
        other = sessions[1].about["settings"].get(name)
        if other != values:
            yield f"{name}: {values[0]} against {other[0] if other else '–'}"


def moments(comparison: Comparison, worst: Sequence[tuple[int, int]]) -> Iterator[tuple[float, str]]:
    """Seconds, and in words what differs then."""
    for t, j in worst:
        joint, apart = comparison.body.joints[j], comparison.apart[t, j] * 1e3
        words = f"frame {comparison.first.frame[t]}: {joint} differs by {apart:.3g} mm"
        yield float(comparison.first.time_ns[t] * 1e-9), words


def lead(comparison: Comparison) -> Iterator[Line]:
    """How far the two S* are apart, in which joint most, and how calm each is."""
    apart, noise = comparison.apart * 1e3, comparison.frame_noise * 1e3
    distances = apart[np.isfinite(apart)]
    if not len(distances):
        return
    median, high, most = (in_mm(float(np.percentile(distances, p))) for p in (50, 95, 100))
    yield Line("Distance", f"of the two S*: {median} (median), 95 % {high}, at most {most}.")
    of_joints = np.array([np.median(d[np.isfinite(d)]) if np.isfinite(d).any() else -1.0 for d in apart.T])
    farthest = int(np.argmax(of_joints))
    yield Line(
        "Most", f"{comparison.body.joints[farthest]}, {in_mm(float(of_joints[farthest]))} apart (median)."
    )
    known = [each[np.isfinite(each)] for each in noise]
    if all(len(each) for each in known):
        first, second = (in_mm(float(np.median(each))) for each in known)
        yield Line("Noise", f"of one frame, median joint: first {first}, second {second}.")


def distance_rows(comparison: Comparison) -> Iterator[list[str]]:
    """Of each joint: the distance of both S* and the noise of each, mm; frames in which sides are swapped."""
    apart, noise = comparison.apart * 1e3, comparison.frame_noise * 1e3
    for j, name in enumerate(comparison.body.joints):
        distances = apart[:, j][np.isfinite(apart[:, j])]
        figures = [_mm(np.percentile(distances, p)) if len(distances) else "–" for p in (50, 95, 100)]
        swapped = int(comparison.swapped[:, j].sum())
        yield [name, *figures, _mm(noise[0, j]), _mm(noise[1, j]), str(swapped) if swapped else ""]


def bone_rows(comparison: Comparison) -> Iterator[list[str]]:
    """Of each bone, millimetres: the length in both sessions, and the largest deviation of each from it."""
    target, deviation = comparison.target * 1e3, comparison.bone_deviation * 1e3
    for j in comparison.body.bone_joints:
        name = comparison.body.bones[j].replace("_", " ")
        yield [name, *map(_mm, (*target[:, j], *deviation[:, j]))]


def _mm(value: float | np.float64) -> str:
    return in_mm(float(value), "")
