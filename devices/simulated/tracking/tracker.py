"""Simulates the reports of a Kinect's body tracker, with the errors of ``tracker_errors``.

The errors are applied in this order: a bias that depends on the view; a shift towards the skin; for a hidden
joint, a guess or the position of the joint that covers it (sec. 3); an outlier; errors that a caller adds;
the scale of the whole skeleton; jitter; mirroring; a repeated frame; a lost person.
"""

import math

import numpy as np
from numpy.typing import NDArray

from devices.simulated.person.anatomy import Array
from devices.simulated.tracking.mirroring import MirroringTracker
from devices.simulated.tracking.scripted_faults import ScriptedFaults
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import Body
from fusion.compiling.kernels import njit
from fusion.intrinsics import Intrinsics
from fusion.joint_kinds import by_joint
from fusion.skeleton import Skeleton, TrackingState

# Bias of each kind of joint as a multiple of the median: it is larger at the ends of limbs.
_BIAS = {
    "spine": 0.7, "head": 0.9, "girdle": 0.9, "elbow": 1.1, "wrist": 1.1, "hand": 1.1, "tip": 1.2,
    "thumb": 1.3, "knee": 0.9, "ankle": 1.0, "foot": 1.2, "face": 0.9,
}  # fmt: skip
_HIDING_SECONDS = 0.08  # time constant of the transition from observation to guess
_GUESS_SECONDS = 0.6  # correlation time of the error of a guess
_UNSURE_SECONDS = 0.4
_OUTLIER_SECONDS = 0.12


