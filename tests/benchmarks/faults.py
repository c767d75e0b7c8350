"""Artificial faults of one view, and the share of a fault that reaches S*."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body

Array = NDArray[np.float64]
Fault = Literal["snap", "swap", "freeze", "shift"]

FAULTS: tuple[Fault, ...] = get_args(Fault)
"""snap: the right arm sticks to the trunk. swap: left and right are exchanged. freeze: the skeleton
stops. shift: the whole skeleton is moved 250 mm to the right."""
CONCERNED = 0.080
"""Metres: a fault concerns the joints and frames that it moves by more."""

_SHIFT = np.array([0.25, 0.0, 0.0])
_SNAPPED = np.array([0.12, 0.0, 0.0])  # from the trunk's joint to the elbow
_SNAPPED_APART = np.array([0.0, 0.02, 0.0])  # from each joint of the arm to the next
_ARM = ("ElbowRight", "WristRight", "HandRight", "HandTipRight", "ThumbRight")
_TRUNK = ("SpineMid", "SpineNavel", "Spine")


def with_fault(body: Body, positions: Array, fault: Fault, frames: range) -> Array:
    """A view with a fault in some frames.

    Args:
        body: Which joints.
        positions: (T, J, 3) metres, in the sensor's frame; NaN where not tracked.
        fault: Which.
        frames: Consecutive frames, not the first one.

    Returns:
        (T, J, 3), NaN where the view has NaN; ``freeze`` and ``swap`` carry NaN with the joints.
    """
    found = np.array(positions)
    k = slice(frames.start, frames.stop)
    if fault == "shift":
        found[k] += _SHIFT
    elif fault == "freeze":
        found[k] = positions[frames.start - 1]
    elif fault == "swap":
        found[k] = positions[k][:, body.mirror]
    else:
        trunk = next(joint for joint in map(body.find, _TRUNK) if joint is not None)
        arm = [joint for joint in map(body.find, _ARM) if joint is not None]
        for n, joint in enumerate(arm):
            seen = np.isfinite(positions[k, joint, :1])
            found[k, joint] = np.where(
                seen, positions[k, trunk] + _SNAPPED + n * _SNAPPED_APART, positions[k, joint]
            )
    return found


def share_of_fault(view: Array, faulty_view: Array, fused: Array, faulty_fused: Array) -> float:
    """The share of a fault that reaches S*, from 0 to 1.

    The sum of S*'s displacements over the sum of the view's, over the joints and frames that the fault moves
    by more than CONCERNED.

    Args:
        view, faulty_view: (T, J, 3) the view without and with the fault.
        fused, faulty_fused: (T, J, 3) S* made with each.

    Returns:
        The share; NaN where the fault concerns ten joints or fewer.
    """
    fault = np.linalg.norm(faulty_view - view, axis=2)
    moved = np.linalg.norm(faulty_fused - fused, axis=2)
    with np.errstate(invalid="ignore"):
        concerned = (fault > CONCERNED) & np.isfinite(moved)
    if concerned.sum() <= 10:
        return np.nan
    return float(moved[concerned].sum() / fault[concerned].sum())
