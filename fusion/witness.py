"""Evidence of a depth image on a skeleton of its own sensor.

A witness is (J, 4) float32, metres, in the sensor's frame:

=========  ==========================================================================================
gap        surface minus joint, along the joint's ray; at a joint that is seen: minus its flesh
edge       distance to the silhouette across the ray: positive inside, negative outside, at most REACH
offset_x   centre of the surface about the joint less the joint, across the ray
offset_y   likewise, down
=========  ==========================================================================================

NaN where the image has no reading. Two results follow:

**Evidence.** Where the image sees past a joint, the free space around it, min(gap, -edge), is a lower bound
of the joint's error. Where a surface lies well in front of a joint that the tracker reports as tracked, the
joint is hidden and its position inferred. Both are likelihood ratios, not vetoes: thin limbs lie near their
silhouette.

**A surface measurement.** A limb lies in the middle of its silhouette, and as deep below its surface as the
flesh is thick. That measures a joint across its bone and along its ray, independently of the tracker.

The tables are fitted on simulated sensors by ``python -m tests.experiments.fit_witness``. No recording of
real people with depth images and truth was available, so the evidence is limited to LARGEST.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.compiling.kernels import kernel
from fusion.joint_kinds import by_joint, kind_of, value_of
from fusion.skeleton import TRACKED
from fusion.support.types import Array

COLUMNS = ("gap", "edge", "offset_x", "offset_y")
"""Of a witness."""
SEEN_PAST = 0.030
"""Metres: a reading that lies farther behind the joint is not of its limb."""
REACH = 0.120
"""Metres: search radius for the silhouette."""
LARGEST = 3.0
"""Of a log likelihood ratio: a factor of 20."""

_GROUPS = {
    "spine": "trunk", "head": "trunk", "girdle": "trunk", "knee": "trunk", "elbow": "limb", "ankle": "limb",
    "wrist": "end", "hand": "end", "foot": "end", "tip": "tip", "thumb": "thin", "face": "thin",
}  # fmt: skip
"""Kinds that share a row of EVIDENCE: too few outliers fall on each alone."""
_NEAR_FLESH = 0.060  # metres from where the surface should be: nearer, it confirms the joint
_INSIDE = -0.020  # metres to the silhouette: a joint farther outside is not measured by its patch
_SHORT_BONE = 0.030  # metres across the ray: a shorter bone has no direction in the image
_LARGEST_MOVE = 0.080  # metres: a surface farther away is another limb's

KNOTS = np.array([-0.30, -0.20, -0.12, -0.08, -0.05, 0.0, 0.010, 0.020, 0.030, 0.040, 0.060, 0.090])
"""Metres: negative, how far a surface lies before the joint's flesh; positive, free space about the joint."""


# Fitted by ``python -m tests.experiments.fit_witness --seeds 3000 3001 --seconds 10``: 48 recordings of both
# sensors, 21,000 outliers among the tracked joints.
FLESH = {
    "spine": 0.133, "head": 0.083, "girdle": 0.103, "elbow": 0.047, "wrist": 0.035, "hand": 0.032,
    "tip": 0.021, "thumb": -0.026, "knee": 0.074, "ankle": 0.061, "foot": 0.030, "face": -0.009,
}  # fmt: skip
"""Metres, by kind of joint. Thumbs and faces are so small that the median reading is of what lies behind."""
_NO_SURFACE = (np.inf, np.inf, np.inf)
SURFACE_SD = {
    "head": (0.004, 0.020, 0.006), "girdle": (0.013, 0.014, 0.030), "elbow": (0.012, 0.016, 0.013),
    "wrist": (0.008, 0.016, 0.014), "hand": (0.010, 0.016, 0.013), "tip": (0.016, 0.038, 0.014),
    "knee": (0.008, 0.014, 0.006), "ankle": (0.013, 0.020, 0.016), "foot": (0.013, 0.018, 0.010),
    "spine": _NO_SURFACE, "thumb": _NO_SURFACE, "face": _NO_SURFACE,
}  # fmt: skip
"""Metres, standard deviations of the surface measurement across the bone, along it, along the ray. The trunk
has no silhouette of its own, face and thumbs are smaller than the patch: none for these."""
EVIDENCE = {
    "trunk": (-3.0, -3.0, -3.0, -1.7, -0.7, 1.3, -3.0, -3.0, -3.0, -3.0, -3.0, -3.0),
    "limb": (-3.0, -3.0, -3.0, -2.6, 0.8, 2.1, -3.0, -3.0, -3.0, -3.0, -3.0, -3.0),
    "end": (-3.0, -3.0, -3.0, -1.2, 1.1, 1.6, -1.2, -2.4, -3.0, -3.0, -3.0, -3.0),
    "tip": (-3.0, -3.0, -2.7, -1.8, 0.2, 1.1, 0.1, -0.7, -1.5, -3.0, -3.0, -3.0),
    "thin": (-3.0, -3.0, -2.4, -2.4, -0.5, 1.7, 1.7, 1.4, 0.7, -0.4, -2.4, -3.0),
}
"""Log likelihood ratios at KNOTS, by group of kinds."""


class WitnessModel(NamedTuple):
    """The tables' values for the joints of one body."""

    neighbours: NDArray[np.int64]  # (J,) the joint at the other end of the bone that a silhouette shows
    flesh: Array  # (J,) metres, how deep the joint lies below its surface
    log_odds: Array  # (J, len(KNOTS)) log likelihood ratio that the joint is where it is said to be
    information: Array  # (J, 3) 1/m², of the surface measurement: across the bone, along it, along the ray


