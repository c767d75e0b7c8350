"""Evidence of the views on the direction that the person faces, and on their labels.

That of one view is vectors in K_A's frame, normal to the body's axis u where they are compared:

* **axes**: l × u of shoulders and hips, with l from the right joint to the left one. They depend on the
  labels: exchanged, they point backwards.
* **cues**: the knee's offset from the line hip–ankle, the elbow's from the line shoulder–wrist (reversed),
  the head's from the neck. These positions are the same however the tracker labels them, so cues do not
  depend on the labels of the whole body.
* **spans** d: right joint to left joint of six pairs. Labels that are exchanged between two frames reverse
  every d, so that Σ d · d_before turns from positive to negative (:func:`exchange_odds`).

That of both views is the places of elbows and knees (:func:`agreement`): labels that differ exchange them.

The axis u of the body points from the ankles to the shoulders, averaged over both views and a third of a
second. It is upright where a person keeps the balance, also in a squat. The frame of the headings turns with
it, and not about it. So the model is the same for a person who stands, sits or lies: it contains no gravity,
which skeletons do not show.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.compiling.kernels import inner_kernel
from fusion.facing.model import ANKLE, ELBOW, HIP, KNEE, SHOULDER, WRIST
from fusion.skeleton import TRACKED

_OUTLIER_STEP = 0.2  # m between two frames, beside the speed: a larger step of the trunk is an outlier
_OUTLIER_SPEED = 6.0  # m/s: a faster joint is an outlier, and its speed is limited to this
_SPEED_SECONDS = 0.3
_USUAL_DISTANCE = 0.12  # m between the trunks of two views; what is beyond is an error of a whole skeleton
CONTINUOUS_SECONDS = 0.5
"""After a longer time without a new skeleton a view's labels may have changed."""
_LOG_ODDS = math.log(0.3), math.log(3000.0)  # smallest and largest
IN_LINE = math.cos(math.radians(20.0))
"""The person counts as standing if the cosine between trunk and legs is above this."""
_LEVEL = math.sqrt(0.5)  # cosine to −y of the frame: sensors are tilted by less
_RARE = 0.05  # share of the frames in which the person stands
_SHORTEST_AXIS = 0.05  # metres


@inner_kernel
def measure_view(model, state, view, positions, states):  # type: ignore[no-untyped-def]
    """Writes the view's axes, cues and spans with their trust; trust 0 where a joint is missing."""
    for pair in range(6):
        left, right = model.pairs[pair, 0], model.pairs[pair, 1]
        for c in range(3):
            state.evidence.spans[view, pair, c] = positions[left, c] - positions[right, c]
    for girdle in range(2):
        _axis(model, state, view, girdle, states, state.memory.axis)
    row = 0
    for joint, first, last, sign in ((KNEE, HIP, ANKLE, 1.0), (ELBOW, SHOULDER, WRIST, -1.0)):
        for side in range(2):
            i, j, k = model.pairs[first, side], model.pairs[joint, side], model.pairs[last, side]
            _offset(positions, i, j, k, sign, state.evidence.cues[view, row])
            state.evidence.cue_trust[view, row] = 0.5 * _trust(model, states, i, j, k)
            row += 1
    top, base = model.head[0], model.head[1]
    for c in range(3):
        state.evidence.cues[view, row, c] = positions[top, c] - positions[base, c]
    state.evidence.cue_trust[view, row] = _trust(model, states, top, base, base)
    for row in range(5):
        if not math.isfinite(state.evidence.cues[view, row, 0]):
            state.evidence.cue_trust[view, row] = 0.0


@inner_kernel
def _trust(model, states, i, j, k):  # type: ignore[no-untyped-def]
    seen = states[i] == TRACKED and states[j] == TRACKED and states[k] == TRACKED
    return 1.0 if seen else model.constants.inferred_weight


@inner_kernel
def _axis(model, state, view, girdle, states, up):  # type: ignore[no-untyped-def]
    """l × u, and its trust: the square of its length over the body's width, at most 1."""
    span, axis = state.evidence.spans[view, girdle], state.evidence.axes[view, girdle]
    axis[0] = span[1] * up[2] - span[2] * up[1]
    axis[1] = span[2] * up[0] - span[0] * up[2]
    axis[2] = span[0] * up[1] - span[1] * up[0]
    width = math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    state.evidence.axis_trust[view, girdle] = 0.0
    if math.isfinite(width) and width > 1e-3:
        share = min(1.0, width / (0.7 * model.widths[girdle]))
        left, right = model.pairs[girdle, 0], model.pairs[girdle, 1]
        state.evidence.axis_trust[view, girdle] = share * share * _trust(model, states, left, right, right)
        for c in range(3):
            axis[c] /= width


