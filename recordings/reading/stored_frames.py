"""The frames of a session's file up to the first one that is missing, incomplete or fails its checksum."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.calibration.calibration import Calibration
from recordings import layout
from recordings.frame_fields import FrameField
from recordings.reading.rrd_file import Columns
from recordings.session_arrays import FRAME_FIELDS, SessionArrays
from recordings.writing.checksums import FRAME_CRC, FUSED_CRC, FusedChecks, frame_checksums

_TIME = layout.QUALITY, layout.TIME
_FRAME_CRC, _FUSED_CRC = (layout.QUALITY, FRAME_CRC), (layout.QUALITY, FUSED_CRC)
_JOINT_DIGESTS = layout.QUALITY, layout.JOINT_DIGESTS


def frames_of(
    body: Body, calibrations: list[tuple[int, Calibration]], found: Columns
) -> tuple[SessionArrays, FusedChecks, int]:
    """The frames before the first missing or damaged one, the checks of their S*, and the number of lost
    frames."""
    groups = _groups(found)
    stored: dict[tuple[str, str], tuple[int, type[np.generic]]] = {
        key: (sum(spec.width(body) for _, spec in specs), specs[0][1].stored) for key, specs in groups.items()
    }
    stored |= {_TIME: (1, np.int64), _FRAME_CRC: (1, np.uint32), _FUSED_CRC: (1, np.uint32)}
    stored[_JOINT_DIGESTS] = (len(body), np.uint8)
    columns: dict[tuple[str, str], NDArray[Any]] = {}
    counts = []
    for key, (width, kind) in stored.items():
        columns[key] = values = _consecutive(found, key, width, kind)
        counts.append(len(values))
    written, n = max(counts), min(counts)
    figures: dict[str, Any] = {}
    with np.errstate(invalid="ignore"):  # damaged numbers are detected below
        for key, specs in groups.items():
            column = 0
            for name, spec in specs:
                width = spec.width(body)
                figures[name] = spec.from_file(body, columns[key][:n, column : column + width])
                column += width
        rows = SessionArrays(body, _targets(calibrations, n), np.arange(n), columns[_TIME][:n, 0], **figures)
    if n:
        fits = frame_checksums(rows) == columns[_FRAME_CRC][:n, 0]
        n = int(np.argmin(np.append(fits, False)))
    return rows[:n], (columns[_FUSED_CRC][:n, 0], columns[_JOINT_DIGESTS][:n]), written - n


def _groups(found: Columns) -> dict[tuple[str, str], list[tuple[str, FrameField]]]:
    """The figures by component, in storage order; without figures that the file lacks."""
    groups: dict[tuple[str, str], list[tuple[str, FrameField]]] = {}
    for name, spec in FRAME_FIELDS.items():
        key = spec.entity, spec.component
        if not spec.optional or key in found.values:
            groups.setdefault(key, []).append((name, spec))
    return groups


def _consecutive(found: Columns, key: tuple[str, str], width: int, kind: type[np.generic]) -> NDArray[Any]:
    """(N, width) values of frames 0 to N - 1, up to the first missing frame."""
    frames, values = found.values.get(key, (np.empty(0, np.int64), np.empty((0, width), kind)))
    if values.dtype != kind or values.size != len(frames) * width:
        return np.empty((0, width), kind)
    order = np.argsort(frames, kind="stable")
    frames = frames[order]
    count = int(np.argmin(np.concatenate([frames, [-1]]) == np.arange(len(frames) + 1)))
    return values.reshape(len(frames), width)[order[:count]]


def _targets(calibrations: list[tuple[int, Calibration]], frames: int) -> NDArray[np.float64]:
    """(T, J) bone lengths used for the fusion of each frame."""
    firsts = [first for first, _ in calibrations]
    lengths = np.array([calibration.bone_lengths for _, calibration in calibrations])
    return np.asarray(lengths[np.searchsorted(firsts, np.arange(frames), side="right") - 1])