def new_witness_model(body: Body) -> WitnessModel:
    """The model of one body."""
    kinds = [kind_of(joint) for joint in body.joints]
    neighbours = body.parent_indices.copy()
    neighbours[body.root] = body.parents.index(body.root)
    sd = np.array([value_of(kind, SURFACE_SD) for kind in kinds])
    return WitnessModel(
        neighbours=neighbours,
        flesh=by_joint(body, FLESH),
        log_odds=np.array([EVIDENCE[value_of(kind, _GROUPS)] for kind in kinds]),
        information=1.0 / sd**2,
    )


class JointEvidence(NamedTuple):
    """What one depth image says about the joints of its sensor's skeleton; in the target frame."""

    log_odds: Annotated[Array, ("J",)]  # log likelihood ratio that the joint is no outlier; 0 if unknown
    places: Annotated[Array, ("J", 3), np.nan]  # position of the joint by its surface, metres
    information: Annotated[Array, ("J", 3, 3)]  # of that place, 1/m²; 0 where there is none


@kernel
def weigh_witness(model, rotation, translation, positions, states, witness, result):  # type: ignore[no-untyped-def]
    """Evidence and surface measurement of every joint of one view.

    Only tracked joints are judged: an inferred joint is known to be hidden, and its position is too uncertain
    to look for a limb there.

    Args:
        rotation, translation: Target frame from the sensor's frame.
        positions: (J, 3) as the sensor gave them, in its frame.
        witness: (J, 4) of the sensor's image; NaN where there is none.
        result: A :class:`JointEvidence`; written.
    """
    log_odds, places, information = result.log_odds, result.places, result.information
    for j in range(len(states)):
        log_odds[j] = 0.0
        for r in range(3):
            places[j, r] = math.nan
            for c in range(3):
                information[j, r, c] = 0.0
        gap, edge = float(witness[j, 0]), float(witness[j, 1])
        if states[j] != TRACKED or not math.isfinite(gap + edge):
            continue
        log_odds[j] = _interpolate(_clearance(gap, edge, model.flesh[j]), model.log_odds[j])
        _place(model, rotation, translation, positions, states, witness, result, j)


@kernel
def _clearance(gap, edge, flesh):  # type: ignore[no-untyped-def]
    """Positive: free space about the joint. Negative: how far the surface lies before the joint's flesh."""
    free = min(gap, -edge)
    if free > 0.0:
        return free
    return min(gap + flesh, 0.0)


@kernel
def _interpolate(x, values):  # type: ignore[no-untyped-def]
    """Linear between KNOTS, constant beyond."""
    if x <= KNOTS[0]:
        return values[0]
    for k in range(1, len(KNOTS)):
        if x < KNOTS[k]:
            share = (x - KNOTS[k - 1]) / (KNOTS[k] - KNOTS[k - 1])
            return values[k - 1] + share * (values[k] - values[k - 1])
    return values[len(KNOTS) - 1]


@kernel
def _place(model, rotation, translation, positions, states, witness, result, j):  # type: ignore[no-untyped-def]
    """The surface measurement of one joint, into row j of the result."""
    place, information, n = result.places[j], result.information[j], model.neighbours[j]
    x, y, z = float(positions[j, 0]), float(positions[j, 1]), float(positions[j, 2])
    off_x, off_y = float(witness[j, 2]), float(witness[j, 3])
    depth = float(witness[j, 0]) + model.flesh[j]  # by which the joint should lie farther along its ray
    if model.information[j, 0] == 0.0 or states[n] == 0 or witness[j, 1] < _INSIDE:
        return
    if not (abs(depth) < _NEAR_FLESH and math.isfinite(off_x + off_y)):
        return
    distance = math.sqrt(x * x + y * y + z * z)
    rx, ry, rz = x / distance, y / distance, z / distance
    bx, by, bz = x - positions[n, 0], y - positions[n, 1], z - positions[n, 2]
    along = bx * rx + by * ry + bz * rz
    bx, by, bz = bx - along * rx, by - along * ry, bz - along * rz
    length = math.sqrt(bx * bx + by * by + bz * bz)
    along = off_x * rx + off_y * ry  # the offset is of the image's plane: without its part along the ray
    mx, my, mz = off_x - along * rx, off_y - along * ry, -along * rz
    if length < _SHORT_BONE or mx * mx + my * my + mz * mz > _LARGEST_MOVE**2:
        return
    bx, by, bz = bx / length, by / length, bz / length
    ax, ay, az = ry * bz - rz * by, rz * bx - rx * bz, rx * by - ry * bx  # across both
    px, py, pz = x + mx + depth * rx, y + my + depth * ry, z + mz + depth * rz
    for r in range(3):
        R = rotation[r]
        place[r] = R[0] * px + R[1] * py + R[2] * pz + translation[r]
    for k in range(3):
        if k == 0:
            dx, dy, dz = ax, ay, az
        elif k == 1:
            dx, dy, dz = bx, by, bz
        else:
            dx, dy, dz = rx, ry, rz
        weight = model.information[j, k]
        for r in range(3):
            d_r = rotation[r, 0] * dx + rotation[r, 1] * dy + rotation[r, 2] * dz
            for c in range(3):
                d_c = rotation[c, 0] * dx + rotation[c, 1] * dy + rotation[c, 2] * dz
                information[r, c] += weight * d_r * d_c