class Tracker:
    """The body tracker of one sensor. The same seed gives the same reports.

    Args:
        flesh: (J,) depth of each joint under the skin, metres.
        intrinsics: Intrinsics of the camera, which determine the joints that cover each other.
        random: A separate generator; every frame draws the same number of values.
    """

    def __init__(
        self,
        body: Body,
        errors: TrackerErrors,
        flesh: Array,
        intrinsics: Intrinsics,
        frame_seconds: float,
        random: np.random.Generator,
        script: ScriptedFaults | None = None,
    ) -> None:
        self._body, self._errors, self._flesh, self._intrinsics = body, errors, flesh, intrinsics
        self._dt, self._random, self._script = frame_seconds, random, script
        count = len(body)
        self._jitter_size, self._unsure_share = by_joint(body, errors.jitter), by_joint(body, errors.unsure)
        self._corners = [body.joint(n) for n in ("ShoulderLeft", "HipLeft", "ShoulderRight", "HipRight")]
        # Coefficients of 1, cos and sin of the view's azimuth: the bias changes smoothly with the view.
        spread = errors.view_bias * by_joint(body, _BIAS)[:, None, None] / np.sqrt(2.0)
        self._bias = random.standard_normal((count, 3, 3)) * spread
        # A separate generator, so that the other errors do not depend on these.
        added = errors.added
        self._added = None if added is None else added(body, frame_seconds, random.spawn(1)[0])
        self._jitter = random.standard_normal((count, 3))
        self._guess = random.standard_normal((count, 3))
        self._scale = float(random.standard_normal())
        self._hiding = np.zeros(count)  # 0 visible … 1 hidden, smoothed
        self._was_hidden = np.zeros(count, dtype=bool)
        self._unsure = np.zeros(count, dtype=bool)
        self._spell = np.full(count, int(TrackingState.INFERRED))
        self._cover = np.arange(count)
        self._misplaced = np.zeros(count, dtype=bool)
        self._away = np.zeros((count, 3))
        self._mirroring = MirroringTracker(body, errors.mirroring, frame_seconds, random.spawn(1)[0])
        self._lost = False
        self._before: Array | None = None
        self._last: tuple[NDArray[np.float64], NDArray[np.uint8]] | None = None

    def report(self, joints: Array, visible: Array, time_ns: int) -> Skeleton | None:
        """The skeleton that is reported of (J, 3) true joints in the sensor's frame, metres, with (J,)
        visible shares; None while the person is lost.
        """
        e, body = self._errors, self._body
        normal = self._random.standard_normal((2 * len(body) + 1, 3))
        uniform = self._random.random((7, len(body)))
        _, stale, lost = self._random.random(3)  # three, so that a seed gives the frames of version 1.0
        self._wander(normal)
        hidden = self._hide(joints, visible, uniform, time_ns)

        reported = joints + self._view_bias(joints)
        reported = reported * (1.0 - e.skin * self._flesh / np.linalg.norm(joints, axis=1))[:, None]
        weight = self._hiding[:, None]
        snapped = self._spell == TrackingState.TRACKED
        guess = reported + e.inferred_error * self._guess
        guess[snapped] = reported[snapped] + e.snap * (joints[self._cover] - reported)[snapped]
        reported = reported + weight * (guess - reported)
        reported = self._hold_bones(reported, joints) + self._outliers(uniform[3:])
        if self._added is not None:
            reported = reported + next(self._added)
        root = reported[body.root]
        reported = root + (reported - root) * (1.0 + e.rescale * self._scale)
        shaking = (self._jitter_size + e.moving_jitter * self._speed(joints))[:, None]
        reported = reported + shaking * (1.0 + (e.inferred_jitter - 1.0) * weight) * self._jitter

        states = np.where(hidden, self._spell, int(TrackingState.TRACKED)).astype(np.uint8)
        angle = math.atan2(self._facing(joints, sideways=True), self._facing(joints))
        told = self._script is not None and self._script.mirrors(time_ns)
        reported, states = self._mirroring.apply(reported, states, self._front(joints), angle, told)
        if self._last is not None and stale < e.stale:
            reported, states = self._last
        self._last = reported, states
        out_of_sight = e.seen_share > 0.0 and np.mean(visible > 0.0) < 0.25
        self._lost = self._switch(self._lost, e.lost, e.lost_seconds, lost)
        if self._lost or out_of_sight:
            return None
        return Skeleton.of(body, reported, states, time_ns)

    def _wander(self, normal: Array) -> None:
        """Advances the correlated errors: first-order autoregressive, unit variance."""
        count = len(self._body)
        for name, memory, noise in (
            ("_jitter", self._errors.jitter_memory, normal[:count]),
            ("_guess", np.exp(-self._dt / _GUESS_SECONDS), normal[count:-1]),
            ("_scale", np.exp(-self._dt / self._errors.rescale_seconds), normal[-1, 0]),
        ):
            setattr(self, name, memory * getattr(self, name) + np.sqrt(1.0 - memory**2) * noise)

    def _hide(self, joints: Array, visible: Array, uniform: Array, time_ns: int) -> NDArray[np.bool_]:
        """Returns (J,) whether each joint is hidden; how it is reported is drawn when it disappears."""
        e = self._errors
        start, stop = self._rates(self._unsure_share, _UNSURE_SECONDS)
        self._unsure = np.where(self._unsure, uniform[0] >= stop, uniform[0] < start)
        hidden = (visible < e.seen_share) | self._unsure
        begins = hidden & ~self._was_hidden
        fate = np.where(
            uniform[1] < e.mistracked,
            TrackingState.TRACKED,
            np.where(uniform[2] < e.not_tracked, TrackingState.NOT_TRACKED, TrackingState.INFERRED),
        )
        self._spell = np.where(begins, fate, self._spell)
        if begins.any():
            self._cover = np.where(begins, self._covering(joints, visible), self._cover)
        if self._script is not None:
            hidden = self._follow(self._script, hidden, joints, visible, time_ns)
        self._was_hidden = hidden
        self._hiding += (hidden - self._hiding) * -np.expm1(-self._dt / _HIDING_SECONDS)
        return hidden

    def _follow(
        self, script: ScriptedFaults, hidden: NDArray[np.bool_], joints: Array, visible: Array, time_ns: int
    ) -> NDArray[np.bool_]:
        """Returns (J,) whether each joint is hidden, with the joints that the script misplaces."""
        before, self._misplaced = self._misplaced, script.misplaces(time_ns)
        begins, ends = self._misplaced & ~before, before & ~self._misplaced
        self._spell = np.where(self._misplaced, int(TrackingState.TRACKED), self._spell)
        self._spell = np.where(ends, int(TrackingState.INFERRED), self._spell)
        if begins.any():
            cover = self._covering(joints, visible)
            alone = cover == np.arange(len(cover))  # nothing is in front of it
            self._cover = np.where(begins, np.where(alone, self._body.root, cover), self._cover)
        return hidden | self._misplaced

    def _hold_bones(self, at: Array, joints: Array) -> Array:
        """Returns (J, 3) the joints with bone lengths nearly restored, from the root outwards."""
        if self._errors.stretch == 1.0:
            return at
        held = at.copy()
        _hold(held, at, joints, self._body.order[1:], self._body.parent_indices, self._errors.stretch)
        return held

    def _outliers(self, uniform: Array) -> Array:
        """Returns (J, 3) the outlier errors of one frame, drawn uniformly."""
        start, stop = self._rates(self._errors.outliers, _OUTLIER_SECONDS)
        keeps = self._away.any(axis=1) & (uniform[0] >= stop)
        leaves = ~keeps & (uniform[0] < start)
        fresh = (2.0 * uniform[1:4].T - 1.0) * self._errors.outlier_size
        self._away = np.where(keeps[:, None], self._away, np.where(leaves[:, None], fresh, 0.0))
        return self._away

    def _speed(self, joints: Array) -> Array:
        """Returns (J,) the speed of each joint, m/s."""
        before = joints if self._before is None else self._before
        self._before = joints
        speed: Array = np.linalg.norm(joints - before, axis=1) / self._dt
        return speed

    def _covering(self, joints: Array, visible: Array) -> NDArray[np.int64]:
        """(J,) The joint that covers each: nearest in the image, in front, no neighbour; or itself."""
        pixels = self._intrinsics.project(joints)
        apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=2)
        nearer = joints[None, :, 2] < joints[:, None, 2] - 0.05
        possible = nearer & ~self._body.linked & (visible > 0.5)[None]
        apart = np.where(possible, np.nan_to_num(apart, nan=np.inf), np.inf)
        nearest = apart.argmin(axis=1)
        itself = np.arange(len(joints))
        near = apart[itself, nearest] * joints[:, 2] / self._intrinsics.fx < 0.30  # metres across the ray
        return np.where(near, nearest, itself)

    def _view_bias(self, joints: Array) -> Array:
        """Returns (J, 3) the bias of each joint in this view."""
        front, side = self._facing(joints), self._facing(joints, sideways=True)
        norm = max(np.hypot(front, side), 1e-9)
        bias: Array = self._bias @ np.array((1.0, front / norm, side / norm))
        return bias

    def _facing(self, joints: Array, *, sideways: bool = False) -> float:
        """Returns the cosine between front (or left) and the direction to the sensor, seen from above."""
        l1, l2, r1, r2 = joints[self._corners]
        left = (l1 - r1) + (l2 - r2)
        direction = left if sideways else np.array((-left[2], 0.0, left[0])) * -1.0
        to_sensor = -joints[self._body.root]
        across = np.hypot(direction[0], direction[2]) * np.hypot(to_sensor[0], to_sensor[2])
        return float((direction[0] * to_sensor[0] + direction[2] * to_sensor[2]) / max(across, 1e-9))

    def _front(self, joints: Array) -> Array:
        """Returns (3,) the horizontal unit vector of the direction that the person faces."""
        l1, l2, r1, r2 = joints[self._corners]
        left = (l1 - r1) + (l2 - r2)
        front = np.array((left[2], 0.0, -left[0]))
        return np.asarray(front / max(float(np.linalg.norm(front)), 1e-9))

    def _rates(self, share: Array | float, seconds: float) -> tuple[Array, float]:
        """Returns the probabilities per frame that a spell starts and ends, from its share and length."""
        stop = min(1.0, self._dt / max(seconds, self._dt))
        share = np.minimum(np.asarray(share), 0.99)
        return np.asarray(stop * share / (1.0 - share)), stop

    def _switch(self, on: bool, share: float, seconds: float, chance: float) -> bool:
        start, stop = self._rates(share, seconds)
        if share <= 0.0:
            return on and chance >= max(stop, 0.3)
        return bool(chance >= stop) if on else bool(chance < start)


@njit()
def _hold(held, at, joints, order, parents, stretch):  # type: ignore[no-untyped-def]
    for joint in order:
        parent = parents[joint]
        true = given = 0.0
        for c in range(3):
            true += (joints[joint, c] - joints[parent, c]) ** 2
            given += (at[joint, c] - held[parent, c]) ** 2
        true, given = math.sqrt(true), math.sqrt(given)
        scale = (true + stretch * (given - true)) / max(given, 1e-6)
        for c in range(3):
            held[joint, c] = held[parent, c] + (at[joint, c] - held[parent, c]) * scale
