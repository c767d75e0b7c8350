"""Figures of S* on recordings without ground truth.

Good figures do not prove that S* is right; bad ones prove that it is wrong. They compare S* with the limits
of human motion (people do not jump between frames, and do not run backwards) and with its two views.
"""

import warnings
from contextlib import suppress
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.errors import FusionError
from fusion.registration.rigid_fit import fit_recording
from fusion.rigid import RigidTransform
from fusion.support.types import Array
from recordings.data.session_data import SessionData

JUMP = 4.5
"""m/s from one frame to the next: faster than a walking person; 150 mm at 30 frames per second."""
NO_JUMP = 2.25
"""m/s: a view whose joint moved less made no jump of its own."""
FAST = 0.8
"""m/s of the trunk: people rarely walk backwards that fast."""
TOGETHER, APART = 0.15, 0.35
"""Metres between the wrists: the hands are in one place, and a view has them in two."""
_AGAINST = -0.5  # cosine between facing and motion: more than 120° apart
_STRAIGHT = np.radians(40.0)  # per second: a path that turns more slowly
_ASTRAY = np.radians(45.0)
_SMOOTH = 0.3  # seconds that the trunk's speed is averaged over
_ENDS = 0.4  # seconds at each end without a smooth speed
_FEWEST = 30  # pairs that are judged
_FEWEST_FAST = 1.0  # seconds: too few for a share
_FEWEST_STRAIGHT = 2.0 / 3.0  # seconds
_FLIP_SECONDS = 0.1
_ONE_FLIP = 1.0 / 3.0  # seconds: turns that are nearer to each other are one flip


@dataclass(frozen=True, eq=False)
class FusedPair:
    """A recording with its S*."""

    body: Body
    time_ns: NDArray[np.int64]  # (T,) of the pairs
    a: Array  # (T, J, 3) the views, each in its sensor's frame, metres; NaN where not tracked
    b: Array
    fused: Array  # (T, J, 3) S*, in K_A's frame
    a_from_b: tuple[RigidTransform, ...]  # (T,) the registration of each frame

    @property
    def b_in_a(self) -> Array:
        """(T, J, 3) S_B in K_A's frame, by the registration of each frame."""
        return np.array([fit.apply(q) for fit, q in zip(self.a_from_b, self.b, strict=True)])


@dataclass(frozen=True)
class FiguresWithoutTruth:
    """The figures of one recording. Lengths are metres, shares 0 to 1; NaN where there is no such figure."""

    frames: int  # how many pairs
    rough_a: float
    rough_b: float
    rough_mean: float
    rough_fused: float
    """Mean norm of a joint's second difference, metres per frame², of each view, of the views' mean under one
    robust registration, and of S*. The noise in it does not depend on the frame rate, the movement does."""
    jumps_a: float  # share of joint steps above JUMP
    jumps_b: float
    jumps_fused: float
    jumps_own: float  # share of joint steps in which S* jumps and neither view moves by more than NO_JUMP
    against_a: float
    against_b: float
    against_fused: float
    """Share of frames with a trunk faster than FAST in which it faces against its motion: a sign of mirrored
    labels."""
    heading_a: float
    heading_b: float
    heading_fused: float
    """Radians, the median angle between where the trunk faces and where it moves, over the frames with a
    trunk faster than FAST on a straight path. People face where they walk to within 10° to 20°, but for those
    who walk backwards or sideways."""
    astray_fused: float  # share of these frames in which S* faces more than 45° away from its path
    flips_per_minute: float  # how often S* turns by more than 90° within 0.1 s
    hands_together: float  # share of frames with the wrists of S* within TOGETHER, and APART in a view
    rotation_off: float  # radians between the last frame's R and a robust fit over the recording
    apart: float  # median distance between the views, by the registration of each frame

    @property
    def roughness_ratio(self) -> float:
        """Roughness of S* over the mean of the two views'."""
        return self.rough_fused / (0.5 * (self.rough_a + self.rough_b))


