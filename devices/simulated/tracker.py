"""What a Kinect's body tracker reports of a person, with its errors: each one a knob that can be turned off.

The errors, in the order in which they befall a joint: a bias that depends on the view; its place under the
skin; a guess where it is hidden, or the place of the joint that covers it (sec. 3); the whole skeleton's
scale; jitter; left taken for right when the back is turned; a frame delivered twice; a person lost.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from devices.simulated.anatomy import Array
from fusion.body import AZURE_KINECT, Body
from fusion.skeleton import Skeleton, TrackingState
from fusion.viewing_plane import Intrinsics


@dataclass(frozen=True)
class JointGroups:
    """One value for each kind of joint."""

    spine: float = 0.0
    head: float = 0.0
    girdle: float = 0.0
    """Hips, shoulders, clavicles."""
    elbow: float = 0.0
    wrist: float = 0.0
    hand: float = 0.0
    tip: float = 0.0
    thumb: float = 0.0
    knee: float = 0.0
    ankle: float = 0.0
    foot: float = 0.0
    face: float = 0.0

    @staticmethod
    def group(joint: str) -> str:
        """The kind of a joint, by its name in any body's spelling."""
        name = joint.replace("_", "").lower()
        for key, group in _GROUP_OF.items():
            if key in name:
                return group
        return "spine"

    def of(self, body: Body) -> Array:
        """(J,) the value of each joint."""
        return np.array([getattr(self, self.group(joint)) for joint in body.joints])


_GROUP_OF = {
    "handtip": "tip", "thumb": "thumb", "hand": "hand", "wrist": "wrist", "elbow": "elbow",
    "spineshoulder": "spine", "shouldercenter": "spine", "hipcenter": "spine", "shoulder": "girdle",
    "clavicle": "girdle", "hip": "girdle", "knee": "knee", "ankle": "ankle", "foot": "foot", "head": "head",
    "nose": "face", "eye": "face", "ear": "face",
}  # fmt: skip


@dataclass(frozen=True)
class TrackerErrors:
    """The errors of one body tracker. Lengths are metres, times seconds; zero turns an error off.

    The defaults of :meth:`of` are fitted to real recordings; ``devices.simulated.realism`` compares.

    Attributes:
        view_bias: Standard deviation of a joint's constant error, which changes with the view, an axis.
        skin: Share of the flesh over a joint by which it is moved along the ray, towards the sensor.
        seen_share: A joint is hidden when less of its surface is seen.
        unsure: Share of time in which a joint counts as hidden although it is not, by kind.
        inferred_error: Standard deviation of the guess for a hidden joint, an axis.
        inferred_jitter: How many times more a hidden joint jitters.
        not_tracked: Share of hidden spells in which the joint has no position at all.
        mistracked: Share of hidden spells in which the joint is reported as tracked all the same.
        snap: How far towards the joint that covers it a mis-tracked joint is moved, 0 to 1.
        stretch: Share of a bone's error in length that stays: a tracker's own model of the body holds bones
            nearly to their length, so that an error moves all that hangs on the joint. 1 lets every joint err
            by itself.
        outliers: Share of frames in which a joint stands somewhere else for a moment, though tracked.
        outlier_size: How far away at most, an axis.
        rescale: Standard deviation of the skeleton's scale.
        rescale_seconds: How long a scale lasts.
        jitter: Standard deviation of a joint's jitter an axis, by kind.
        moving_jitter: What is added to that an axis, for each metre a second that the joint moves.
        jitter_memory: Correlation of the jitter of one frame with the next.
        swapped: Share of frames with left and right swapped while the back is turned.
        swap_seconds: How long a swap lasts.
        stale: Share of frames that repeat the skeleton before.
        lost: Share of frames in which the person is lost.
        lost_seconds: How long the person is lost.
    """

    view_bias: float = 0.0
    skin: float = 0.0
    seen_share: float = 0.0
    unsure: JointGroups = field(default_factory=JointGroups)
    inferred_error: float = 0.0
    inferred_jitter: float = 1.0
    not_tracked: float = 0.0
    mistracked: float = 0.0
    snap: float = 0.0
    stretch: float = 1.0
    outliers: float = 0.0
    outlier_size: float = 0.0
    rescale: float = 0.0
    rescale_seconds: float = 1.0
    jitter: JointGroups = field(default_factory=JointGroups)
    moving_jitter: float = 0.0
    jitter_memory: float = 0.5
    swapped: float = 0.0
    swap_seconds: float = 0.5
    stale: float = 0.0
    lost: float = 0.0
    lost_seconds: float = 0.5

    @staticmethod
    def none() -> TrackerErrors:
        """A perfect tracker: every joint tracked, where it is."""
        return TrackerErrors()

    @staticmethod
    def of(body: Body) -> TrackerErrors:
        """The errors of the body's own tracker."""
        return _AZURE if body is AZURE_KINECT else _KINECT_V2

    def only(self, *knobs: str) -> TrackerErrors:
        """These errors with all but the named knobs turned off."""
        return replace(TrackerErrors.none(), **{knob: getattr(self, knob) for knob in knobs})

    @staticmethod
    def knobs() -> tuple[str, ...]:
        """The names of all knobs."""
        return tuple(f.name for f in fields(TrackerErrors))