@inner_kernel
def _offset(positions, i, j, k, sign, out):  # type: ignore[no-untyped-def]
    """Offset of joint j from the line through i and k: perpendicular to it, times the sign."""
    along, squared = 0.0, 1e-12  # a line of no length has no offset
    for c in range(3):
        line = positions[k, c] - positions[i, c]
        along += (positions[j, c] - positions[i, c]) * line
        squared += line * line
    share = along / squared
    for c in range(3):
        line = positions[k, c] - positions[i, c]
        out[c] = sign * (positions[j, c] - positions[i, c] - share * line)


@inner_kernel
def update_motion(model, state, view, positions):  # type: ignore[no-untyped-def]
    """Updates the mean speed of the joints; writes the view's change of the trunk's velocity.

    The changes of both views are added afterwards, so that their order does not matter. The trunk is the mean
    of shoulders and hips, which no exchange of labels moves.
    """
    elapsed = state.memory.since[view]
    total, count = 0.0, 0
    for pair in range(6):
        for side in range(2):
            j = model.pairs[pair, side]
            step = 0.0
            for c in range(3):
                step += (positions[j, c] - state.memory.last_joints[view, j, c]) ** 2
            # An exchange of labels moves both joints of a pair: the nearer of both counts.
            m = model.mirror[j]
            crossed = 0.0
            for c in range(3):
                crossed += (positions[j, c] - state.memory.last_joints[view, m, c]) ** 2
            step = min(step, crossed)
            if math.isfinite(step):
                total += min(math.sqrt(step), _OUTLIER_SPEED * elapsed)
                count += 1
    if count > 0:
        share = 1.0 - math.exp(-elapsed / _SPEED_SECONDS)
        state.memory.speed[view] += share * (total / count / elapsed - state.memory.speed[view])
    squared = 0.0
    for c in range(3):
        state.evidence.velocity_change[view, c] = 0.0
        squared += (_trunk(model, positions, c) - state.memory.last_root[view, c]) ** 2
    if math.isfinite(squared) and squared < (_OUTLIER_STEP + 4.0 * elapsed) ** 2:
        share = 0.5 * (1.0 - math.exp(-elapsed / model.constants.motion_seconds))  # one of two views
        for c in range(3):
            velocity = (_trunk(model, positions, c) - state.memory.last_root[view, c]) / elapsed
            state.evidence.velocity_change[view, c] = share * (velocity - state.memory.velocity[c])
    for c in range(3):
        root = _trunk(model, positions, c)
        if math.isfinite(root):
            state.memory.last_root[view, c] = root
    for j in range(len(positions)):
        for c in range(3):
            state.memory.last_joints[view, j, c] = positions[j, c]
    state.memory.since[view] = 0.0


@inner_kernel
def _trunk(model, positions, c):  # type: ignore[no-untyped-def]
    """A coordinate of the mean of shoulders and hips."""
    total = 0.0
    for pair in (SHOULDER, HIP):
        for side in range(2):
            total += positions[model.pairs[pair, side], c]
    return 0.25 * total


@inner_kernel
def exchange_odds(model, state, view):  # type: ignore[no-untyped-def]
    """Factor exp(−k Σ d · d_before) on the odds that a view's labels were exchanged since the previous frame.

    It has limits: a tracker that changes over smoothly passes through d ≈ 0, so that continuity alone must
    not exclude an exchange.
    """
    if state.memory.since[view] > CONTINUOUS_SECONDS:
        return 1.0
    total = 0.0
    for pair in (SHOULDER, HIP, ELBOW, KNEE):
        dot = 0.0
        for c in range(3):
            dot += state.evidence.spans[view, pair, c] * state.memory.last_spans[view, pair, c]
        if math.isfinite(dot):
            total += dot
    return math.exp(max(_LOG_ODDS[0], min(_LOG_ODDS[1], -model.constants.continuity * total)))


