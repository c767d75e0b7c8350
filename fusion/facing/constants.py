"""The constants of the facing model and their origin.

Distances are metres, angles radians, times seconds. A table has one value for each of five angles between the
person's front and the direction to the sensor: cosine 1 (front), ½, 0 (profile), −½, −1 (back); between them
it is interpolated linearly in the cosine.
"""

from __future__ import annotations

from dataclasses import dataclass

from fusion.body import AZURE_KINECT, BLAZEPOSE, Body

Table = tuple[float, float, float, float, float]


@dataclass(frozen=True)
class FacingConstants:
    """What the hidden Markov model of :mod:`fusion.facing` assumes about people and trackers.

    The cues' tables were measured on real walks and steps before two Kinects v2 (three people, 11 pairs) by
    ``python -m tests.experiments.facing FOLDER… --tables``; the axes' table is the same for fronts and backs,
    so that a precise axis does not argue for a front. The head's deviations also contain the bias that a view
    keeps through a recording, with a standard deviation of 26 mm between simulated recordings (Kinect v2,
    seeds 12–31): without it, a head that seems to lie behind the neck outweighs all other cues. The other
    constants were chosen on the five walks among the pairs and on simulated recordings (seed 4000) by
    ``python -m tests.experiments.facing FOLDER… --search``. The result depends weakly on them: a factor of
    two in any one weight moves the share of wrong frames by about a percentage point.

    Successive frames repeat the same error, so a frame's log-likelihood counts only in part. The *weights*
    are the share that is independent of earlier frames.

    Attributes:
        axis_sigma: Standard deviation of the heading that a tracker's shoulders or hips show.
        axis_floor: Largest cost of an axis that is an outlier, in log density.
        axis_weight: Weight of an axis in one frame.
        knee_mean, knee_sigma: Distance of a knee in front of the line from hip to ankle.
        elbow_mean, elbow_sigma: Distance of an elbow behind the line from shoulder to wrist.
        head_mean, head_sigma: Distance of the head in front of the neck.
        cue_floor: Largest cost of a cue that is an outlier.
        bent_floor: Largest cost of a knee that lies farther in front than the mean: lunges and squats bend
            knees much farther than walking does, but no knee bends backwards.
        cue_weight: Weight of a cue in one frame of a person who moves.
        inferred_weight: Factor on the evidence of joints that the tracker infers.
        moving_speed: Mean speed of the joints above which frames count in full, m/s. A posture that is
            held shows the same error in every frame.
        still_weight: Factor while the person stands still.
        motion_weight: Log-likelihood per frame, over the squared speed in m²/s², of moving forwards.
        motion_cap: Speed above which motion counts no more than at this speed, m/s.
        motion_seconds: Time constant of the low-pass filter of the trunk's velocity.
        mirrored_front, mirrored_back: Share of frames that a tracker reports mirrored, facing it and with
            the back turned.
        mirrored_centre, mirrored_width: Cosine at which that share is half-way, and the width of the step.
        mirrored_seconds: Time constant with which that share is reached.
        turning_sigma: Standard deviation of a turn in 1/30 s, of a person who stands or walks straight ahead.
        turning_sigma_fast: The same for a person who turns.
        turning_share: Share of frames in which a person turns.
        continuity: Weight of the agreement of labels with the previous frame, 1/m²; see ``continuity.py``.
        limb_seconds, limb_share: Time constant of arms alone or legs alone exchanged, and their share.
        knee_apart, elbow_apart: Mean and standard deviation of the left knee's (elbow's) distance to the left
            of the right one.
        span_sigma: Standard deviation of the difference between the views of a vector from a right joint
            to its left one.
        limb_weight: Weight of a frame's evidence on limbs.
        leak: Lower limit of the probability of every state, so that no state becomes impossible.
        change_from: Probability above which a different exchange is adopted.
    """

    axis_sigma: Table = (0.19, 0.41, 0.84, 0.41, 0.19)
    axis_floor: float = 4.0
    axis_weight: float = 0.4
    knee_mean: Table = (0.026, 0.027, 0.028, 0.026, 0.031)
    knee_sigma: Table = (0.039, 0.043, 0.060, 0.057, 0.052)
    elbow_mean: Table = (0.052, 0.045, 0.033, 0.029, 0.029)
    elbow_sigma: Table = (0.022, 0.027, 0.029, 0.033, 0.030)
    head_mean: Table = (0.041, 0.050, 0.050, 0.047, 0.048)
    head_sigma: Table = (0.033, 0.034, 0.034, 0.037, 0.035)
    cue_floor: float = 6.0
    bent_floor: float = 1.0
    cue_weight: float = 0.14
    inferred_weight: float = 0.25
    moving_speed: float = 0.4
    still_weight: float = 0.12
    motion_weight: float = 0.55
    motion_cap: float = 1.2
    motion_seconds: float = 0.15
    mirrored_front: float = 0.005
    mirrored_back: float = 0.97
    mirrored_centre: float = -0.36
    mirrored_width: float = 0.25
    mirrored_seconds: float = 0.12
    turning_sigma: float = 0.052
    turning_sigma_fast: float = 0.23
    turning_share: float = 0.6
    continuity: float = 100.0
    limb_seconds: float = 0.3
    limb_share: float = 0.003
    knee_apart: tuple[float, float] = (0.17, 0.09)
    elbow_apart: tuple[float, float] = (0.42, 0.14)
    span_sigma: float = 0.15
    limb_weight: float = 0.15
    leak: float = 1e-9
    change_from: float = 0.5

    @staticmethod
    def of(body: Body) -> FacingConstants:
        """The constants of a body's tracker.

        No recording with turned backs is available for the Azure Kinect. Its share of mirrored frames is
        assumed: smaller than the Kinect v2's, so that the evidence decides. BlazePose's share was measured on
        the tracker itself on simulated images (seed 100): 12 %. The cues' tables are the Kinect v2's.
        """
        if body is BLAZEPOSE:
            return FacingConstants(mirrored_back=0.12)
        if body is AZURE_KINECT:
            return FacingConstants(mirrored_back=0.4)
        return FacingConstants()
