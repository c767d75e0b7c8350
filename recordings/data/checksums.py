"""Checksums of frames and properties. Rerun's file format itself detects few flipped bits.

A frame's checksum covers every number that :class:`recordings.session.Session` reads back, in the stored
precision.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from devices.events import Event

if TYPE_CHECKING:
    from recordings.data.session_arrays import SessionArrays

_BLOCK = 4096  # frames per step, which temporarily need three times their memory
FRAME_CRC = "figures.frame_crc32"
"""Component of layout.QUALITY: :func:`frame_checksums`."""
CHECKS_CRC = "figures.checks_crc32"
"""Component of layout.QUALITY: :func:`checks_checksums`."""


def frame_checksums(rows: SessionArrays) -> NDArray[np.uint32]:
    """(T,) CRC-32 of all stored values of a frame; all NaN payloads count as equal."""
    body = rows.body
    checks = np.empty(len(rows), dtype=np.uint32)
    for first in range(0, len(rows), _BLOCK):
        block = slice(first, first + _BLOCK)
        figures = (spec.checked(body, values[block]) for _, spec, values in rows.figures() if spec.covered)
        checks[block] = _checksums(rows.frame[block], rows.time_ns[block], *figures)
    return checks


def fused_checksums(fused: NDArray[np.float64]) -> NDArray[np.uint32]:
    """(T,) CRC-32 of S* (T, J, 3) in float64; the file stores only float32."""
    return _checksums(fused)


def joint_digests(fused: NDArray[np.float64]) -> NDArray[np.uint8]:
    """(T, J) one digest byte per joint of S* (T, J, 3) in float64, to find the joints that differ.

    A digest misses one change in 256; the checksum of the frame detects it.
    """
    bits = np.where(np.isnan(fused), np.nan, fused).view(np.uint64)
    mixed = (bits * np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0xD6E8FEB86659FD93], np.uint64)).sum(
        axis=2
    )
    return np.asarray(mixed >> np.uint64(56)).astype(np.uint8)


def checks_checksums(rows: SessionArrays) -> NDArray[np.uint32]:
    """(T,) CRC-32 of the checksums of S* themselves, which are read back, too."""
    return _checksums(rows.fused_checksums, rows.joint_digests)


def properties_checksum(properties: Mapping[str, Mapping[str, Any]]) -> int:
    """CRC-32 of names and values; an array and an equal list give the same checksum."""

    def plain(value: Any) -> Any:
        values = np.atleast_1d(np.asarray(value)).ravel().tolist()
        return [f"{v:.17g}" if isinstance(v, (int, float)) else str(v) for v in values]

    text = json.dumps(
        {name: {k: plain(v) for k, v in of.items()} for name, of in properties.items()}, sort_keys=True
    )
    return crc32(text.encode())


def image_checksum(frame: int, blob: bytes) -> int:
    """CRC-32 of an encoded image and its frame number."""
    return crc32(blob, crc32(frame.to_bytes(8, "little", signed=True)))


def event_checksum(event: Event) -> int:
    """CRC-32 of an event: frame number and time (ns), text, level; topic and phase of a spell."""
    spell = () if event.phase == "moment" else (event.topic, event.phase)
    return crc32("\0".join(map(str, (event.frame, event.time_ns, event.text, event.level, *spell))).encode())


def _checksums(*columns: NDArray[Any]) -> NDArray[np.uint32]:
    frames = len(columns[0])
    bytes_of = []
    for column in columns:
        flat = np.ascontiguousarray(column).reshape(frames, -1)
        if flat.dtype.kind == "f":
            flat = np.where(np.isnan(flat), flat.dtype.type(np.nan), flat)
        bytes_of.append(flat.view(np.uint8).reshape(frames, -1))
    return np.array([crc32(row) for row in np.concatenate(bytes_of, axis=1)], dtype=np.uint32)
