"""What differs between two sessions, for a test, in words and as a picture."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings.appearance.colors import SKELETON_COLORS
from recordings.data.session_data import runs_of
from recordings.session_series import SessionSeries

_CAPTURED = {
    "time_ns": "the time since the first pair",
    "skew_ns": "the skew between A and B",
    "clock_a": "the time of A",
    "clock_b": "the time of B",
    "states_a": "a tracking state of S_A",
    "states_b": "a tracking state of S_B",
}
"""Data shared by two fusions of one capture, by name in
:class:`recordings.data.session_arrays.SessionArrays`."""
_SKELETONS = {"S_A": "positions_a", "S_B": "positions_b", "S*": "fused"}
_MOST_JOINTS = 6  # of a skeleton in the table
_VIEWS = (("as the sensor sees it", 0, 1.0), ("from the side", 2, -1.0))
"""Of the picture: title, horizontal axis, its sign."""


def differences(
    one: SessionSeries, two: SessionSeries, position_mm: float, joints_mm: Mapping[str, float]
) -> Iterator[str]:
    """What differs by more than the tolerances, a line each; nothing if the sessions match."""
    damage = [f"{session}: {session.damage}" for session in (one, two) if session.damage is not None]
    if one.body is not two.body:
        yield f"{one} is of {one.body.name}, {two} of {two.body.name}"
    elif len(one) != len(two):
        yield f"{one} has {len(one)} frames, {two} has {len(two)}"
    yield from damage
    if damage or one.body is not two.body or len(one) != len(two):
        return
    for name, what in _CAPTURED.items():
        differ = (getattr(one.rows, name) != getattr(two.rows, name)).reshape(len(one), -1).any(axis=1)
        for t in np.flatnonzero(differ)[:1]:
            yield f"frame {t}: {what} differs; the sessions are of different captures"
    apart = {
        name: _apart_mm(getattr(one.rows, rows), getattr(two.rows, rows)) for name, rows in _SKELETONS.items()
    }
    limits, allowed = np.full(len(one.body), position_mm), f"{position_mm:g} mm"
    for joint, limit in joints_mm.items():
        limits[one.body.joint(joint)], allowed = limit, "a joint's tolerance"
    beyond = {name: mm > limits for name, mm in apart.items()}
    for name, differ in beyond.items():
        frames = np.flatnonzero(differ.any(axis=1))
        for t in frames[:1]:
            yield (
                f"{name} differs by more than {allowed} in {len(frames)} of {len(one)} frames "
                f"({runs_of(frames)}), first at {one.body.joints[int(differ[t].argmax())]}"
                + ("" if name == "S*" else "; the sessions are of different captures")
            )
    if any(differ.any() for differ in beyond.values()):
        yield from ("", _HEAD)
        for name, mm in apart.items():
            yield from _rows(name, one.body.joints, mm, beyond[name])
    elif not limits.any():
        for t in np.flatnonzero(one.fused_checksums != two.fused_checksums)[:1]:
            yield f"frame {t}: S* differs, by less than float32 shows"


def _apart_mm(one: NDArray[Any], two: NDArray[Any]) -> NDArray[np.float64]:
    """(T, J) millimetres between (T, J, 3) positions as files store them, in float32.

    0 where both are missing, infinite where one is.
    """
    stored = (each.astype(np.float32).astype(np.float64) for each in (one, two))
    mm = np.linalg.norm(np.subtract(*stored), axis=2) * 1e3
    missing = [np.isnan(each).any(axis=2) for each in (one, two)]
    return np.where(missing[0] & missing[1], 0.0, np.where(missing[0] | missing[1], np.inf, mm))


_TABLE = "{:8}  {:16} {:>6} {:>7} {:>10} {:>9} {:>11}"
_HEAD = _TABLE.format("skeleton", "joint", "frames", "missing", "largest mm", "median mm", "first frame")


def _rows(name: str, joints: tuple[str, ...], mm: NDArray[Any], beyond: NDArray[Any]) -> Iterator[str]:
    """The rows of a skeleton: all of its joints together, then those that are farthest apart.

    A joint is missing where only one session has it; the median is that of the differences.
    """
    of_joints = sorted(np.flatnonzero(beyond.any(axis=0)).tolist(), key=lambda j: -mm[:, j].max())
    if not of_joints:
        return
    shown = of_joints[:_MOST_JOINTS]
    for label, part in [("all joints", slice(None)), *((joints[j], slice(j, j + 1)) for j in shown)]:
        frames = np.flatnonzero(beyond[:, part].any(axis=1))
        missing = int(np.isinf(mm[:, part]).any(axis=1).sum())
        far = mm[:, part][beyond[:, part] & np.isfinite(mm[:, part])]
        figures = [f"{value:.3g}" for value in (far.max(), np.median(far))] if len(far) else ["–", "–"]
        yield _TABLE.format(name, label, len(frames), missing or "", *figures, frames[0])
    if len(of_joints) > len(shown):
        yield f"{name:8}  and {len(of_joints) - len(shown)} more joints"


def write_worst_moment(one: SessionSeries, two: SessionSeries, path: Path) -> bool:
    """Writes a picture of the frame in which a joint differs most, and returns whether there is one.

    The sessions have the same body; frames of the same number are compared.
    """
    from matplotlib.figure import Figure  # needs no display, but a second

    count = min(len(one), len(two))
    if one.body is not two.body or not count:
        return False
    rows = one.rows[:count], two.rows[:count]
    apart = {name: _apart_mm(*(getattr(of, at) for of in rows)) for name, at in _SKELETONS.items()}
    # S* where it differs at all: it is what differs for another version, and the views for another capture
    name = next((each for each in ("S*", "S_A", "S_B") if apart[each].max() > 0.0), "S*")
    t, joint = (int(k) for k in np.unravel_index(apart[name].argmax(), apart[name].shape))
    each = [getattr(of, _SKELETONS[name])[t].astype(np.float64) for of in rows]
    figure = Figure(figsize=(9.0, 5.5), layout="constrained")
    mm = apart[name][t, joint]
    how = f"differs by {mm:.3g} mm" if np.isfinite(mm) else "is in one session only"
    where = f"frame {t}, {one.time[t]:.2f} s: {one.body.joints[joint]} of {name} {how}"
    figure.suptitle(where)
    bones = [[child, parent] for child, parent in enumerate(one.body.parents) if parent >= 0]
    colors = [tuple(value / 255.0 for value in SKELETON_COLORS[key]) for key in ("fused", "truth")]
    for axes, (title, axis, sign) in zip(figure.subplots(1, 2, sharey=True), _VIEWS, strict=True):
        for label, at, color in zip(("actual", "expected"), each, colors, strict=True):
            x, y = at[:, axis] * sign, -at[:, 1]
            for bone in bones:
                axes.plot(x[bone], y[bone], "-o", color=color, markersize=3)
            axes.plot(x[joint], y[joint], "o", color=color, markersize=9, label=label)
        axes.set(title=title, aspect="equal", xlabel="m")
        axes.legend()
    figure.savefig(path, dpi=110)
    return True