def figures_without_truth(pair: FusedPair) -> FiguresWithoutTruth:
    """Measures one recording.

    Assumes that the sensors' y axes point down within some 30°, so that x and z span the horizontal plane.

    Raises:
        FusionError: Fewer than 30 pairs, or hardly any joint that both sensors see.
    """
    if len(pair.time_ns) < _FEWEST:
        raise FusionError(f"A recording needs {_FEWEST} pairs or more to be judged; got {len(pair.time_ns)}.")
    robust = fit_recording(pair.a, pair.b)
    b = robust.apply(pair.b)
    steps_a, steps_b, steps = (  # (T-1, J) distance that each joint moves from frame to frame
        np.linalg.norm(np.diff(view, axis=0), axis=2) for view in (pair.a, b, pair.fused)
    )
    interval = _usual_interval(pair.time_ns)
    jump, no_jump = JUMP * interval, NO_JUMP * interval
    known = np.isfinite(steps_a) & np.isfinite(steps_b) & np.isfinite(steps)
    way, fast, straight = _motion(pair.body, pair.a, b, pair.time_ns)
    least = round(_FEWEST_STRAIGHT / interval)
    headings = [_off_the_path(pair.body, of, way, straight, least) for of in (pair.a, b, pair.fused)]
    least = round(_FEWEST_FAST / interval)
    against = [_against(pair.body, of, way, fast, least) for of in (pair.a, b, pair.fused)]
    own = (steps > jump) & (steps_a < no_jump) & (steps_b < no_jump)
    return FiguresWithoutTruth(
        frames=len(pair.time_ns),
        rough_a=_roughness(pair.a),
        rough_b=_roughness(b),
        rough_mean=_roughness(0.5 * (pair.a + b)),
        rough_fused=_roughness(pair.fused),
        jumps_a=_share(steps_a[known] > jump),
        jumps_b=_share(steps_b[known] > jump),
        jumps_fused=_share(steps[known] > jump),
        jumps_own=_share(own[known]),
        against_a=against[0],
        against_b=against[1],
        against_fused=against[2],
        heading_a=_median(headings[0]),
        heading_b=_median(headings[1]),
        heading_fused=_median(headings[2]),
        astray_fused=_share(headings[2] > _ASTRAY),
        flips_per_minute=_flips_per_minute(pair.body, pair.fused, pair.time_ns),
        hands_together=_hands_together(pair),
        rotation_off=pair.a_from_b[-1].angle_to(robust),
        apart=_median(np.linalg.norm(pair.b_in_a - pair.a, axis=2)),
    )


@dataclass(frozen=True)
class HeldOutRegistration:
    """Figures of a registration learned on the first half of a recording, on the second half."""

    rotation_off: float  # radians from a robust fit over the second half
    position_off: float  # metres between both positions of the middle of the person in the second half
    apart: float  # median distance between the views in the second half, with the registration learned


def judge_registration(learned: RigidTransform, a: Array, b: Array) -> HeldOutRegistration:
    """Judges ``a_from_b`` on (T, J, 3) views that it was not learned on, each in its sensor's frame."""
    own = fit_recording(a, b)
    middle = np.nanmedian(b.reshape(-1, 3), axis=0)
    return HeldOutRegistration(
        rotation_off=learned.angle_to(own),
        position_off=float(np.linalg.norm(learned.apply(middle) - own.apply(middle))),
        apart=_median(np.linalg.norm(learned.apply(b) - a, axis=2)),
    )


def to_the_left(body: Body, positions: Array) -> Array:
    """(T, 2) unit vectors on the floor (x, z) from the trunk's right to its left; NaN where it is unknown."""
    left, right = (
        [body.joint(f"{part}{side}") for part in ("Shoulder", "Hip")] for side in ("Left", "Right")
    )
    across = (positions[:, left].mean(axis=1) - positions[:, right].mean(axis=1))[:, [0, 2]]
    with np.errstate(invalid="ignore"):
        return np.asarray(across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9))


def facing(body: Body, positions: Array) -> Array:
    """(T, 2) unit vectors on the floor (x, z) in which the trunk faces, by the sides as they are labelled."""
    left = to_the_left(body, positions)
    return np.stack([left[:, 1], -left[:, 0]], axis=1)


