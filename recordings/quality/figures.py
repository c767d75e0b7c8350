"""The figures of a fusion, as ``report.json`` has them."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from devices.findings.rules import farthest, nearest
from fusion.calibration.calibration import Calibration
from fusion.facing.evidence import upright_direction
from fusion.facing.handedness import mirrored_share
from fusion.facing.model import WHOLE
from fusion.setup import FusionSetup
from fusion.skeleton import NO_FRAME, Skeleton, SkeletonPair
from fusion.support.large_arrays import parts
from recordings.calibration_file import is_loaded
from recordings.data.session_arrays import SessionArrays, rate_without_pauses
from recordings.data.session_data import SessionData, ViewsAgree
from recordings.quality.doubtful_time import doubtful_seconds, expected_error, seen_people
from recordings.quality.verdict import Figures as Figures
from recordings.quality.verdict import verdict

if TYPE_CHECKING:
    from fusion.calibration.comparison import PlacementOff

_SAMPLES = 100_000  # frames, from which a median distance is found
_COMPARED = 1_000  # frames, from which B's own placement is found
_STANDING = 10_000  # frames, from which the vertical is found


def report(session: SessionData) -> Figures:
    """The figures of a fused pair of recordings, as ``--report`` writes them; None if one is unknown."""
    counts = session.frame_counts
    alone = {side: counts[f"alone_{side}"] for side in "ab"}
    return with_verdict(
        {
            "frames": {side: counts[f"frames_{side}"] for side in "ab"},
            "paired": len(session) - sum(alone.values()),
            "alone": alone,
            "dropped": dict(zip("ab", session.dropped, strict=True)),
            "clock": session.clock,
            "others_seen": session.about["session"].get("others_seen", [0.0])[0],
            "people": [asdict(person) for person in session.seen_people],
            **fusion_figures(session.last_setup, session.rows, session.first_compared_frame),
        }
    )


def with_verdict(figures: Figures) -> Figures:
    """The figures with the verdict on them: its word, the first reason and the remedy, empty if good."""
    found = verdict(figures)
    word, first = found.word, found.findings[0] if found.findings else None
    reason, remedy = ("", "") if first is None else (first.reason, first.step)
    return figures | {"verdict": {"word": word, "reason": reason, "remedy": remedy}}


def fusion_figures(setup: FusionSetup, rows: SessionArrays, first: int) -> Figures:
    """The figures of fused frames from any source, with the last setup that applies to them.

    Args:
        first: The first frame at which the distance of the views counts.
    """
    settings, calibration = setup.settings, setup.calibration
    up = upright_direction(rows.body, rows.fused[:: max(1, len(rows) // _STANDING)].astype(np.float64))
    empty_a, empty_b = ((states == 0).all(axis=1) for states in (rows.states_a, rows.states_b))
    gave_a, gave_b = (clock != NO_FRAME for clock in (rows.clock_a, rows.clock_b))
    seen, apart = seen_people(rows), rows.disagreement[first:]
    agree = ViewsAgree.of(apart)
    there = seen.any(axis=0) & (np.arange(len(rows)) >= first)
    return {
        "body": rows.body.name,
        "stale": {"a": int(rows.stale_a.sum()), "b": int(rows.stale_b.sum())},
        "without_person": {
            "a": int((empty_a & gave_a).sum()),
            "b": int((empty_b & gave_b).sum()),
            "both": int((empty_a & gave_a & empty_b & gave_b).sum()),
        },
        "settings": {name: getattr(settings, name) for name in ("method", "h", "weights", "smoothing")},
        "calibration": {
            **calibration_figures(calibration),
            "angle_deg": math.degrees(calibration.angle_about(up)),
        },
        "distance_m": _distances(setup, rows),
        **method_figures(rows, calibration),
        "views_agree_mm": {
            "median": known_or_none(agree.median * 1e3),
            "p95": known_or_none(agree.percentile_95 * 1e3),
        },
        "placement": _placement(rows, calibration) if is_loaded(calibration) else None,
        "expected_error_mm": of_finite(np.median, expected_error(rows)[there]),
        "seconds_of": doubtful_seconds(rows, first, seen),
        "upside_down": {side: _upside_down(rows, side) for side in "ab"},
        "in_no_frame": np.array(rows.body.joints)[rows.never_seen].tolist(),
    }


def _placement(rows: SessionArrays, calibration: Calibration) -> Figures | None:
    """How far B's own placement is from the calibration's, by pairs from all over the session."""
    from fusion.calibration.comparison import RecentPlacement  # only loaded ones need it

    recent = RecentPlacement(rows.body, 1e9)
    for frame in range(0, len(rows), max(1, len(rows) // _COMPARED)):
        time_ns = int(rows.time_ns[frame])
        a, b = (
            Skeleton.of(rows.body, positions[frame], states[frame], time_ns)
            for positions, states in ((rows.positions_a, rows.states_a), (rows.positions_b, rows.states_b))
        )
        code_a, code_b = rows.filled("exchanged")[frame] & WHOLE
        if rows.states_a[frame].any() and rows.states_b[frame].any():
            recent.add(SkeletonPair(a, b, time_ns), (int(code_a), int(code_b)))
    return placement_figures(recent.off(calibration))


def placement_figures(off: PlacementOff | None) -> Figures | None:
    """How far B's own placement is from a calibration's, in degrees and millimetres."""
    if off is None:
        return None
    turn, sd = math.degrees(off.turn), math.degrees(off.turn_sd)
    return {"turn_deg": turn, "shift_mm": 1e3 * off.shift, "turn_sd_deg": sd}


def _upside_down(rows: SessionArrays, side: str) -> float | None:
    """The share of frames in which the head is below both ankles, in the sensor's own axes."""
    positions = rows.positions_a if side == "a" else rows.positions_b
    y = positions[:: max(1, len(rows) // _SAMPLES), :, 1]
    head, *ankles = (y[:, rows.body.joint(name)] for name in ("head", "ankle left", "ankle right"))
    above = head - np.maximum(*ankles)
    return of_finite(lambda known: np.mean(known > 0.0), above)


def calibration_figures(calibration: Calibration) -> Figures:
    """What a calibration was measured on, and how well the two views agree under it."""
    fit = calibration.registration
    figures: Figures = {
        "how": calibration.how,
        "loaded": is_loaded(calibration),
        "provisional": calibration.provisional,
        "residual_mm": None,
        "axes_angle_deg": math.degrees(calibration.axes_angle),
        **dict.fromkeys(("rotation_sd_deg", "translation_sd_mm", "sd_at_3m_mm", "frames")),
        "worst_joints_mm": {},
    }
    if fit is not None:
        figures |= {
            "residual_mm": {"median": fit.residual_median * 1e3, "rms": fit.residual_rms * 1e3},
            "rotation_sd_deg": math.degrees(fit.rotation_sd),
            "translation_sd_mm": known_or_none(fit.translation_sd * 1e3),
            "sd_at_3m_mm": known_or_none(fit.sd_at(3.0) * 1e3),
            "frames": fit.frames,
            "worst_joints_mm": {name: distance * 1e3 for name, distance in fit.worst_joints()},
        }
    return figures


def method_figures(rows: SessionArrays, calibration: Calibration) -> Figures:
    """Bones, errors, repaired data, and time."""
    mean, std, worst, rms = _bones(rows)
    shown = np.asarray(np.isfinite(mean[:2]).any(axis=0))
    mirrored = np.where(shown[rows.body.mirror], "other side", "proportions")
    unseen = np.full(shown.shape, "file") if is_loaded(calibration) else mirrored
    length_from = np.where(shown, "views", unseen).tolist()
    bones = {}
    for joint in rows.body.bone_joints:
        target = float(rows.bone_lengths[-1, joint])
        of_bone: Figures = {"target_m": target, "length_from": length_from[joint]}
        for k, key in enumerate(("a", "b", "fused")):
            of_bone[key] = {
                "mean_m": known_or_none(mean[k, joint]),
                "std_mm": known_or_none(1e3 * std[k, joint]),
            }
        of_bone["fused"]["max_error_mm"] = known_or_none(1e3 * worst[2, joint])
        bones[rows.body.bones[joint]] = of_bone
    return {
        "fused_frames": len(rows),
        "seconds": float(rows.time_ns[-1] - rows.time_ns[0]) * 1e-9,
        "frames_per_second": rate_without_pauses(rows.time_ns),
        "repaired": _repaired(rows),
        "mirrored": {
            "a": mirrored_share(rows.body, rows.positions_a),
            "b": mirrored_share(rows.body, rows.positions_b),
        },
        "bones": bones,
        "bone_error_mm": {
            key: {"rms": known_or_none(1e3 * rms[k]), "max": known_or_none(1e3 * np.fmax.reduce(worst[k]))}
            for k, key in enumerate(("a", "b", "fused"))
        },
        "fuse_ms": {
            name: of_finite(lambda ms, percent=percent: np.percentile(ms, percent), rows.fuse_ms)
            for name, percent in (("p50", 50), ("p99", 99), ("max", 100))
        },
    }


def _bones(rows: SessionArrays) -> tuple[NDArray[np.float64], ...]:
    """Figures of the bones of S_A, S_B and S*, metres; NaN where a bone is never seen.

    Returns:
        (3, J) means and standard deviations of the lengths, (3, J) largest errors, (3,) RMS of all errors.
    """
    count, total, square, of_errors, worst = (np.zeros((3, len(rows.body))) for _ in range(5))
    for part in rows.parts():
        length = part.bone_length_of_each
        known = np.isfinite(length)
        count += known.sum(axis=1)
        total += np.where(known, length, 0.0).sum(axis=1)
        error = np.where(known, length - part.bone_lengths, 0.0)
        of_errors += (error**2).sum(axis=1)
        worst = np.maximum(worst, np.abs(error).max(axis=1))
    with np.errstate(invalid="ignore"):
        mean = total / count
        for part in rows.parts():
            off = part.bone_length_of_each - mean[:, None]
            square += np.where(np.isfinite(off), off**2, 0.0).sum(axis=1)
        rms = np.sqrt(of_errors.sum(axis=1) / count.sum(axis=1))
        return mean, np.sqrt(square / count), np.where(count > 0.0, worst, np.nan), rms


def known_or_none(figure: float) -> float | None:
    return float(figure) if math.isfinite(figure) else None


def _distances(setup: FusionSetup, rows: SessionArrays) -> Figures:
    """Median distance of the trunk from each sensor along its axis, and the sensor's range, metres."""
    torso = list(rows.body.torso)
    cameras = setup.intrinsics_a, setup.intrinsics_b
    every = max(1, len(rows) // _SAMPLES)
    depths = (
        np.concatenate([positions[part][::every, torso, 2] for part in parts(len(rows))])
        for positions in (rows.positions_a, rows.positions_b)
    )
    return {
        side: {
            "median": of_finite(np.median, z),
            "near": nearest(camera),
            "far": farthest(rows.body.name, camera),
        }
        for side, z, camera in zip("ab", depths, cameras, strict=True)
    }


def _repaired(rows: SessionArrays) -> Figures:
    """Shares of frames in which S* corrects the sides of each view, and of joints that neither view has.

    Frames without any person do not count. ``exchanged`` is None for methods that do not look for it.
    """
    seen = ~rows.predicted.all(axis=1)
    exchanged = None
    if rows.exchanged is not None:
        exchanged = {
            key: of_finite(np.mean, of[seen]) for key, of in zip("ab", rows.corrected.T, strict=True)
        }
    return {
        "exchanged": exchanged,
        "unseen_joints": float(rows.predicted[seen].mean()) if seen.any() else None,
    }


def of_finite(figure: Any, values: NDArray[Any]) -> float | None:
    """A figure of the finite values; None if there are none."""
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    return float(figure(finite)) if finite.size else None