_KINECT_V2 = TrackerErrors(
    view_bias=0.023, skin=0.25, seen_share=0.35,
    unsure=JointGroups(hand=0.03, tip=0.05, thumb=0.05, foot=0.05),
    inferred_error=0.14, inferred_jitter=2.0, not_tracked=0.02, mistracked=0.4, snap=0.6,
    stretch=0.16, outliers=0.0065, outlier_size=0.17, rescale=0.017, rescale_seconds=2.0,
    jitter=JointGroups(spine=0.0016, head=0.001, girdle=0.0024, elbow=0.0024, wrist=0.0036, hand=0.005,
                       tip=0.005, thumb=0.014, knee=0.0018, ankle=0.001, foot=0.002, face=0.003),
    moving_jitter=0.002, jitter_memory=0.7, swapped=0.25, swap_seconds=2.0, stale=0.05, lost=0.002,
)  # fmt: skip
_AZURE = TrackerErrors(
    view_bias=0.009, skin=0.15, seen_share=0.35,
    unsure=JointGroups(hand=0.10, tip=0.2, thumb=0.3, foot=0.16),
    inferred_error=0.06, inferred_jitter=2.5, not_tracked=0.65, mistracked=0.25, snap=0.6,
    stretch=0.16, outliers=0.005, outlier_size=0.20, rescale=0.028, rescale_seconds=0.6,
    jitter=JointGroups(spine=0.0012, head=0.001, girdle=0.0020, elbow=0.0024, wrist=0.0036, hand=0.005,
                       tip=0.005, thumb=0.014, knee=0.0018, ankle=0.001, foot=0.002, face=0.003),
    moving_jitter=0.002, jitter_memory=0.7, swapped=0.18, swap_seconds=2.0, stale=0.04, lost=0.001,
)  # fmt: skip

# How much larger than the median the bias of a kind of joint is: limbs' ends are placed worse.
_BIAS = JointGroups(0.7, 0.9, 0.9, 1.1, 1.1, 1.1, 1.2, 1.3, 0.9, 1.0, 1.2, 0.9)
_HIDING_SECONDS = 0.08  # how fast a guess takes over from what was seen
_GUESS_SECONDS = 0.6  # how long a guess errs to the same side
_UNSURE_SECONDS = 0.4
_OUTLIER_SECONDS = 0.12
_BACK_TURNED = -0.3  # cosine between the person's front and the direction to the sensor


