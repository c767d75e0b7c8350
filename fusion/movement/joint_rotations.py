"""Rotations of the bones of S*: the swing follows from the joints, the twist from a convention.

Positions do not determine how a bone turns about its own axis. The convention is:

* **Pelvis and trunk** turn with the line of the hips and with the line of the shoulders.
* **The head** turns with the line of the ears, if the body has ears, else with the trunk.
* **Upper arms and thighs**: the axis of the bent elbow or knee is the person's lateral axis at rest. So a
  forearm turns in the plane of the elbow, a shin in the plane of the knee. A straight limb has no such plane.
  Its twist then stays, and slowly approaches the twist of the smallest rotation from the trunk.
* **All other bones** have the smallest rotation from the bone before them.

The rotation of a bone maps its direction at rest (:attr:`fusion.body.Body.rest`: upright, arms hanging,
facing the sensor) to its direction in S*. So p_child = p_parent + Q_child · (rest_child · length_child) gives
S* exactly.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.compiling.kernels import inner_kernel, kernel

_FRAME, _SWING, _LIMB = 0, 1, 2
STRAIGHT = 10.0
"""Degrees of flexion, below which a limb has no twist of its own."""
_STRAIGHT, _BENT = math.sin(math.radians(STRAIGHT)), math.sin(math.radians(30.0))
"""Below the first sine of a joint's angle its plane is noise; above the second the plane alone counts."""
_TWIST_SPEED = 20.0
"""rad/s. A faster twist is a jump of a plane or past a half turn; motions other than throws are slower."""
_RELAXING = 1.0
"""1/s, at which the twist of a straight limb approaches that of the smallest rotation."""
_FORGETTING_S = 0.5
"""A gap of this length resets the twist of straight limbs."""
_LEFT = np.array([1.0, 0.0, 0.0])  # the person's left at rest, in K_A's frame
_TINY = 1e-9


class _Plan(NamedTuple):
    """How each bone of a body gets its rotation."""

    order: NDArray[np.int64]  # (J,) parents before children
    kinds: NDArray[np.int64]  # (J,) _FRAME, _SWING or _LIMB, of the bone that ends in a joint
    bases: NDArray[np.int64]  # (J,) the bone whose rotation comes first; -1 for none
    ends: NDArray[np.int64]  # (J, 2) where the bone begins and ends; at the root, the first of the spine
    pairs: NDArray[np.int64]  # (J, 2) left and right joint of a frame; the ends of the lower bone of a limb
    signs: NDArray[np.float64]  # (J,) of the cross product of a limb's bones: it points to the person's left
    rest: NDArray[np.float64]  # (J, 3) unit directions at rest


@cache
def _plan(body: Body) -> _Plan:
    J = len(body)
    plan = _Plan(
        order=body.order,
        kinds=np.full(J, _SWING),
        bases=body.parent_indices.copy(),
        ends=np.stack([body.parent_indices, np.arange(J)], axis=1),
        pairs=np.full((J, 2), -1),
        signs=np.ones(J),
        rest=np.array(body.rest),
    )

    def turn_with(bone: int, pair: tuple[int, int]) -> None:
        plan.kinds[bone], plan.pairs[bone] = _FRAME, pair

    shoulders = body.joint("ShoulderLeft"), body.joint("ShoulderRight")
    hips = body.joint("HipLeft"), body.joint("HipRight")
    spine = _common_path(body, *shoulders)
    turn_with(body.root, hips)
    if spine:
        plan.ends[body.root] = plan.ends[spine[0]]
        plan.rest[body.root] = body.rest[spine[0]]
        turn_with(spine[0], hips)
        turn_with(spine[-1], shoulders)
    trunk = spine[-1] if spine else body.root
    head, left_ear, right_ear = (body.find(name) for name in ("Head", "EarLeft", "EarRight"))
    if head is not None and left_ear is not None and right_ear is not None:
        turn_with(head, (left_ear, right_ear))
    for upper, lower, base, sign in (("Elbow", "Wrist", trunk, -1.0), ("Knee", "Ankle", body.root, 1.0)):
        for side in ("Left", "Right"):
            bone, end = body.joint(upper + side), body.joint(lower + side)
            plan.kinds[bone], plan.bases[bone], plan.signs[bone] = _LIMB, base, sign
            plan.pairs[bone] = bone, end
    return plan


class _Scratch(NamedTuple):
    d: NDArray[np.float64]  # (3,) direction of the bone
    axis: NDArray[np.float64]  # (3,)
    ref: NDArray[np.float64]  # (3,)
    old: NDArray[np.float64]  # (4,)
    swung: NDArray[np.float64]  # (4,) the rotation, as computed so far


def _common_path(body: Body, first: int, second: int) -> list[int]:
    """The joints that lie on the paths from the root to both joints, without the root."""
    ways = []
    for joint in (first, second):
        way = [joint]
        while body.parents[way[-1]] >= 0:
            way.append(body.parents[way[-1]])
        ways.append(way[::-1])
    return [a for a, b in zip(*ways, strict=False) if a == b][1:]


