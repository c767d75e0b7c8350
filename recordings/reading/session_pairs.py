"""A session's frames as pairs of sensor frames, so that a session can serve as a source."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from devices.pairing import FramePair
from devices.sensor import SensorFrame
from fusion.body import Body
from fusion.skeleton import Skeleton
from recordings import layout
from recordings.session_arrays import SessionArrays

PERSON = "0"
"""The id of the only person in the pairs of a session."""


def recorded_pairs(
    rows: SessionArrays, depth: Mapping[str, Iterable[tuple[int, NDArray[np.uint16]]]]
) -> Iterator[FramePair]:
    """The pairs as given by the sensors.

    Args:
        rows: The frames.
        depth: Depth images with their frame numbers by side, in order.
    """
    images = {side: iter(given) for side, given in depth.items()}
    ahead = {side: next(images[side], None) for side in layout.SIDES}
    for t in range(len(rows)):
        seen: dict[str, NDArray[np.uint16]] = {}
        for side in layout.SIDES:
            image = ahead[side]
            if image is not None and image[0] == t:
                seen[side] = image[1]
                ahead[side] = next(images[side], None)
        yield FramePair.of(
            _sensor_frame(
                rows.body,
                rows.clock_a[t],
                rows.positions_a[t],
                rows.states_a[t],
                seen.get("a"),
                None if rows.witness_a is None else rows.witness_a[t],
            ),
            _sensor_frame(
                rows.body,
                rows.clock_b[t],
                rows.positions_b[t],
                rows.states_b[t],
                seen.get("b"),
                None if rows.witness_b is None else rows.witness_b[t],
            ),
            PERSON,
            PERSON,
            int(rows.time_ns[t]),
            int(rows.skew_ns[t]),
        )


def _sensor_frame(
    body: Body,
    clock: np.int64,
    positions: NDArray[np.float32],
    states: NDArray[np.uint8],
    depth: NDArray[np.uint16] | None,
    witness: NDArray[np.float32] | None,
) -> SensorFrame | None:
    if clock == layout.NO_FRAME:
        return None
    if not states.any():
        return SensorFrame(int(clock), {}, depth)
    skeleton = Skeleton.of(body, positions, states, int(clock)).with_witness(witness)
    return SensorFrame(int(clock), {PERSON: skeleton}, depth)
