"""A person before two sensors, and what may have happened before: for laws that hold for every input."""

from functools import cache

import numpy as np
from hypothesis import settings
from scipy.spatial.transform import Rotation

from fusion.body import KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.calibration.calibration import Calibration
from fusion.registration.rigid_fit import Registration
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


def joints_of(*parts):
    """Those whose names contain one of the parts."""
    return np.flatnonzero([any(part in name for part in parts) for name in BODY.joints])


HIDDEN = {
    "none": joints_of(),
    "arm": joints_of("ElbowLeft", "WristLeft", "HandLeft", "HandTipLeft", "ThumbLeft"),
    "legs": joints_of("Knee", "Ankle", "Foot"),
    "half": joints_of("Left"),
}
