"""The facing filter's model of a body, and its state between two frames."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.facing.constants import FacingConstants

HEADINGS = 36
"""Headings are the multiples of 10° in the horizontal plane."""
TAPS = 6
"""The largest turn between two frames, in headings."""
ARMS, LEGS, WHOLE = 1, 2, 3
"""Exchange codes: a bit for the arms, a bit for the legs, both for the whole body."""
TRUNK = 4
"""Added to a code if the trunk differs from it: LEGS + TRUNK exchanges legs and trunk,
WHOLE + TRUNK arms and legs without the trunk. The trunk is shoulders, hips and face."""
DOUBT_BIT, DOUBT_STEPS = 8, 255
"""A label is an exchange code and, in the bits from DOUBT_BIT on, the doubt about it in 1/DOUBT_STEPS."""
SHOULDER, HIP, ELBOW, WRIST, KNEE, ANKLE = range(6)
"""The pairs of joints that evidence comes from, as rows of ``FacingModel.pairs``."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Scalars(NamedTuple):
    """The scalar constants; their meaning is that of :class:`fusion.facing.constants.FacingConstants`."""

    axis_floor: float
    axis_weight: float
    cue_floor: float
    bent_floor: float
    cue_weight: float
    inferred_weight: float
    moving_speed: float
    still_weight: float
    motion_weight: float
    motion_cap: float
    motion_seconds: float
    mirrored_front: float
    mirrored_back: float
    mirrored_centre: float
    mirrored_width: float
    mirrored_seconds: float
    turning_sigma: float
    turning_sigma_fast: float
    turning_share: float
    continuity: float
    limb_seconds: float
    limb_share: float
    span_sigma: float
    limb_weight: float
    leak: float
    change_from: float


class FacingModel(NamedTuple):
    """The joints and constants of one body; it does not change from frame to frame."""

    pairs: Ints  # (6, 2) left and right joint of SHOULDER … ANKLE
    head: Ints  # (2,) the head, and the joint that it sits on
    mirror: Ints  # (J,)
    limb: Ints  # (J,) the bit that exchanges the joint; 0 on the middle line
    girdle: Bools  # (J,) shoulders and hips
    face: Bools  # (J,) eyes and ears
    believed: Bools  # (J,) joints that a tracker places by the assumed heading
    widths: Floats  # (2,) between the shoulders, between the hips
    axis_kappa: Floats  # (5,) 1/σ²
    cue_mean: Floats  # (3, 5) knee, elbow, head
    cue_sigma: Floats  # (3, 5)
    cue_log: Floats  # (3, 5) log σ
    apart: Floats  # (2, 2) elbows and knees: mean and standard deviation of their lateral distance
    scalars: Scalars


class FacingState(NamedTuple):
    """The state between two frames, the results, and workspace.

    ``codes``, ``probability``, ``facing``, ``confidence`` and ``doubt`` are the results for the last frame:

    * codes (2,): the exchange code of A and of B.
    * probability (2, 4): of each code of each view.
    * facing (3,): horizontal unit vector in which the person faces, in K_A's frame.
    * confidence (1,): length of the mean of the unit vectors of all headings under their probabilities.
    * doubt (2,): for each view, the probability that another whole-body label is right, or that its
      shoulder and hip axes contradict the heading because the tracker is changing over.
    """

    codes: Ints
    probability: Floats
    facing: Floats
    confidence: Floats
    doubt: Floats
    belief: Floats  # (N, 2, 2) of heading, A mirrored, B mirrored
    predicted: Floats  # (N, 2, 2) workspace
    limb_belief: Floats  # (2, 2, 2) of ARMS and LEGS: exchanged in A, in B
    limb_room: Floats  # (2, 2)
    likelihood: Floats  # (N, 2, 2) log-likelihood of the frame
    headings: Floats  # (N, 3) unit vectors
    frame_up: Floats  # (3,) up direction of the headings
    up: Floats  # (3,) learned from the person
    turning: Floats  # (2 TAPS + 1,)
    whole: Ints  # (2,) whether the whole body is taken as mirrored
    mirrored: Floats  # (2,) its probability
    up_frames: Floats  # (1,) number of frames from which `up` was learned
    shares: Floats  # (2, N) of mirrored frames, by heading
    reach: Ints  # (1,) how many headings `turning` reaches to either side
    rates: Floats  # (2,) of exchanging in this frame; 0 for a stale view
    odds: Floats  # (2,) factor on the odds of an exchange, from continuity
    axes: Floats  # (2, 2, 3) view; shoulders, hips: horizontal direction that they say the person faces
    axis_trust: Floats  # (2, 2)
    cues: Floats  # (2, 5, 3) view; knees, elbows, head
    cue_trust: Floats  # (2, 5)
    spans: Floats  # (2, 6, 3) from the right to the left joint of each pair
    last_spans: Floats  # (2, 6, 3) as reported
    last_joints: Floats  # (2, J, 3)
    last_root: Floats  # (2, 3)
    since: Floats  # (2,) seconds since a view's last fresh skeleton
    speed: Floats  # (2,) mean speed of the joints, low-passed
    velocity: Floats  # (3,) of the trunk, low-passed
    pull: Floats  # (2, 3) change by each view in this frame
    toward: Floats  # (2, 3) horizontal unit vectors from the person to the sensors
    started: Ints  # (1,)