@inner_kernel
def agreement(model, state, pair):  # type: ignore[no-untyped-def]
    """Log densities of elbows and knees if A and B label them alike, and if one of them exchanges them.

    Shoulders and hips are as near to each other as two views of them are. Elbows and knees tell whether the
    views differ, and the heading tells which of them is mirrored. What their trunks are apart beyond 12 cm is
    removed: a skeleton that is displaced as a whole says nothing of its labels.
    """
    k = model.constants
    equal = other = 0.0
    a, b = pair.positions[0], pair.positions[1]
    x = _trunk(model, a, 0) - _trunk(model, b, 0)
    y = _trunk(model, a, 1) - _trunk(model, b, 1)
    z = _trunk(model, a, 2) - _trunk(model, b, 2)
    far = math.sqrt(x * x + y * y + z * z)
    if far > _USUAL_DISTANCE:
        beyond = 1.0 - _USUAL_DISTANCE / far
        x, y, z = beyond * x, beyond * y, beyond * z
    else:  # also where a trunk is missing
        x = y = z = 0.0
    for row in (ELBOW, KNEE):
        left, right = model.pairs[row, 0], model.pairs[row, 1]
        equal += _apart(k, a, left, b, left, x, y, z) + _apart(k, a, right, b, right, x, y, z)
        other += _apart(k, a, left, b, right, x, y, z) + _apart(k, a, right, b, left, x, y, z)
    weight = min(k.limb_weight * state.evidence.frames[2], 1.0)
    return -weight * equal, -weight * other


@inner_kernel
def _apart(k, a, i, b, j, x, y, z):  # type: ignore[no-untyped-def]
    """Cost of joint i of A and joint j of B as one joint; 0 where a view does not have it."""
    square = (a[i, 0] - b[j, 0] - x) ** 2 + (a[i, 1] - b[j, 1] - y) ** 2 + (a[i, 2] - b[j, 2] - z) ** 2
    return (
        bounded(0.5 * square / (k.limb_sigma * k.limb_sigma), k.limb_floor) if math.isfinite(square) else 0.0
    )


@inner_kernel
def bounded(cost, most):  # type: ignore[no-untyped-def]
    """A cost that never exceeds ``most``, and equals the given one while small."""
    return cost / (1.0 + cost / most)


@inner_kernel
def add_axis(pairs, positions, total):  # type: ignore[no-untyped-def]
    """Adds the (3,) unit vector of a view from the ankles, or else from the hips, to the shoulders."""
    for low in (ANKLE, HIP):
        squared = 0.0
        for c in range(3):
            squared += _upwards(pairs, positions, low, c) ** 2
        if squared > _SHORTEST_AXIS * _SHORTEST_AXIS:  # also false where a joint is missing
            for c in range(3):
                total[c] += _upwards(pairs, positions, low, c) / math.sqrt(squared)
            return


@inner_kernel
def _upwards(pairs, positions, low, c):  # type: ignore[no-untyped-def]
    shoulders = positions[pairs[SHOULDER, 0], c] + positions[pairs[SHOULDER, 1], c]
    return 0.5 * (shoulders - positions[pairs[low, 0], c] - positions[pairs[low, 1], c])


def upright_direction(body: Body, *views: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) unit vector against gravity: the median direction of trunk and legs while the person stands.

    A person who lies is straight as well. So directions within 45° of the frame's −y, the vertical of sensors
    that stand upright, count alone, unless they are rare: then the sensor is turned.

    Args:
        views: (T, J, 3) positions in one frame; NaN where not tracked.

    Returns:
        −y of that frame where the person never stands.
    """
    found = []
    for view in views:
        middle = [
            0.5 * (view[:, body.joint(f"{name}Left")] + view[:, body.joint(f"{name}Right")])
            for name in ("Shoulder", "Hip", "Ankle")
        ]
        trunk, legs = middle[0] - middle[1], middle[1] - middle[2]
        with np.errstate(invalid="ignore", divide="ignore"):
            trunk = trunk / np.linalg.norm(trunk, axis=1, keepdims=True)
            legs = legs / np.linalg.norm(legs, axis=1, keepdims=True)
        stands = np.sum(trunk * legs, axis=1) > IN_LINE  # False where NaN
        found.append(trunk[stands] + legs[stands])
    every = np.concatenate(found)
    if len(every) == 0:
        return np.array((0.0, -1.0, 0.0))
    level = every[:, 1] < -_LEVEL * np.linalg.norm(every, axis=1)
    up = np.median(every[level] if level.mean() > _RARE else every, axis=0)
    return np.asarray(up / np.linalg.norm(up))