def joint_bones(body: Body) -> NDArray[np.int64]:
    """(J,) the bone whose rotation a joint shows in formats that have one rotation per joint.

    It is the bone that leaves the joint. If several do, it is the hand at a wrist, the foot at an ankle, and
    elsewhere the bone that ends in the joint. A last joint shows the bone that ends in it, the root the
    pelvis.
    """
    children = [[c for c in range(len(body)) if body.parents[c] == j] for j in range(len(body))]
    bones = np.array([own[0] if len(own) == 1 else j for j, own in enumerate(children)], dtype=np.int64)
    bones[body.root] = body.root
    for bone in ("Hand", "Foot"):
        for side in ("Left", "Right"):
            end = body.find(bone + side)
            if end is not None:
                bones[body.parents[end]] = end
    return bones


class JointRotations:
    """Rotations of all bones, frame by frame; the twist is continuous in time."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self._plan = _plan(body)
        self._before = np.full((len(body), 4), np.nan)
        self._time_ns: int | None = None

    def update(self, positions: NDArray[np.float64], time_ns: int) -> NDArray[np.float64]:
        """The rotations of one frame.

        Args:
            positions: (J, 3) metres, S* in K_A's frame; NaN where there is no person.

        Returns:
            (J, 4) unit quaternions x, y, z, w in K_A's frame: the rotation from rest of the bone that ends in
            a joint; at the root, of the pelvis. Signs are continuous in time. NaN where there is no person.
        """
        self.body.require_shape(positions.shape)
        rotations = np.full((len(self.body), 4), np.nan)
        if not np.isfinite(positions).all():
            return rotations
        elapsed = -1.0 if self._time_ns is None else (time_ns - self._time_ns) * 1e-9
        known = 0.0 <= elapsed < _FORGETTING_S
        at = np.ascontiguousarray(positions, dtype=np.float64)
        _rotate(self._plan, at, self._before, known, max(elapsed, 0.0), rotations)
        self._before, self._time_ns = rotations, time_ns
        return rotations.copy()


def rotations_of(
    body: Body, positions: NDArray[np.floating], time_ns: NDArray[np.int64]
) -> NDArray[np.float64]:
    """(T, J, 4) the rotations of all frames of S* (T, J, 3); see :meth:`JointRotations.update`."""
    rotations = JointRotations(body)
    each = [rotations.update(at, int(t)) for at, t in zip(positions, time_ns, strict=True)]
    return np.array(each).reshape(len(positions), len(body), 4)


@kernel
def _rotate(plan, at, before, known, elapsed, out):  # type: ignore[no-untyped-def]
    work = _Scratch(np.empty(3), np.empty(3), np.empty(3), np.empty(4), np.empty(4))
    d, axis, ref, old, swung = work
    order, kinds, bases, ends, pairs, rest = (
        plan.order, plan.kinds, plan.bases, plan.ends, plan.pairs, plan.rest,
    )  # fmt: skip
    relaxed = min(_RELAXING * elapsed, 1.0)
    for k in range(order.shape[0]):
        j = order[k]
        first, last = ends[j, 0], ends[j, 1]
        length = 0.0
        for c in range(3):
            d[c] = at[last, c] - at[first, c] if first >= 0 else -rest[j, c]
            length += d[c] * d[c]
        length = math.sqrt(length)
        base = bases[j]
        for c in range(4):
            swung[c] = out[base, c] if base >= 0 else (1.0 if c == 3 else 0.0)
        if length > _TINY:
            for c in range(3):
                d[c] /= length
            cosine = _swing(rest[j], d, swung)
            if kinds[j] == _FRAME:
                for c in range(3):
                    axis[c] = at[pairs[j, 0], c] - at[pairs[j, 1], c]
                _twist(d, _left_angle(swung, d, axis, ref), swung)
            elif kinds[j] == _LIMB:
                for c in range(3):
                    axis[c] = at[pairs[j, 1], c] - at[pairs[j, 0], c]
                share = _hinge(d, axis, plan.signs[j])
                if known:
                    _twist_limb(share, 0.5 + 0.5 * cosine, relaxed, rest[j], before[j], work)
                else:
                    _twist(d, share * _left_angle(swung, d, axis, ref), swung)
            if known:
                _limit_twist(rest[j], before[j], d, _TWIST_SPEED * elapsed, old, swung)
        same = 0.0  # NaN in the first frame
        for c in range(4):
            same += swung[c] * before[j, c]
        for c in range(4):
            out[j, c] = -swung[c] if same < 0.0 else swung[c]


@inner_kernel
def _hinge(d, axis, sign):  # type: ignore[no-untyped-def]
    """Replaces the lower bone by the axis between it and d; returns how much the axis counts, 0 to 1."""
    x, y, z = axis[0], axis[1], axis[2]
    scale = sign / max(math.sqrt(x * x + y * y + z * z), _TINY)
    axis[0] = scale * (d[1] * z - d[2] * y)
    axis[1] = scale * (d[2] * x - d[0] * z)
    axis[2] = scale * (d[0] * y - d[1] * x)
    bend = math.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    share = min(max((bend - _STRAIGHT) / (_BENT - _STRAIGHT), 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


@inner_kernel
def _twist_limb(share, trust, relaxed, rest, before, work):  # type: ignore[no-untyped-def]
    """Twists a limb from its twist before: to the hinge where bent, else slowly to that of `swung`.

    `trust` is 0 where the limb is half a turn from rest, where the smallest rotation is undetermined.
    """
    d, axis, ref, old, swung = work
    for c in range(4):
        old[c] = before[c]
    _swing(rest, d, old)
    to_hinge = _left_angle(old, d, axis, ref)
    _left_of(swung, axis)
    to_smallest = _left_angle(old, d, axis, ref)
    _twist(d, share * to_hinge + (1.0 - share) * relaxed * trust * to_smallest, old)
    for c in range(4):
        swung[c] = old[c]


@inner_kernel
def _limit_twist(rest, before, d, most, old, swung):  # type: ignore[no-untyped-def]
    """Limits the twist from the rotation before, which first swings the shortest way to d."""
    for c in range(4):
        old[c] = before[c]
    _swing(rest, d, old)
    # swung · old⁻¹ turns about d
    along, w = 0.0, old[3] * swung[3]
    for c in range(3):
        e, f = (c + 1) % 3, (c + 2) % 3
        along += d[c] * (old[3] * swung[c] - swung[3] * old[c] - swung[e] * old[f] + swung[f] * old[e])
        w += old[c] * swung[c]
    angle = 2.0 * math.atan2(-along if w < 0.0 else along, abs(w))
    if abs(angle) > most:
        _twist(d, math.copysign(most, angle), old)
        for c in range(4):
            swung[c] = old[c]


@inner_kernel
def _left_of(q, out):  # type: ignore[no-untyped-def]
    """The person's left, rotated by q."""
    out[0] = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])
    out[1] = 2.0 * (q[0] * q[1] + q[2] * q[3])
    out[2] = 2.0 * (q[0] * q[2] - q[1] * q[3])


