"""A person before two sensors, and what may have happened before: for laws that hold for every input."""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.body import KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.calibration.calibration import Calibration
from fusion.fuser import Fuser
from fusion.registration.rigid_fit import Registration
from fusion.rigid import RigidTransform
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.two_views import A_FROM_B, standing

COSTLY = settings(max_examples=settings.default.max_examples // 5)
"""For a law of which an example takes half a second or more."""
BODY = KINECT_V2
FRONT = np.array((1.0, 0.0, -1.0)) / np.sqrt(2.0)
"""Where the person looks: at 45° to both sensors."""
SIDE = np.array((1.0, 0.0, 1.0)) / np.sqrt(2.0)
"""To the person's side: a movement forwards or backwards is evidence of the heading."""
SECOND = 1_000_000_000


def joint(body, *words):
    """The joint that a Kinect v2 calls KneeLeft, and an Azure Kinect KNEE_LEFT."""
    return body.joint("".join(words) if body is KINECT_V2 else "_".join(words).upper())


@cache
def person(body=BODY):
    """(J, 3) a person who faces both sensors: knees and elbows are bent, and the head is before the neck."""
    at = standing(body)
    middle, turn = at[body.root].copy(), Rotation.from_euler("y", -90.0, degrees=True)  # K_B was behind
    at = turn.apply(at - middle) + middle
    for part, metres in (("Knee", 0.03), ("Elbow", -0.045)):
        for side in ("Left", "Right"):
            at[joint(body, part, side)] += metres * FRONT
    at[joint(body, "Head")] += 0.05 * FRONT
    return at


@cache
def lengths_of(body=BODY):
    """(J,) the person's bone lengths."""
    lengths = bone_lengths_of(body, person(body))
    lengths[body.root] = 0.0
    return lengths


def setup_of(a_from_b=A_FROM_B, body=BODY, **settings):
    """The person's bone lengths and an exact registration, and the settings of a fuser."""
    exact = Registration(a_from_b, 0.0, 0.0, np.zeros(len(body)), 0.0, 1, body, 0.0)
    calibration = Calibration(body, a_from_b, lengths_of(body), "known truth", exact)
    return FusionSetup(calibration, FuserSettings(**settings))


def walking(times, body=BODY, speed=0.6, place=(0.0, 0.0, 0.0), turned=0.0):
    """(T, J, 3) a person who steps to either side by 0.3 m at no more than this speed, turned by degrees."""
    times = np.atleast_1d(np.asarray(times, dtype=np.float64))
    at, turn = person(body), Rotation.from_euler("y", turned, degrees=True).as_matrix()
    middle, side = at[body.root], turn @ SIDE
    shift = 0.3 * np.sin(times * speed / 0.3)
    return (at - middle) @ turn.T + middle + np.asarray(place) + shift[:, None, None] * side


def pairs_at(times_ns, truth, body=BODY, a_from_b=A_FROM_B, sd=0.003, seed=0):
    """Pairs of both views with Gaussian noise."""
    random, b_from_a = np.random.default_rng(seed), a_from_b.inverse()
    made = []
    for time_ns, at in zip(times_ns, truth, strict=True):
        a, b = at + random.normal(0.0, sd, (2, *at.shape))
        seen = (Skeleton.of(body, x, None, int(time_ns)) for x in (a, b_from_a.apply(b)))
        made.append(SkeletonPair(*seen, int(time_ns)))
    return made


def exchanged(skeleton):
    """With left and right exchanged."""
    m = skeleton.body.mirror
    return Skeleton.of(skeleton.body, skeleton.positions[m], skeleton.states[m], skeleton.time_ns)


def hidden(skeleton, joints):
    """Without these joints."""
    states = skeleton.states.copy()
    states[joints] = 0
    return Skeleton.of(skeleton.body, skeleton.positions, states, skeleton.time_ns)


STEPS_NS = (
    -5 * SECOND,
    -1_000_000,
    0,
    1_000_000,
    5_000_000,
    33_333_333,
    100_000_000,
    900_000_000,
    2 * SECOND,
)
HAPPENINGS = st.one_of(
    st.tuples(st.just("frames"), st.integers(1, 40)),
    st.tuples(st.just("step"), st.sampled_from(STEPS_NS)),
    st.tuples(st.just("empty"), st.integers(1, 60)),
    st.tuples(st.just("moved"), st.floats(-2.0, 2.0), st.floats(-1.0, 2.0)),
    st.tuples(st.just("other person"), st.sampled_from((0.0, 90.0, 180.0))),
    st.tuples(st.just("views"), st.sampled_from(("both", "a", "b"))),
    st.tuples(st.just("exchanged"), st.sampled_from(("none", "a", "b"))),
    st.tuples(st.just("hidden"), st.sampled_from(("none", "arm", "legs", "half"))),
    st.tuples(st.just("carried away"), st.floats(-1.0, 1.0)),
    st.tuples(st.just("recalibrated"), st.floats(-0.5, 0.5), st.floats(-20.0, 20.0)),
)
"""What may happen to a person and two sensors; see :class:`Stage`."""


def joints_of(*parts):
    """Those whose names contain one of the parts."""
    return np.flatnonzero([any(part in name for part in parts) for name in BODY.joints])


HIDDEN = {
    "none": joints_of(),
    "arm": joints_of("ElbowLeft", "WristLeft", "HandLeft", "HandTipLeft", "ThumbLeft"),
    "legs": joints_of("Knee", "Ankle", "Foot"),
    "half": joints_of("Left"),
}


@dataclass
class Stage:
    """A person, two sensors, and one fuser that sees it all."""

    fuser: Fuser = field(default_factory=lambda: Fuser(setup_of()))
    seed: int = 0
    time_ns: int = 100 * SECOND
    dt_ns: int = 33_333_333
    clock: float = 0.0  # of the person's movement, s
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turned: float = 0.0
    views: str = "both"
    mirrored: str = "none"
    missing: str = "none"
    away: float = 0.0  # metres by which B is not where it was
    frames: list = field(default_factory=list)

    def __post_init__(self):
        self.random = np.random.default_rng(self.seed)

    def truth(self):
        """(J, 3) where the person is."""
        return walking(self.clock, place=self.place, turned=self.turned)[0]

    def pair(self):
        """What the sensors report."""
        seed = int(self.random.integers(2**31))
        at = self.truth()
        (pair,) = pairs_at([self.time_ns], [at], seed=seed)
        views = {"a": pair.a, "b": pair.b}
        if self.away:
            b = Skeleton.of(BODY, pair.b.positions + np.float32(self.away), pair.b.states, self.time_ns)
            views["b"] = b
        if self.mirrored != "none":
            views[self.mirrored] = exchanged(views[self.mirrored])
        views = {side: hidden(view, HIDDEN[self.missing]) for side, view in views.items()}
        if self.views != "both":
            views["b" if self.views == "a" else "a"] = None
        return replace(pair, **views)

    def step(self, frames=1):
        """The next frames."""
        for _ in range(frames):
            self.frames.append(self.fuser.update(self.pair()))
            self.time_ns += self.dt_ns
            self.clock += 1e-9 * self.dt_ns

    def happen(self, happening):
        """One of :data:`HAPPENINGS`."""
        kind, *of = happening
        if kind == "frames":
            self.step(of[0])
        elif kind == "step":
            self.time_ns += of[0] - self.dt_ns
            self.step()
        elif kind == "empty":
            for _ in range(of[0]):
                self.fuser.update(SkeletonPair(None, None, self.time_ns))
                self.time_ns += self.dt_ns
        elif kind == "moved":
            self.place = (of[0], 0.0, of[1])
        elif kind == "other person":
            self.turned = of[0]
        elif kind == "views":
            self.views = of[0]
        elif kind == "exchanged":
            self.mirrored = of[0]
        elif kind == "hidden":
            self.missing = of[0]
        elif kind == "carried away":
            self.away = of[0]
        elif kind == "recalibrated":
            turn = Rotation.from_euler("y", of[1], degrees=True).as_matrix()
            wrong = RigidTransform(turn @ A_FROM_B.rotation, A_FROM_B.translation + of[0])
            self.fuser.recalibrate(setup_of(wrong))

    def clean(self, seconds=1.0):
        """From now on both views see the person, who faces both, and the calibration is right.

        Returns:
            (T, J) distances to S* of a new fuser and to the truth, metres; (T, J) stated deviations.
        """
        self.views, self.mirrored, self.missing, self.away, self.turned = "both", "none", "none", 0.0, 0.0
        self.fuser.recalibrate(setup_of())
        fresh, apart, off, sigma = Fuser(setup_of()), [], [], []
        for _ in range(round(seconds * SECOND / self.dt_ns)):
            truth, pair = self.truth(), self.pair()
            frame, other = self.fuser.update(pair), fresh.update(pair)
            apart.append(np.linalg.norm(frame.positions - other.positions, axis=1))
            off.append(np.linalg.norm(frame.positions - truth, axis=1))
            sigma.append(frame.sigma)
            self.time_ns += self.dt_ns
            self.clock += 1e-9 * self.dt_ns
        return np.array(apart), np.array(off), np.array(sigma)
