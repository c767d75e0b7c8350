"""Two simulated views as a body tracker labels them, in K_A's frame, with the truth beside them."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from devices.simulated.kinect import simulated_pair
from devices.simulated.person.motion import Motion, keyframes
from devices.simulated.person.movements import MOTIONS
from devices.simulated.rig import Rig
from devices.simulated.tracking.mirroring import Mirroring
from devices.simulated.tracking.tracker_errors import TrackerErrors
from devices.skeletons.file_sensor import SkeletonRecording
from fusion.body import BODIES, Body
from fusion.compiling.references import by_reference
from fusion.facing.exchange import exchange
from fusion.facing.filter import update_facing
from fusion.facing.model import ReportedPair, new_facing_model
from fusion.facing.sequence import relabel_sequence, reported_pairs
from fusion.registration.keyframes import Evidence
from fusion.registration.rigid_fit import label_free_fit
from tests.helpers.frame_pairs import paired

Floats = NDArray[np.float64]
FRAME = 1.0 / 30.0
"""Seconds."""


@dataclass(frozen=True, eq=False)
class Views:
    """Both views of one recording: (T, J, 3) positions and (T, J) states; truth is (T, J, 3) or empty."""

    body: Body
    time_ns: NDArray[np.int64]
    a: Floats
    states_a: NDArray[np.uint8]
    b_in_a: Floats
    states_b: NDArray[np.uint8]
    sensor_b: Floats
    truth: Floats

    def relabel(self, **options):
        return relabel_sequence(self.body, self.reported(), self.time_ns, **options)

    def reported(self):
        """What the facing filter takes."""
        return reported_pairs((self.a, self.b_in_a), (self.states_a, self.states_b), self.sensor_b)

    def reported_at(self, k, stale=(False, False)):
        """Pair k."""
        return ReportedPair(
            np.stack((self.a[k], self.b_in_a[k])), np.stack((self.states_a[k], self.states_b[k])),
            np.array(stale), self.sensor_b.copy(),
        )  # fmt: skip

    def relabelled(self, labels):
        """Both views with their labels exchanged."""
        model = by_reference(new_facing_model(self.body))
        found = []
        for view, (at, states) in enumerate(((self.a, self.states_a), (self.b_in_a, self.states_b))):
            out, out_states = np.empty_like(at), np.empty_like(states)
            for k in range(len(at)):
                exchange(model, at[k], states[k], labels.codes[k, view], out[k], out_states[k])
            found.append(out)
        return found[0], found[1]

    def fused(self, labels):
        """A stand-in for S*: the mean of both relabelled views, each with the weight (1 − doubt)²."""
        weights = np.maximum(1.0 - labels.doubt, 0.02) ** 2
        a, b = self.relabelled(labels)
        w_a, w_b = (np.isfinite(at[..., :1]) * weights[:, view, None, None] for view, at in enumerate((a, b)))
        with np.errstate(invalid="ignore"):
            return np.asarray((w_a * np.nan_to_num(a) + w_b * np.nan_to_num(b)) / (w_a + w_b))


def swapped(body, at, truth, *joints):
    """(T,) frames whose limbs (those with such names, or all) fit the truth better with sides exchanged."""
    lateral = [
        j
        for j, name in enumerate(body.joints)
        if body.mirror[j] != j and (not joints or any(part in name.lower() for part in joints))
    ]
    apart = [
        np.nansum(np.linalg.norm(at[:, lateral] - truth[:, which], axis=2), axis=1)
        for which in (lateral, body.mirror[lateral])
    ]
    return np.asarray(apart[1] < apart[0])


def heading(body, at):
    """(T, 3) horizontal unit vector in which shoulders and hips say that the person faces (−y is up)."""
    l1, l2, r1, r2 = (
        at[:, body.joint(name)] for name in ("ShoulderLeft", "HipLeft", "ShoulderRight", "HipRight")
    )
    left = (l1 - r1) + (l2 - r2)
    front = np.stack((left[:, 2], 0.0 * left[:, 0], -left[:, 0]), axis=1)
    return np.asarray(front / np.linalg.norm(front, axis=1, keepdims=True))


def flips(front):
    """How often a heading turns by more than 90° within 0.1 s (3 frames)."""
    turned = np.flatnonzero(np.sum(front[3:] * front[:-3], axis=1) < 0.0)
    return int(np.sum(np.diff(turned, prepend=-99) > 10))


@dataclass(frozen=True)
class Backwards:
    """A walk played in reverse: the person walks backwards."""

    speed: float = 0.6
    name: str = "backwards"

    def landmarks(self, times, height=1.75):
        return MOTIONS["walk"].landmarks(60.0 - self.speed * np.atleast_1d(np.asarray(times)), height)


@dataclass(frozen=True)
class Turned:
    """A movement of a person who faces another direction."""

    movement: str
    degrees: float

    @property
    def name(self):
        return f"{self.movement} turned by {self.degrees:g}°"

    def landmarks(self, times, height=1.75):
        cosine, sine = np.cos(np.radians(self.degrees)), np.sin(np.radians(self.degrees))
        turn = np.array(((cosine, 0.0, sine), (0.0, 1.0, 0.0), (-sine, 0.0, cosine)))
        return np.asarray(movement(self.movement).landmarks(times, height) @ turn.T)


def _bowed(angle):
    return {"pelvis": (angle, 0.0), "place": (0.0, 0.12 * angle)}


BOW = Motion(
    "bow",
    8.0,
    keyframes(8.0, (0.0, {}), (1.0, {}), (2.2, _bowed(1.35)), (4.2, _bowed(1.35)), (5.5, {}), (7.0, {})),
)
"""A bow until the trunk is nearly horizontal, every eight seconds."""


def movement(name):
    """A movement by name: of the library, ``bow``, ``backwards``, or ``NAME@DEGREES`` for one turned."""
    if "@" in name:
        base, degrees = name.split("@")
        return Turned(base, float(degrees))
    return {"bow": BOW, "backwards": Backwards()}.get(name) or MOTIONS[name]


@cache
def simulated_views(motion, body="kinect_v2", tracker="mirroring", angle_deg=90.0, seconds=10.0, seed=4000):
    """A simulated recording with the true registration.

    Args:
        motion: See :func:`movement`.
        body: By name.
        tracker: ``mirroring`` (the body's own errors), ``right`` (no exchanges), ``random`` (sides exchanged
            at random while the back is turned) or ``perfect`` (no errors, both sensors at the same time).
        angle_deg: Between the sensors.
        seconds: How long.
        seed: Of every error.
    """
    which = BODIES[body]
    fitted, right = TrackerErrors.of(which), replace(TrackerErrors.of(which), mirroring=Mirroring())
    errors = {"mirroring": fitted, "right": right, "random": right, "perfect": TrackerErrors()}[tracker]
    rig = Rig(angle_deg=angle_deg, skew_seconds=0.0) if tracker == "perfect" else Rig(angle_deg=angle_deg)
    a, b, truth = simulated_pair(
        motion=movement(motion), seed=seed, body=which, seconds=seconds, errors=errors, rig=rig
    )
    pairs = [p.skeletons for p in paired(a.frames(), b.frames()).pairs]
    transform = truth.a_from_b
    times = np.array([pair.time_ns for pair in pairs])
    joints = len(which)
    nowhere, unseen = np.full((joints, 3), np.nan), np.zeros(joints, dtype=np.uint8)
    at_a, at_b = (
        np.array([nowhere if side is None else side.positions for side in sides], dtype=np.float64)
        for sides in zip(*((pair.a, pair.b) for pair in pairs), strict=True)
    )
    views = Views(
        body=which,
        time_ns=times,
        a=at_a,
        states_a=np.array([unseen if pair.a is None else pair.a.states for pair in pairs]),
        b_in_a=at_b @ transform.rotation.T + transform.translation,
        states_b=np.array([unseen if pair.b is None else pair.b.states for pair in pairs]),
        sensor_b=transform.translation,
        truth=truth.positions_at(times),
    )
    return _with_random_swaps(views, np.random.default_rng(seed)) if tracker == "random" else views


def _with_random_swaps(views, random):
    """Sides exchanged for 2 s on average, in a third of the frames with the back turned to a sensor."""
    front = heading(views.body, views.truth)
    for at, states, sensor in (
        (views.a, views.states_a, np.zeros(3)),
        (views.b_in_a, views.states_b, views.sensor_b),
    ):
        to_sensor = (sensor - views.truth[:, views.body.root]) * (1.0, 0.0, 1.0)
        to_sensor /= np.linalg.norm(to_sensor, axis=1, keepdims=True)
        back_turned = np.sum(front * to_sensor, axis=1) < -0.3
        on = False
        for k, chance in enumerate(random.random(len(at))):
            on = chance >= 1 / 60 if on else back_turned[k] and chance < 0.5 / 60
            if on:
                at[k], states[k] = at[k, views.body.mirror], states[k, views.body.mirror]
    return views


def real_views(folder):
    """A real pair; R and t fitted robustly over the recording to points that no exchange of labels moves."""
    with SkeletonRecording(folder / "a.csv") as a, SkeletonRecording(folder / "b.csv") as b:
        body = a.body
        pairs = [p.skeletons for p in paired(a.frames(), b.frames()).pairs]
    both = [(p.a, p.b, p.time_ns) for p in pairs if p.a is not None and p.b is not None]
    at_a, at_b = (np.array([pair[v].positions for pair in both], dtype=np.float64) for v in (0, 1))
    known = np.isfinite(at_a).all(axis=2) & np.isfinite(at_b).all(axis=2)
    times = np.array([pair[2] for pair in both])
    no_basis = np.zeros((len(both), 3))
    evidence = Evidence(np.nan_to_num(at_a), np.nan_to_num(at_b), known.astype(float), no_basis, times)
    a_from_b = label_free_fit(body, evidence)
    return Views(
        body=body,
        time_ns=times,
        a=at_a,
        states_a=np.array([pair[0].states for pair in both]),
        b_in_a=a_from_b.apply(at_b),
        states_b=np.array([pair[1].states for pair in both]),
        sensor_b=a_from_b.translation,
        truth=np.empty((0, len(body), 3)),
    )


def step(model, state, views, k, stale=(False, False)):
    """Updates the facing filter with pair k."""
    update_facing(model, state, views.reported_at(k, stale), FRAME)
