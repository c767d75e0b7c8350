"""The facing filter's constants and their origin, its model of a body, and its state between two frames."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import AZURE_KINECT, BLAZEPOSE, Body
from fusion.joint_kinds import ARM, LEG, limbs, of_kind

HEADINGS = 36
"""Headings are the multiples of 10° in the plane normal to the body's axis."""
TAPS = 17
"""The largest turn between two frames, in headings: nearly half a circle."""
FRAME_SECONDS = 1.0 / 30.0
"""The interval at which the weights of a frame were fitted."""
FORGET_NS = 1_000_000_000
"""After this time without a person the filters start again."""
ARMS, LEGS, WHOLE = ARM, LEG, ARM + LEG
"""Exchange codes: a bit for the arms, a bit for the legs, both for the whole body. The filter finds 0 or
WHOLE; sessions of version 1.0 and earlier also contain arms or legs alone."""
TRUNK = 4
"""Added to a code of such a session if the trunk differs from it: LEGS + TRUNK exchanges legs and trunk,
WHOLE + TRUNK arms and legs without the trunk. The trunk is shoulders, hips and face."""
SHOULDER, HIP, ELBOW, WRIST, KNEE, ANKLE = range(6)
"""The pairs of joints that evidence comes from, as rows of ``FacingModel.pairs``."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Table = tuple[float, float, float, float, float]


class FacingConstants(NamedTuple):
    """What the hidden Markov model of :mod:`fusion.facing` assumes about people and trackers.

    Distances are metres, angles radians, times seconds. A table has one value for each of five angles between
    the person's front and the direction to the sensor: cosine 1 (front), ½, 0 (profile), −½, −1 (back);
    between them it is interpolated linearly in the cosine.

    The cues' tables were measured on real walks and steps before two Kinects v2 (three people, 11 pairs) by
    ``python -m tests.experiments.facing FOLDER…``; the axes' table is the same for fronts and backs,
    so that a precise axis does not argue for a front. The head's deviations also contain the bias that a view
    keeps through a recording, with a standard deviation of 26 mm between simulated recordings (Kinect v2,
    seeds 12–31): without it, a head that seems to lie behind the neck outweighs all other cues. The other
    constants were chosen by a random search on the five walks among the pairs and on simulated recordings
    (seed 4000). The result depends weakly on them: a factor of two in any one weight moves the share of wrong
    frames by about a percentage point.

    Successive frames repeat the same error, so a frame's log-likelihood counts only in part. The *weights*
    are the share that is independent of earlier frames, for frames that are 1/30 s apart; of frames that are
    farther apart a larger share is, in proportion to the interval, up to 1.
    """

    axis_sigma: Table = (0.19, 0.41, 0.84, 0.41, 0.19)
    """Standard deviation of the heading that a tracker's shoulders or hips show."""
    axis_floor: float = 4.0  # largest cost of an axis that is an outlier, in log density
    axis_weight: float = 0.4  # weight of an axis in a frame
    axis_bias: Table = (0.0, 0.0, 0.0, 0.0, 0.0)
    """Standard deviation of an axis's error that lasts as long as the pose; 0: shoulders and hips stay as
    reported (:func:`fusion.estimator.measurements.heading.turn_girdles`)."""
    reported_angle: Table = (0.0, 60.0, 90.0, 120.0, 180.0)
    """Angle to the sensor that shoulders and hips show, degrees."""
    unbiased: float = 1.0  # probability that an axis nevertheless shows the true angle
    folded: float = 0.0
    """Share of mirrored views whose axis is the true one reflected to the sensor's side; 0 also means that
    every axis shows the true angle."""
    knee_mean: Table = (0.026, 0.027, 0.028, 0.026, 0.031)
    knee_sigma: Table = (0.039, 0.043, 0.060, 0.057, 0.052)
    """Distance of a knee in front of the line from hip to ankle."""
    elbow_mean: Table = (0.052, 0.045, 0.033, 0.029, 0.029)
    elbow_sigma: Table = (0.022, 0.027, 0.029, 0.033, 0.030)
    """Distance of an elbow behind the line from shoulder to wrist."""
    head_mean: Table = (0.041, 0.050, 0.050, 0.047, 0.048)  # distance of the head in front of the neck
    head_sigma: Table = (0.033, 0.034, 0.034, 0.037, 0.035)
    cue_floor: float = 6.0  # largest cost of a cue that is an outlier
    bent_floor: float = 1.0
    """Largest cost of a knee that lies farther in front than the mean: lunges and squats bend knees much
    farther than walking does, but no knee bends backwards."""
    cue_weight: float = 0.14  # weight of a cue in a frame of a person who moves
    inferred_weight: float = 0.25  # factor on the evidence of joints that the tracker infers
    moving_speed: float = 0.4
    """Mean speed of the joints above which frames count in full, m/s. A posture that is held shows the same
    error in every frame."""
    still_weight: float = 0.12  # factor while the person stands still
    motion_weight: float = 0.7
    """Log-likelihood per 1/30 s, over the fourth power of the speed in m⁴/s⁴, of moving forwards."""
    motion_cap: float = 1.2  # speed above which motion counts no more than at this speed, m/s
    motion_seconds: float = 0.15  # time constant of the low-pass filter of the trunk's velocity
    mirrored_front: float = 0.005
    mirrored_back: float = 0.97
    """Share of frames that a tracker reports mirrored, facing it and with the back turned."""
    mirrored_centre: float = -0.36  # cosine at which that share is half-way; the width of the step
    mirrored_width: float = 0.25
    mirrored_seconds: float = 0.12  # time constant with which that share is reached
    turning_sigma: float = 0.052
    """Standard deviation of a turn in 1/30 s, of a person who stands or walks straight ahead."""
    turning_sigma_fast: float = 0.23  # the same for a person who turns
    turning_share: float = 0.6  # share of frames in which a person turns
    continuity: float = 100.0
    """Weight of the agreement of labels with the previous frame, 1/m²; see
    :func:`fusion.facing.evidence.exchange_odds`."""
    limb_sigma: float = 0.1  # deviation of an elbow or knee between the views along one axis, metres
    limb_floor: float = 4.0  # largest cost of an elbow or knee in another place, in log density
    limb_weight: float = 0.05  # weight of elbows and knees in a frame
    leak: float = 1e-9  # lower limit of the probability of every state, so that no state becomes impossible
    change_from: float = 0.5  # probability above which a different exchange is adopted

    @staticmethod
    def of(body: Body) -> FacingConstants:
        """The constants of a body's tracker.

        Three Azure Kinects around a man in a T-pose who turned mirrored none of 300 skeletons. Their share is
        larger here, so that the evidence decides if one does. BlazePose's share was measured on the tracker
        itself on simulated images (seed 100): 12 %. The cues' tables are the Kinect v2's.

        Kinect v1 and v2: the reported angles are medians over the straight parts of real walks, against the
        path. The weights and ``axis_bias`` were chosen on five real walks (``real/``, ``_2``
        and ``_14`` of ``real_more/``) and on simulated recordings (seeds 4000, 4001, 7500 and 7501). With a
        larger ``motion_weight``, simulated people who walk backwards at 0.75 m/s are turned.
        """
        if body is BLAZEPOSE:
            return FacingConstants(mirrored_back=0.12)
        if body is AZURE_KINECT:
            return FacingConstants(mirrored_back=0.4)
        return FacingConstants(
            axis_weight=0.2,
            axis_bias=(0.5, 1.0, 2.0, 2.0, 2.0),
            reported_angle=(0.0, 46.0, 59.0, 68.0, 80.0),
            unbiased=0.2,
            folded=0.5,
            motion_weight=1.4,
        )


