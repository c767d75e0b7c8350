"""Captures of one person by two sensors, as cheap data: for laws that hold whatever is captured.

Nothing is fused: S* of :meth:`Capture.session` is the truth. ``recordings.fuse`` gives that of the program.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices.sensor import SensorFrame
from fusion.body import BODIES
from fusion.fused_frame import FusedFrame
from fusion.registration.rigid_fit import Registration
from fusion.skeleton import Skeleton
from recordings.data.session_arrays import SessionFrame
from recordings.session import Session
from tests.helpers.frame_pairs import frame_pair
from tests.helpers.laws import SECOND, SIDE, person, setup_of
from tests.helpers.two_views import A_FROM_B

POSES = {
    "standing": {},
    "bowing": dict.fromkeys(("spine", "neck", "head", "collar", "arm", "nose", "eye", "ear"), -70.0),
    "sitting": {"thigh": 90.0},
    "kneeling": {"shin": -90.0},
    "lying": {"": 90.0},
}
"""Degrees by which bones, by parts of their names, are turned forwards from those of a standing person."""
USUAL_HEIGHT = 1.7


@dataclass(frozen=True)
class Clock:
    """A sensor's clock: runs fast by ``ppm``, is set once by ``step_ns``, and tells whole units."""

    offset_ns: int = 0
    ppm: float = 0.0
    step_ns: int = 0
    stepped_ns: int = 0
    unit_ns: int = 1

    def says(self, true_ns):
        """(T,) ns of this clock at true times."""
        true_ns = np.asarray(true_ns, dtype=np.int64)
        fast = np.rint(1e-6 * self.ppm * true_ns).astype(np.int64)
        told = true_ns + fast + self.offset_ns + self.step_ns * (true_ns >= self.stepped_ns)
        return told // self.unit_ns * self.unit_ns


@dataclass(frozen=True)
class Capture:
    """A person who sways, in a pose; ``present`` has the seconds in which each sensor sees them."""

    family: str = "kinect_v2"
    pose: str = "standing"
    height: float = USUAL_HEIGHT
    place: tuple[float, float] = 0.0, 0.0  # metres from where the start-up pose is held
    seconds: float = 2.0
    rates: tuple[float, float] = 30.0, 30.0
    present: tuple[tuple[tuple[float, float], ...], ...] = ((0.0, np.inf),), ((0.0, np.inf),)
    clocks: tuple[Clock, Clock] = Clock(), Clock()
    calibrated_s: float = 0.0
    seed: int = 0

    @property
    def body(self):
        """The body of the sensors."""
        return BODIES[self.family]

    def times(self, side):
        """(T,) true ns at which a sensor, 0 or 1, captures."""
        count = max(1, round(self.seconds * self.rates[side]))
        return np.rint(np.arange(count) * SECOND / self.rates[side]).astype(np.int64)

    def sees(self, side, times_ns):
        """(T,) whether a sensor has the person."""
        seconds = 1e-9 * np.asarray(times_ns)[:, None] + 1e-7
        first, last = np.array(self.present[side], dtype=float).reshape(-1, 2).T
        return ((first <= seconds) & (seconds < last)).any(axis=1)

    @cached_property
    def posed(self):
        """(J, 3) the person, in K_A's frame."""
        at, body = person(self.body), self.body
        found = at.copy()
        for joint in body.order[1:]:
            bone = at[joint] - at[body.parents[joint]]
            degrees = next((by for part, by in POSES[self.pose].items() if part in body.bones[joint]), 0.0)
            turned = Rotation.from_rotvec(-np.radians(degrees) * SIDE).apply(bone)
            found[joint] = found[body.parents[joint]] + self.height / USUAL_HEIGHT * turned
        return found + (self.place[0], 0.0, self.place[1])

    def truth(self, times_ns):
        """(T, J, 3) metres in K_A's frame: the person sways by 5 cm."""
        shift = 0.05 * np.sin(1e-9 * np.asarray(times_ns))
        return self.posed + shift[:, None, None] * SIDE

    def frames(self, side):
        """The frames of a sensor."""
        times, random = self.times(side), np.random.default_rng(2 * self.seed + side)
        at = self.truth(times) if side == 0 else A_FROM_B.inverse().apply(self.truth(times))
        at = at + random.normal(0.0, 0.003, at.shape)
        told = self.clocks[side].says(times).tolist()
        people = zip(told, at, self.sees(side, times), strict=True)
        return [
            SensorFrame(ns, {"1": Skeleton.of(self.body, each, None, ns)} if seen else {})
            for ns, each, seen in people
        ]

    def session(self):
        """The session of a capture at one rate: S* is the truth; its calibration gets certain."""
        times = self.times(0)
        frames = []
        for a, b, time_ns, at in zip(
            self.frames(0), self.frames(1), times.tolist(), self.truth(times), strict=True
        ):
            pair, count = frame_pair(a, b, "1", time_ns), len(self.body)
            nobody = not (a.people or b.people)
            shares = [np.full(count, float(bool(each.people))) for each in (a, b)]
            fused = FusedFrame(
                np.full_like(at, np.nan) if nobody else at, np.full(count, nobody), *shares,
                np.full(count, -1), A_FROM_B, 1, False, False, time_ns, sigma=np.full(count, 0.01),
            )  # fmt: skip
            frames.append(SessionFrame(pair, fused, 0))
        setup = setup_of(body=self.body)
        of_registration = Registration(A_FROM_B, 0.01, 0.01, np.full(count, 0.01), 0.01, 90, self.body)
        certain = replace(setup.calibration, registration=of_registration)
        begin = min(int(np.searchsorted(times, 1e9 * self.calibrated_s)), len(times) - 1)
        parts = [(replace(setup, calibration=certain), frames[begin:])]
        if begin:
            provisional = replace(certain, provisional=True)
            parts.insert(0, (replace(setup, calibration=provisional), frames[:begin]))
        return Session.of(parts)


def spans(most=6.0):
    """Up to three intervals of seconds."""
    ends = st.tuples(*[st.floats(0.0, most)] * 2).map(sorted).map(tuple)
    return st.lists(ends, max_size=3).map(tuple)


CLOCKS = st.builds(
    Clock,
    offset_ns=st.integers(-(10**12), 10**18),
    ppm=st.floats(-50.0, 50.0),
    step_ns=st.sampled_from((0, 0, 10_000_000, -10_000_000, SECOND, -10 * SECOND)),
    stepped_ns=st.integers(0, 6 * SECOND),
    unit_ns=st.sampled_from((1, 100, 1_000, 1_000_000)),
)


def captures(**stated):
    """Captures of any body, pose, size, place, rates, presence and clocks, but for what is stated."""
    drawn = {
        "family": st.sampled_from(sorted(BODIES)),
        "pose": st.sampled_from(sorted(POSES)),
        "height": st.floats(1.0, 2.1),
        "place": st.tuples(st.floats(-2.0, 2.0), st.floats(0.0, 4.0)),
        "seconds": st.floats(0.1, 6.0),
        "rates": st.tuples(*[st.floats(5.0, 120.0)] * 2),
        "present": st.tuples(spans(), spans()),
        "clocks": st.tuples(CLOCKS, CLOCKS),
        "calibrated_s": st.floats(0.0, 3.0),
        "seed": st.integers(0, 2**31),
    }
    return st.builds(Capture, **(drawn | stated))