def new_facing_model(body: Body, constants: FacingConstants | None = None) -> FacingModel:
    """The model of one body; the body's own constants where none are given."""
    c = constants or FacingConstants.of(body)
    names = ("Shoulder", "Hip", "Elbow", "Wrist", "Knee", "Ankle")
    pairs = [[body.joint(f"{name}{side}") for side in ("Left", "Right")] for name in names]
    base = body.find("Neck")
    plain = [name.replace("_", "").lower() for name in body.joints]

    def named(*parts: str) -> Bools:
        return np.array([any(part in name for part in parts) for name in plain])

    lateral = body.mirror != np.arange(len(body))
    legs = lateral & named("hip", "knee", "ankle", "foot", "heel")
    lengths = body.nominal_lengths
    clavicles = sum(
        lengths[j] for j in (body.find("ClavicleLeft"), body.joint("ShoulderLeft")) if j is not None
    )
    sigma = np.array((c.knee_sigma, c.elbow_sigma, c.head_sigma))
    return FacingModel(
        pairs=np.array(pairs, dtype=np.int64),
        head=np.array([body.joint("Head"), body.joint("ShoulderCenter") if base is None else base]),
        mirror=body.mirror,
        limb=np.where(legs, LEGS, np.where(lateral, ARMS, 0)).astype(np.int64),
        girdle=lateral & named("clavicle", "shoulder", "hip"),
        face=lateral & named("eye", "ear"),
        believed=named("foot", "heel", "thumb", "nose", "eye", "ear"),
        widths=np.array([2.0 * clavicles, 2.0 * lengths[body.joint("HipLeft")]]),
        axis_kappa=np.array(c.axis_sigma) ** -2.0,
        cue_mean=np.array((c.knee_mean, c.elbow_mean, c.head_mean)),
        cue_sigma=sigma,
        cue_log=np.log(sigma),
        apart=np.array((c.elbow_apart, c.knee_apart)),
        scalars=Scalars(*(float(getattr(c, name)) for name in Scalars._fields)),
    )


def new_facing_state(body: Body) -> FacingState:
    """The state before the first frame, with equal probability for every heading."""
    n, joints = HEADINGS, len(body)
    return FacingState(
        codes=np.zeros(2, dtype=np.int64),
        probability=np.zeros((2, 4)),
        facing=np.full(3, np.nan),
        confidence=np.zeros(1),
        doubt=np.zeros(2),
        belief=np.zeros((n, 2, 2)),
        predicted=np.zeros((n, 2, 2)),
        limb_belief=np.zeros((2, 2, 2)),
        limb_room=np.zeros((2, 2)),
        likelihood=np.zeros((n, 2, 2)),
        headings=np.zeros((n, 3)),
        frame_up=np.full(3, np.nan),
        up=np.array((0.0, -1.0, 0.0)),
        turning=np.zeros(2 * TAPS + 1),
        whole=np.zeros(2, dtype=np.int64),
        mirrored=np.zeros(2),
        up_frames=np.zeros(1),
        shares=np.zeros((2, n)),
        reach=np.zeros(1, dtype=np.int64),
        rates=np.zeros(2),
        odds=np.ones(2),
        axes=np.zeros((2, 2, 3)),
        axis_trust=np.zeros((2, 2)),
        cues=np.zeros((2, 5, 3)),
        cue_trust=np.zeros((2, 5)),
        spans=np.full((2, 6, 3), np.nan),
        last_spans=np.full((2, 6, 3), np.nan),
        last_joints=np.full((2, joints, 3), np.nan),
        last_root=np.full((2, 3), np.nan),
        since=np.zeros(2),
        speed=np.zeros(2),
        velocity=np.zeros(3),
        pull=np.zeros((2, 3)),
        toward=np.zeros((2, 3)),
        started=np.zeros(1, dtype=np.int64),
    )