@inner_kernel
def _left_angle(q, d, axis, ref):  # type: ignore[no-untyped-def]
    """The angle about d from the rotated left to an axis; 0 where the axis lies along d."""
    _left_of(q, ref)
    dot_axis, dot_ref = 0.0, 0.0
    for c in range(3):
        dot_axis += axis[c] * d[c]
        dot_ref += ref[c] * d[c]
    sine, cosine = 0.0, 0.0
    for c in range(3):
        e, f = (c + 1) % 3, (c + 2) % 3
        sine += d[c] * (ref[e] * axis[f] - ref[f] * axis[e])
        cosine += (ref[c] - dot_ref * d[c]) * (axis[c] - dot_axis * d[c])
    if abs(sine) + abs(cosine) < _TINY:
        return 0.0
    return math.atan2(sine, cosine)


@inner_kernel
def _twist(d, angle, q):  # type: ignore[no-untyped-def]
    """q ← (rotation about d by the angle) · q."""
    s, w = math.sin(0.5 * angle), math.cos(0.5 * angle)
    _multiply(s * d[0], s * d[1], s * d[2], w, q)


@inner_kernel
def _multiply(x, y, z, w, q):  # type: ignore[no-untyped-def]
    """q ← (x, y, z, w) · q, of unit length."""
    a = w * q[0] + x * q[3] + y * q[2] - z * q[1]
    b = w * q[1] - x * q[2] + y * q[3] + z * q[0]
    c = w * q[2] + x * q[1] - y * q[0] + z * q[3]
    e = w * q[3] - x * q[0] - y * q[1] - z * q[2]
    size = math.sqrt(a * a + b * b + c * c + e * e)
    q[0], q[1], q[2], q[3] = a / size, b / size, c / size, e / size


@inner_kernel
def _swing(rest, d, q):  # type: ignore[no-untyped-def]
    """q ← (the smallest rotation that takes q's rest direction to d) · q; returns their cosine."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    # u = q rest q⁻¹
    tx = 2.0 * (y * rest[2] - z * rest[1])
    ty = 2.0 * (z * rest[0] - x * rest[2])
    tz = 2.0 * (x * rest[1] - y * rest[0])
    u0 = rest[0] + w * tx + y * tz - z * ty
    u1 = rest[1] + w * ty + z * tx - x * tz
    u2 = rest[2] + w * tz + x * ty - y * tx
    cosine = u0 * d[0] + u1 * d[1] + u2 * d[2]
    a, b, c = u1 * d[2] - u2 * d[1], u2 * d[0] - u0 * d[2], u0 * d[1] - u1 * d[0]
    e = 1.0 + cosine
    if e < _TINY:  # half a turn, about any axis across u
        if abs(u0) < 0.7:
            a, b, c = 0.0, u2, -u1
        else:
            a, b, c = -u2, 0.0, u0
        e = 0.0
    size = math.sqrt(a * a + b * b + c * c + e * e)
    _multiply(a / size, b / size, c / size, e / size, q)
    return cosine
