"""The frames of a session's file: the first ones that are there, whole, and match their checksums."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.calibration.calibration import Calibration
from recordings import layout
from recordings.reading.rrd_file import Columns
from recordings.session_arrays import SessionArrays
from recordings.writing.checksums import FusedChecks, frame_checksums


def frames_of(
    body: Body, calibrations: list[tuple[int, Calibration]], found: Columns
) -> tuple[SessionArrays, FusedChecks, int]:
    """The frames before the first that is missing or damaged, checks of their S*, how many are lost."""
    J = len(body)
    stored: dict[str, tuple[tuple[str, str], tuple[int, ...], Any]] = {
        "time_ns": ((layout.QUALITY, layout.TIME), (), np.int64),
        "placement": ((layout.kinect("b"), "rotation_translation"), (12,), np.float64),
        "fused": ((layout.FUSED_SKELETON, "Points3D:positions"), (J, 3), np.float32),
        "predicted": ((layout.FUSED_SKELETON, "predicted"), (J,), np.bool_),
        "joint_digests": ((layout.QUALITY, layout.JOINT_DIGESTS), (J,), np.uint8),
        "misleading": ((layout.FUSED_SKELETON, "misleading_joint"), (J,), np.int8),
    }
    figures: dict[str, Any] = {
        "fuse_ms": np.float32,
        "skew_ms": np.float64,
        "iterations": np.uint16,
        "frame_crc32": np.uint32,
        "fused_crc32": np.uint32,
    }
    of_each: dict[str, Any] = {"captured_ns": np.int64, "stale": np.bool_}
    for component, n, kinds in ((layout.FIGURES, 1, figures), (layout.OF_EACH_SENSOR, 2, of_each)):
        stored |= {
            name: ((layout.QUALITY, f"{component}.{name}"), (n,), kind) for name, kind in kinds.items()
        }
    for side in layout.SIDES:
        stored |= {
            f"positions_{side}": ((layout.skeleton(side), "Points3D:positions"), (J, 3), np.float32),
            f"states_{side}": ((layout.FUSED_SKELETON, layout.state(side)), (J,), np.int8),
            f"weights_{side}": ((layout.FUSED_SKELETON, layout.weight(side)), (J,), np.float16),
        }
    truth = (layout.TRUTH_SKELETON, "Points3D:positions")
    if truth in found.values:
        stored["truth"] = (truth, (J, 3), np.float32)
    written = 0
    whole: int | None = None
    at: dict[str, NDArray[Any]] = {}
    for name, (key, shape, kind) in stored.items():
        frames, values = found.values.get(key, (np.empty(0, np.int64), np.empty((0, *shape), kind)))
        if values.shape[1:] != shape or values.dtype != kind:
            frames, values = frames[:0], np.empty((0, *shape), kind)
        order = np.argsort(frames, kind="stable")
        frames = frames[order]
        count = int(np.argmin(np.concatenate([frames, [-1]]) == np.arange(len(frames) + 1)))
        written = max(written, count)
        whole = count if whole is None else min(whole, count)
        at[name] = values[order]
    n = whole or 0
    at = {name: values[:n] for name, values in at.items()}
    with np.errstate(invalid="ignore"):  # damaged numbers are found below
        rows = SessionArrays(
            body=body,
            bone_lengths=_targets(calibrations, n),
            frame=np.arange(n),
            time_ns=at["time_ns"],
            skew_ns=np.rint(at["skew_ms"][:, 0] * 1e6).astype(np.int64),
            clock_a=at["captured_ns"][:, 0],
            clock_b=at["captured_ns"][:, 1],
            positions_a=at["positions_a"],
            positions_b=at["positions_b"],
            states_a=at["states_a"].astype(np.uint8),
            states_b=at["states_b"].astype(np.uint8),
            weights_a=at["weights_a"].astype(np.float32),
            weights_b=at["weights_b"].astype(np.float32),
            misleading=np.where(at["misleading"] == J, -1, at["misleading"]).astype(np.int32),
            rotation=at["placement"][:, :9].reshape(-1, 3, 3),
            translation=at["placement"][:, 9:],
            fused=at["fused"].astype(np.float64),
            predicted=at["predicted"],
            iterations=at["iterations"][:, 0].astype(np.int64),
            stale_a=at["stale"][:, 0],
            stale_b=at["stale"][:, 1],
            fuse_ms=at["fuse_ms"][:, 0].astype(np.float64),
            truth=at["truth"].astype(np.float64) if "truth" in at else None,
        )
    if n:
        fits = frame_checksums(rows) == at["frame_crc32"][:, 0]
        n = int(np.argmin(np.append(fits, False)))
    return rows[:n], (at["fused_crc32"][:n, 0], at["joint_digests"][:n]), written - n


def _targets(calibrations: list[tuple[int, Calibration]], frames: int) -> NDArray[np.float64]:
    """(T, J) the bone lengths each frame was fused with."""
    firsts = [first for first, _ in calibrations]
    lengths = np.array([calibration.bone_lengths for _, calibration in calibrations])
    return np.asarray(lengths[np.searchsorted(firsts, np.arange(frames), side="right") - 1])
