"""Evidence of one view on the direction that its person faces.

Three kinds of evidence, all horizontal vectors in K_A's frame:

* **axes**: l × u of shoulders and hips, with l from the right joint to the left one and u the upward
  direction. They depend on the labels: exchanged, they point backwards.
* **cues**: the knee's offset from the line hip–ankle, the elbow's from the line shoulder–wrist (reversed),
  the head's from the neck. These positions are the same however the tracker labels them, so cues do not
  depend on the labels of the whole body.
* **spans**: right joint to left joint of six pairs, for continuity and for limbs.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.facing.model import ANKLE, ELBOW, HIP, KNEE, SHOULDER, WRIST

_TRACKED = 2  # fusion.skeleton.TrackingState.TRACKED
_OUTLIER_STEP = 0.2  # m between two frames: a larger step is an outlier and is limited to this
_SPEED_SECONDS = 0.3


@inner_kernel
def measure_view(model, state, view, positions, states):  # type: ignore[no-untyped-def]
    """Writes the view's axes, cues and spans with their trust; trust 0 where a joint is missing."""
    up = state.frame_up
    for pair in range(6):
        left, right = model.pairs[pair, 0], model.pairs[pair, 1]
        for c in range(3):
            state.spans[view, pair, c] = positions[left, c] - positions[right, c]
    for girdle in range(2):
        _axis(model, state, view, girdle, states, up)
    row = 0
    for joint, first, last, sign in ((KNEE, HIP, ANKLE, 1.0), (ELBOW, SHOULDER, WRIST, -1.0)):
        for side in range(2):
            i, j, k = model.pairs[first, side], model.pairs[joint, side], model.pairs[last, side]
            _offset(positions, i, j, k, sign, state.cues[view, row])
            state.cue_trust[view, row] = 0.5 * _trust(model, states, i, j, k)
            row += 1
    top, base = model.head[0], model.head[1]
    for c in range(3):
        state.cues[view, row, c] = positions[top, c] - positions[base, c]
    state.cue_trust[view, row] = _trust(model, states, top, base, base)
    for row in range(5):
        if not math.isfinite(state.cues[view, row, 0]):
            state.cue_trust[view, row] = 0.0


@inner_kernel
def _trust(model, states, i, j, k):  # type: ignore[no-untyped-def]
    seen = states[i] == _TRACKED and states[j] == _TRACKED and states[k] == _TRACKED
    return 1.0 if seen else model.scalars.inferred_weight


@inner_kernel
def _axis(model, state, view, girdle, states, up):  # type: ignore[no-untyped-def]
    """l × u, and its trust: the square of its length over the body's width, at most 1."""
    span, axis = state.spans[view, girdle], state.axes[view, girdle]
    axis[0] = span[1] * up[2] - span[2] * up[1]
    axis[1] = span[2] * up[0] - span[0] * up[2]
    axis[2] = span[0] * up[1] - span[1] * up[0]
    width = math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    state.axis_trust[view, girdle] = 0.0
    if math.isfinite(width) and width > 1e-3:
        share = min(1.0, width / (0.7 * model.widths[girdle]))
        left, right = model.pairs[girdle, 0], model.pairs[girdle, 1]
        state.axis_trust[view, girdle] = share * share * _trust(model, states, left, right, right)
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
def follow_motion(model, state, view, positions):  # type: ignore[no-untyped-def]
    """Updates the mean speed of the joints; writes the view's change of the trunk's velocity.

    The changes of both views are added afterwards, so that their order does not matter. The trunk is the mean
    of shoulders and hips, which no exchange of labels moves.
    """
    elapsed = state.since[view]
    total, count = 0.0, 0
    for pair in range(6):
        for side in range(2):
            j = model.pairs[pair, side]
            step = 0.0
            for c in range(3):
                step += (positions[j, c] - state.last_joints[view, j, c]) ** 2
            # An exchange of labels moves both joints of a pair: the nearer of both counts.
            m = model.mirror[j]
            crossed = 0.0
            for c in range(3):
                crossed += (positions[j, c] - state.last_joints[view, m, c]) ** 2
            step = min(step, crossed)
            if math.isfinite(step):
                total += min(math.sqrt(step), _OUTLIER_STEP)
                count += 1
    if count > 0:
        share = 1.0 - math.exp(-elapsed / _SPEED_SECONDS)
        state.speed[view] += share * (total / count / elapsed - state.speed[view])
    squared = 0.0
    for c in range(3):
        state.pull[view, c] = 0.0
        squared += (_trunk(model, positions, c) - state.last_root[view, c]) ** 2
    if math.isfinite(squared) and squared < (_OUTLIER_STEP + 4.0 * elapsed) ** 2:
        share = 0.5 * (1.0 - math.exp(-elapsed / model.scalars.motion_seconds))  # one of two views
        for c in range(3):
            velocity = (_trunk(model, positions, c) - state.last_root[view, c]) / elapsed
            state.pull[view, c] = share * (velocity - state.velocity[c])
    for c in range(3):
        root = _trunk(model, positions, c)
        if math.isfinite(root):
            state.last_root[view, c] = root
    for j in range(len(positions)):
        for c in range(3):
            state.last_joints[view, j, c] = positions[j, c]
    state.since[view] = 0.0


@inner_kernel
def _trunk(model, positions, c):  # type: ignore[no-untyped-def]
    """A coordinate of the mean of shoulders and hips."""
    total = 0.0
    for pair in (SHOULDER, HIP):
        for side in range(2):
            total += positions[model.pairs[pair, side], c]
    return 0.25 * total