class FacingModel(NamedTuple):
    """The joints and constants of one body; it does not change from frame to frame."""

    pairs: Ints  # (6, 2) left and right joint of SHOULDER … ANKLE
    head: Ints  # (2,) the head, and the joint that it sits on
    mirror: Ints  # (J,)
    limb: Ints  # (J,) the bit that exchanges the joint; 0 on the middle line
    girdle: Bools  # (J,) shoulders and hips
    face: Bools  # (J,) eyes and ears
    heading_placed: Bools  # (J,) joints that a tracker places by the heading that it assumes
    widths: Floats  # (2,) between the shoulders, between the hips
    axis_kappa: Floats  # (5,) 1/σ²
    reported_angle: Floats  # (5,) radians
    cue_mean: Floats  # (3, 5) knee, elbow, head
    cue_sigma: Floats  # (3, 5)
    cue_log: Floats  # (3, 5) log σ
    constants: FacingConstants


class ReportedPair(NamedTuple):
    """One pair as the filter sees it; the view comes first."""

    positions: Floats  # (2, J, 3) metres, K_A's frame, as reported; NaN where not tracked
    states: NDArray[np.uint8]  # (2, J) uint8 tracking states
    stale: Bools  # (2,) whether the view repeats its last skeleton or has none, and so is no evidence
    sensor_b: Floats  # (3,) position of K_B in K_A's frame: t of the registration


