"""People who do not stand: poses of a body from a simulated one, and what two sensors see of them."""

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.body import Body
from fusion.pair_arrays import Pairs
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair

UP = np.array((0.0, -1.0, 0.0))
POSES = {
    "stand": (0, 0, 0, 0, 0), "bow": (90, 0, 0, 0, 0), "sit": (0, 90, 90, 0, 0),
    "sit and lean": (80, 90, 90, 0, 0), "kneel": (0, 0, 90, 0, 0), "crawl": (0, 90, 90, 90, 0),
    "plank": (0, 0, 0, 82, 0), "on the back": (0, 0, 0, -90, 0), "on the belly": (0, 0, 0, 90, 0),
    "on the left": (0, 0, 0, 0, 90),
    "on the right": (0, 0, 0, 0, -90), "handstand": (0, 0, 0, 180, 0), "cartwheel": (0, 0, 0, 0, 360),
}  # fmt: skip
"""Degrees: the trunk's flexion, the thighs', the knees'; the whole body forwards, and to its left."""


@dataclass(frozen=True)
class Exercise:
    """Somebody who stands for 2 s, takes a pose within some seconds, holds it, and stands again."""

    pose: tuple[float, float, float, float, float]
    yaw_deg: float = 0.0
    seconds: float = 1.2  # of each change
    noise_seed: int = 0

    def truth(self, body: Body, standing, times_s):
        """(T, J, 3) metres; ``standing`` is such a person."""
        share = np.clip(np.minimum((times_s - 2.0) / self.seconds, (10.0 - times_s) / self.seconds), 0.0, 1.0)
        share = share * share * (3.0 - 2.0 * share)
        angles = share[:, None] * self.pose
        return 0.6 * share[:, None, None] * -UP + [
            posed(body, *each, self.yaw_deg) for each in zip(standing, *angles.T, strict=True)
        ]

    def pairs(self, body: Body, truth, a_from_b, times_s):
        """What trackers see that err by 12 mm for as long as the view lasts, and by 4 mm in each frame."""
        noise = np.random.default_rng(self.noise_seed)
        views = []
        for to_sensor in (RigidTransform.identity(), a_from_b.inverse()):
            seen = truth + noise.normal(0.0, 0.012, truth.shape[1:]) + noise.normal(0.0, 0.004, truth.shape)
            views.append(to_sensor.apply(seen))
        return Pairs.of(body, [
            SkeletonPair(Skeleton.of(body, a, None, t), Skeleton.of(body, b, None, t), t, 0)
            for a, b, t in zip(*views, (1e9 * times_s).astype(int).tolist(), strict=True)
        ])  # fmt: skip


def exercises():
    """Any pose between standing and these."""
    angles = st.tuples(
        st.floats(0.0, 90.0), st.floats(0.0, 100.0), st.floats(0.0, 110.0),
        st.floats(-180.0, 180.0), st.floats(-100.0, 100.0),
    )  # fmt: skip
    return st.builds(
        Exercise,
        st.sampled_from(sorted(POSES.values())) | angles,
        st.floats(0.0, 360.0),
        st.floats(0.8, 2.0),
        st.integers(0, 99),
    )


def posed(body: Body, at, trunk, thighs, knees, forwards, left, yaw):
    """(J, 3) a standing person (J, 3) in a pose, degrees, about the middle of the hips."""
    at, hips = at.copy(), [body.joint("HipLeft"), body.joint("HipRight")]
    centre, across = at[hips].mean(axis=0), at[hips[0]] - at[hips[1]]
    across -= across @ UP * UP
    across /= np.linalg.norm(across)
    below = {side: _beyond(body, body.joint(f"Hip{side}")) for side in ("Left", "Right")}
    upper = ~(below["Left"] | below["Right"])
    upper[[body.root]] = False
    at[upper] = _turned(at[upper], centre, across, trunk)
    for side, legs in below.items():
        knee = body.joint(f"Knee{side}")
        legs = legs & (np.arange(len(body)) != body.joint(f"Hip{side}"))
        at[legs] = _turned(at[legs], at[body.joint(f"Hip{side}")], across, -thighs)
        shank = _beyond(body, knee) & (np.arange(len(body)) != knee)
        at[shank] = _turned(at[shank], at[knee], across, knees)
    for axis, angle in ((across, forwards), (np.cross(across, UP), left), (UP, yaw)):
        at = _turned(at, centre, axis, angle)
    return at


def _beyond(body: Body, joint):
    """(J,) whether a joint is this one or hangs on it."""
    found = np.arange(len(body)) == joint
    for i in body.order:
        found[i] |= body.parents[i] >= 0 and found[body.parents[i]]
    return found


def _turned(at, centre, axis, degrees):
    return Rotation.from_rotvec(np.radians(degrees) * axis).apply(at - centre) + centre