def _motion(
    body: Body, a: Array, b: Array, time_ns: NDArray[np.int64]
) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """(T, 2) the direction on the floor in which the trunk moves, (T,) whether faster than FAST, and (T,)
    whether along a straight path as well."""
    trunk = [body.joint(name) for name in ("ShoulderLeft", "ShoulderRight", "HipLeft", "HipRight")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a frame in which no view has a trunk
        middle = np.nanmean([np.nanmean(view[:, trunk], axis=1) for view in (a, b)], axis=0)[:, [0, 2]]
    interval = _usual_interval(time_ns)
    count, ends = max(1, round(_SMOOTH / interval)), max(1, round(_ENDS / interval))
    window = np.ones(count) / count
    elapsed = np.gradient(time_ns * 1e-9)
    elapsed[elapsed <= 0.0] = np.nan  # three pairs of one time
    smooth = np.stack([np.convolve(coordinate, window, "same") for coordinate in middle.T], axis=1)
    velocity = np.gradient(smooth, axis=0) / elapsed[:, None]
    speed = np.linalg.norm(velocity, axis=1)
    fast = speed > FAST  # NaN is not
    fast[:ends] = fast[-ends:] = False
    way = velocity / np.maximum(speed, 1e-9)[:, None]
    angle = np.arctan2(way[:, 1], way[:, 0])
    angle[np.isfinite(angle)] = np.unwrap(angle[np.isfinite(angle)])
    turning = np.gradient(angle) / elapsed
    return way, fast, fast & (np.abs(turning) < _STRAIGHT)


def _usual_interval(time_ns: NDArray[np.int64]) -> float:
    """Seconds between two pairs."""
    steps = np.diff(time_ns)
    steps = steps[steps > 0]
    return float(np.median(steps)) * 1e-9 if len(steps) else 1.0 / 30.0


def _off_the_path(body: Body, positions: Array, way: Array, straight: NDArray[np.bool_], least: int) -> Array:
    """Angles, radians, between facing and the straight path; empty if it has no more frames than these."""
    cosine = (facing(body, positions) * way).sum(axis=1)[straight]
    found: Array = np.arccos(np.clip(cosine[np.isfinite(cosine)], -1.0, 1.0))
    return found if len(found) > least else found[:0]


def _against(body: Body, positions: Array, way: Array, fast: NDArray[np.bool_], least: int) -> float:
    cosine = (facing(body, positions) * way).sum(axis=1)[fast]
    cosine = cosine[np.isfinite(cosine)]
    return _share(cosine < _AGAINST) if len(cosine) > least else np.nan


def _flips_per_minute(body: Body, positions: Array, time_ns: NDArray[np.int64]) -> float:
    interval = _usual_interval(time_ns)
    within, one = (max(1, round(seconds / interval)) for seconds in (_FLIP_SECONDS, _ONE_FLIP))
    left = to_the_left(body, positions)
    turned = np.flatnonzero((left[within:] * left[:-within]).sum(axis=1) < 0.0)
    flips = int(np.sum(np.diff(turned) > one)) + 1 if len(turned) else 0
    return flips * 60.0 / (float(time_ns[-1] - time_ns[0]) * 1e-9)


def _hands_together(pair: FusedPair) -> float:
    wrists = [pair.body.joint(name) for name in ("WristLeft", "WristRight")]
    a, b, fused = (
        np.linalg.norm(of[:, wrists[0]] - of[:, wrists[1]], axis=1) for of in (pair.a, pair.b, pair.fused)
    )
    return _share((fused < TOGETHER) & ((a > APART) | (b > APART)))


def _roughness(positions: Array) -> float:
    change = np.linalg.norm(np.diff(positions, n=2, axis=0), axis=2)
    change = change[np.isfinite(change)]
    return float(change.mean()) if change.size else np.nan


def _share(flags: NDArray[np.bool_]) -> float:
    return float(flags.mean()) if flags.size else np.nan


def _median(values: Array) -> float:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if values.size else np.nan


def truth_free_figures(session: SessionData) -> dict[str, float | None]:
    """The figures of :class:`FiguresWithoutTruth` by name, in SI; None if there is no such figure.

    ``roughness_ratio`` and the difference between robust fits of both halves of the session are added:
    ``halves_rotation_off`` in radians, ``halves_position_off`` in metres at the person.
    """
    rows = session.rows
    fits = tuple(RigidTransform(R, t) for R, t in zip(rows.rotation, rows.translation, strict=True))
    a, b = rows.positions_a.astype(np.float64), rows.positions_b.astype(np.float64)
    half = len(session) // 2
    names = [field.name for field in fields(FiguresWithoutTruth) if field.name != "frames"]
    values: dict[str, float] = {}
    with suppress(FusionError):  # too short, or the views share hardly any joint
        found = figures_without_truth(FusedPair(session.body, rows.time_ns, a, b, rows.fused, fits))
        values = {name: float(getattr(found, name)) for name in [*names, "roughness_ratio"]}
        halves = judge_registration(fit_recording(a[:half], b[:half]), a[half:], b[half:])
        values["halves_rotation_off"] = halves.rotation_off
        values["halves_position_off"] = halves.position_off
    names += ["roughness_ratio", "halves_rotation_off", "halves_position_off"]
    return {name: values[name] if np.isfinite(values.get(name, np.nan)) else None for name in names}