class Tracker:
    """One sensor's body tracker: reports frame after frame, in order. The same seed reports the same.

    Args:
        body: What it reports.
        errors: Its errors.
        flesh: (J,) how deep each joint lies under the skin, metres.
        intrinsics: Where joints cover each other.
        frame_seconds: Between two frames.
        random: Its own generator; every frame draws the same number of values, whatever happens in it.
    """

    def __init__(
        self,
        body: Body,
        errors: TrackerErrors,
        flesh: Array,
        intrinsics: Intrinsics,
        frame_seconds: float,
        random: np.random.Generator,
    ) -> None:
        self._body, self._errors, self._flesh, self._intrinsics = body, errors, flesh, intrinsics
        self._dt, self._random = frame_seconds, random
        count = len(body)
        # Coefficients of 1, cos and sin of the view's azimuth: a bias of every view, changing smoothly.
        spread = errors.view_bias * _BIAS.of(body)[:, None, None] / np.sqrt(2.0)
        self._bias = random.standard_normal((count, 3, 3)) * spread
        self._jitter = random.standard_normal((count, 3))
        self._guess = random.standard_normal((count, 3))
        self._scale = float(random.standard_normal())
        self._hiding = np.zeros(count)  # 0 seen … 1 hidden, smoothed
        self._was_hidden = np.zeros(count, dtype=bool)
        self._unsure = np.zeros(count, dtype=bool)
        self._spell = np.full(count, int(TrackingState.INFERRED))
        self._cover = np.arange(count)
        self._away = np.zeros((count, 3))
        self._swapped = self._lost = False
        self._before: Array | None = None
        self._last: tuple[NDArray[np.float64], NDArray[np.uint8]] | None = None

    def report(self, joints: Array, visible: Array, time_ns: int) -> Skeleton | None:
        """The next frame's skeleton.

        Args:
            joints: (J, 3) where the joints are, in the sensor's frame.
            visible: (J,) share of each joint's surface that is seen.
            time_ns: When, on the sensor's clock.

        Returns:
            What the tracker says; None where it has lost the person.
        """
        e, body = self._errors, self._body
        normal = self._random.standard_normal((2 * len(body) + 1, 3))
        uniform = self._random.random((7, len(body)))
        chance = self._random.random(3)
        self._wander(normal)
        hidden = self._hide(joints, visible, uniform)

        at = joints + self._view_bias(joints)
        at = at * (1.0 - e.skin * self._flesh / np.linalg.norm(joints, axis=1))[:, None]
        weight = self._hiding[:, None]
        snapped = self._spell == TrackingState.TRACKED
        guess = at + e.inferred_error * self._guess
        guess[snapped] = at[snapped] + e.snap * (joints[self._cover] - at)[snapped]
        at = at + weight * (guess - at)
        at = self._hold_bones(at, joints) + self._outliers(uniform[3:])
        root = at[body.root]
        at = root + (at - root) * (1.0 + e.rescale * self._scale)
        shaking = (e.jitter.of(body) + e.moving_jitter * self._speed(joints))[:, None]
        at = at + shaking * (1.0 + (e.inferred_jitter - 1.0) * weight) * self._jitter

        states = np.where(hidden, self._spell, int(TrackingState.TRACKED)).astype(np.uint8)
        facing = self._facing(joints)
        if self._switch(
            self._swapped, e.swapped if facing < _BACK_TURNED else 0.0, e.swap_seconds, chance[0]
        ):
            self._swapped = True
            at, states = at[body.mirror], states[body.mirror]
        else:
            self._swapped = False
        if self._last is not None and chance[1] < e.stale:
            at, states = self._last
        self._last = at, states
        out_of_sight = e.seen_share > 0.0 and np.mean(visible > 0.0) < 0.25
        self._lost = self._switch(self._lost, e.lost, e.lost_seconds, chance[2])
        if self._lost or out_of_sight:
            return None
        return Skeleton.of(body, at, states, time_ns)

    def _wander(self, normal: Array) -> None:
        """The errors that go on from frame to frame: first-order autoregressive, of unit variance."""
        count = len(self._body)
        for name, memory, noise in (
            ("_jitter", self._errors.jitter_memory, normal[:count]),
            ("_guess", np.exp(-self._dt / _GUESS_SECONDS), normal[count:-1]),
            ("_scale", np.exp(-self._dt / self._errors.rescale_seconds), normal[-1, 0]),
        ):
            setattr(self, name, memory * getattr(self, name) + np.sqrt(1.0 - memory**2) * noise)

    def _hide(self, joints: Array, visible: Array, uniform: Array) -> NDArray[np.bool_]:
        """(J,) which joints are hidden in this frame; what becomes of one is drawn when it disappears."""
        e = self._errors
        share = e.unsure.of(self._body)
        start, stop = self._rates(share, _UNSURE_SECONDS)
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
        self._was_hidden = hidden
        self._hiding += (hidden - self._hiding) * -np.expm1(-self._dt / _HIDING_SECONDS)
        return hidden

    def _hold_bones(self, at: Array, joints: Array) -> Array:
        """(J, 3) the joints with their bones nearly of their length, from the root outwards."""
        body, stretch = self._body, self._errors.stretch
        if stretch == 1.0:
            return at
        held = at.copy()
        for joint in body.order[1:]:
            parent = body.parents[joint]
            bone = at[joint] - held[parent]
            true = float(np.linalg.norm(joints[joint] - joints[parent]))
            given = float(np.linalg.norm(bone))
            held[joint] = held[parent] + bone * ((true + stretch * (given - true)) / max(given, 1e-6))
        return held

    def _outliers(self, uniform: Array) -> Array:
        """(J, 3) how far the joints stand elsewhere for a moment, uniformly drawn."""
        start, stop = self._rates(self._errors.outliers, _OUTLIER_SECONDS)
        keeps = self._away.any(axis=1) & (uniform[0] >= stop)
        leaves = ~keeps & (uniform[0] < start)
        fresh = (2.0 * uniform[1:4].T - 1.0) * self._errors.outlier_size
        self._away = np.where(keeps[:, None], self._away, np.where(leaves[:, None], fresh, 0.0))
        return self._away

    def _speed(self, joints: Array) -> Array:
        """(J,) how fast each joint moves, metres a second."""
        before = joints if self._before is None else self._before
        self._before = joints
        speed: Array = np.linalg.norm(joints - before, axis=1) / self._dt
        return speed

    def _covering(self, joints: Array, visible: Array) -> NDArray[np.int64]:
        """(J,) the joint that covers each: nearest in the image, before it, no neighbour; or itself."""
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
        """(J, 3) this view's bias of every joint."""
        front, side = self._facing(joints), self._facing(joints, sideways=True)
        norm = max(np.hypot(front, side), 1e-9)
        bias: Array = self._bias @ np.array((1.0, front / norm, side / norm))
        return bias

    def _facing(self, joints: Array, *, sideways: bool = False) -> float:
        """Cosine between the person's front (or left) and the direction to the sensor, seen from above."""
        body = self._body
        names = ("ShoulderLeft", "ShoulderRight", "HipLeft", "HipRight")
        l1, r1, l2, r2 = (joints[body.joint(name)] for name in names)
        left = (l1 - r1) + (l2 - r2)
        direction = left if sideways else np.array((-left[2], 0.0, left[0])) * -1.0
        to_sensor = -joints[body.root]
        across = np.hypot(direction[0], direction[2]) * np.hypot(to_sensor[0], to_sensor[2])
        return float((direction[0] * to_sensor[0] + direction[2] * to_sensor[2]) / max(across, 1e-9))

    def _rates(self, share: Array | float, seconds: float) -> tuple[Array, float]:
        """Chances a frame that a spell starts and ends, for spells of this length that fill this share."""
        stop = min(1.0, self._dt / max(seconds, self._dt))
        share = np.minimum(np.asarray(share), 0.99)
        return np.asarray(stop * share / (1.0 - share)), stop

    def _switch(self, on: bool, share: float, seconds: float, chance: float) -> bool:
        start, stop = self._rates(share, seconds)
        if share <= 0.0:
            return on and chance >= max(stop, 0.3)
        return bool(chance >= stop) if on else bool(chance < start)