class Evidence(NamedTuple):
    """What a pair says.

    Axes, cues and spans of a stale view stay those of its last fresh skeleton. They are no likelihood, but
    :func:`fusion.facing.filter.decide` reads its axes.
    """

    axes: Annotated[Floats, (2, 2, 3)]  # view; shoulders, hips: direction that they face, normal to the axis
    axis_trust: Annotated[Floats, (2, 2)]
    cues: Annotated[Floats, (2, 5, 3)]  # view; knees, elbows, head
    cue_trust: Annotated[Floats, (2, 5)]
    spans: Annotated[Floats, (2, 6, 3), np.nan]  # from the right to the left joint of each pair
    frames: Annotated[Floats, (3,)]
    """In 1/30 s: since the last fresh skeleton of A, of B (kept while stale); since the last pair."""
    velocity_change: Annotated[Floats, (2, 3)]  # of the trunk, by each view
    toward: Annotated[Floats, (2, 3)]  # unit vectors from the person to the sensors, normal to the axis
    axis_seen: Annotated[Floats, (3,)]  # the views' sum of unit vectors along the body, then the new axis
    likelihood: Annotated[Floats, (HEADINGS, 2, 2)]  # log-likelihood
    turning: Annotated[Floats, (2 * TAPS + 1,)]  # P(θ' | θ), by difference
    reach: Annotated[Ints, (1,)]  # how many headings `turning` reaches to either side
    shares: Annotated[Floats, (2, HEADINGS)]  # of mirrored frames, by heading
    rates: Annotated[Floats, (2,)]  # of exchanging; 0 for a stale view
    odds: Annotated[Floats, (2,), 1]  # factor on the odds of an exchange, from continuity


class Belief(NamedTuple):
    """Probabilities of heading, A mirrored, B mirrored."""

    probabilities: Annotated[Floats, (HEADINGS, 2, 2)]  # after the pair's evidence
    predicted: Annotated[Floats, (HEADINGS, 2, 2)]  # before it
    labels: Annotated[Floats, (2, 2)]  # P(A mirrored, B mirrored): the probabilities summed over the headings
    whole: Annotated[Ints, (2,)]  # the labels chosen: whether the whole body is taken as mirrored
    started: Annotated[Ints, (1,)]  # 0 before the person's first pair


class Memory(NamedTuple):
    """What is kept of earlier pairs."""

    last_spans: Annotated[Floats, (2, 6, 3), np.nan]  # as reported
    last_joints: Annotated[Floats, (2, "J", 3), np.nan]
    last_root: Annotated[Floats, (2, 3), np.nan]
    since: Annotated[Floats, (2,), FRAME_SECONDS]  # seconds since a view's last fresh skeleton
    speed: Annotated[Floats, (2,)]  # mean speed of the joints, low-passed
    velocity: Annotated[Floats, (3,)]  # of the trunk, low-passed
    axis: Annotated[Floats, (3,), np.nan]  # of the body: unit vector from the ankles to the shoulders
    axis_velocity: Annotated[Floats, (3,)]  # 1/s, averaged
    headings: Annotated[Floats, (HEADINGS, 3)]  # unit vectors


class Result(NamedTuple):
    """The results for the last pair."""

    codes: Annotated[Ints, (2,)]  # the exchange code of A and of B
    facing: Annotated[Floats, (3,), np.nan]  # unit vector in which the person faces, normal to the axis
    confidence: Annotated[Floats, (1,)]
    """Length of the mean of the unit vectors of all headings under their probabilities."""
    doubt: Annotated[Floats, (2,)]
    """Probability that another whole-body label is right, or that a view's shoulder and hip axes contradict
    the heading because the tracker is changing over."""
    mirrored: Annotated[Floats, (2,)]  # probability that a view reports the whole body mirrored


class FacingState(NamedTuple):
    """The filter's arrays; :func:`fusion.facing.filter.forget_facing` resets what is known of a person."""

    evidence: Evidence
    belief: Belief
    memory: Memory
    result: Result


def new_facing_model(body: Body, constants: FacingConstants | None = None) -> FacingModel:
    """The model of one body; the body's own constants where none are given."""
    c = constants or FacingConstants.of(body)
    names = ("Shoulder", "Hip", "Elbow", "Wrist", "Knee", "Ankle")
    pairs = [[body.joint(f"{name}{side}") for side in ("Left", "Right")] for name in names]
    base = body.find("Neck")
    lengths = body.nominal_lengths
    clavicles = sum(
        lengths[j] for j in (body.find("ClavicleLeft"), body.joint("ShoulderLeft")) if j is not None
    )
    sigma = np.array((c.knee_sigma, c.elbow_sigma, c.head_sigma))
    return FacingModel(
        pairs=np.array(pairs, dtype=np.int64),
        head=np.array([body.joint("Head"), body.joint("ShoulderCenter") if base is None else base]),
        mirror=body.mirror.copy(),
        limb=limbs(body).copy(),
        girdle=of_kind(body, "girdle") & body.sided,
        face=of_kind(body, "face") & body.sided,
        heading_placed=of_kind(body, "foot", "thumb", "face"),
        widths=np.array([2.0 * clavicles, 2.0 * lengths[body.joint("HipLeft")]]),
        axis_kappa=np.array(c.axis_sigma) ** -2.0,
        reported_angle=np.radians(c.reported_angle),
        cue_mean=np.array((c.knee_mean, c.elbow_mean, c.head_mean)),
        cue_sigma=sigma,
        cue_log=np.log(sigma),
        constants=c,
    )
