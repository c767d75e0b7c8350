"""The constants of the estimator and their origin.

Two kinds of constants: trackers' errors by kind of joint (:class:`JointErrors`), and the person's motion and
the filter's behaviour (:class:`Constants`). The tables are medians over recordings, made by
``python -m tests.experiments.fit_estimator FOLDER…``. The constants were set by
hand. A coordinate search with a prototype lowered its objective by 3 % from there; only a part of its changes
was adopted. It ran over simulated recordings of both bodies (seeds 3000 and 3001), simulated ones with all
errors × 1.5 (seed 3002), real pairs (``real/``, ``_2`` and ``_14`` of ``real_more/``), and injected faults.
"""

from __future__ import annotations

from typing import NamedTuple

from fusion.body import AZURE_KINECT, BLAZEPOSE, Body
from fusion.setup import DEFAULT_SMOOTHING

FRAME_SECONDS = 1.0 / 30.0
"""The interval at which the constants that are stated for 1/30 s were fitted."""
_CALMEST = 0.03

_BY_KIND = {
    "spine": (0.0086, 0.0184, 0.0151, 0.0011, 0.0037, 0.64),
    "head": (0.0112, 0.0255, 0.0132, 0.0015, 0.0026, 0.72),
    "girdle": (0.0145, 0.0280, 0.0141, 0.0016, 0.0035, 0.79),
    "elbow": (0.0230, 0.0392, 0.0177, 0.0024, 0.0037, 1.00),
    "wrist": (0.0173, 0.0384, 0.0153, 0.0029, 0.0056, 1.12),
    "hand": (0.0193, 0.0321, 0.0130, 0.0036, 0.0048, 1.28),
    "tip": (0.0202, 0.0344, 0.0130, 0.0039, 0.0048, 1.44),
    "thumb": (0.0286, 0.0521, 0.0205, 0.0086, 0.0049, 1.90),
    "knee": (0.0119, 0.0237, 0.0076, 0.0017, 0.0033, 1.00),
    "ankle": (0.0167, 0.0199, 0.0194, 0.0015, 0.0044, 1.04),
    "foot": (0.0167, 0.0261, 0.0166, 0.0021, 0.0057, 1.30),
    "face": (0.0212, 0.0255, 0.0167, 0.0028, 0.0033, 0.87),
}
"""By kind of joint: slow errors of Azure Kinect, of Kinect v1 and v2, and of BlazePose; fast errors of
Kinects and of BlazePose; acceleration relative to an elbow's. BlazePose has no finger tips: they have the
hands' values."""


class JointErrors(NamedTuple):
    """Errors of one body tracker, by kind of joint (:mod:`fusion.joint_kinds`); metres, along one axis."""

    slow: dict[str, float]
    """Standard deviation of the error that lasts: a bias that depends on the view and the pose."""
    fast: dict[str, float]  # standard deviation of the error that changes from frame to frame

    @staticmethod
    def of(body: Body) -> JointErrors:
        """The errors of the body's own tracker.

        Azure Kinect: simulated recordings. The simulated errors were fitted to 87 real trials, which this
        repository does not contain.
        Kinect v1 and v2: ten real pairs of Kinect v2. BlazePose: tracked joints on simulated images against
        the truth, four scenes (seed 100).
        """
        if body is BLAZEPOSE:
            return JointErrors(_column(2), _column(4))
        return JointErrors(_column(0 if body is AZURE_KINECT else 1), _column(3))


def acceleration_shares() -> dict[str, float]:
    """Acceleration of each kind of joint relative to an elbow's."""
    return _column(5)


def _column(number: int) -> dict[str, float]:
    return {kind: row[number] for kind, row in _BY_KIND.items()}


class Constants(NamedTuple):
    """Constants of the filter. SI units; standard deviations along one axis."""

    slow_scale: float = 0.8  # of the slow errors of :class:`JointErrors`
    inferred_slow: float = 2.5  # how many times larger the slow error of an inferred joint is
    inferred_fast: float = 20.0
    """How many times larger its fast error counts. An inferred position keeps the same error for about half a
    second, so that its frames are not independent."""
    fast_scale: float = 2.5  # of the fast errors
    fast_by_speed: float = 0.004  # fast error added for each m/s that the joint moves, s
    near: float = 0.10
    """Distance across the ray, metres, at which a joint before this one doubles its slow variance."""
    near_power: float = 2.0  # how steeply that grows as the two come nearer
    near_limit: float = 20.0  # largest factor of that variance
    acceleration: float = 1.0
    """Standard deviation of a still elbow's mean acceleration over 1/30 s, m/s²."""
    acceleration_by_speed: float = 16.0  # what is added for each m/s, 1/s
    unseen_acceleration: float = 0.3
    """Factor on the acceleration of a joint that no view reports. With it, the distance of a limb that is
    deleted from both views of real pairs is what σ says (``tests.benchmarks.certainty``)."""
    velocity_seconds: float = 0.4  # how long a joint keeps its velocity relative to its parent's
    agreement_seconds: float = 1.0  # how long an offset between the views lasts while both see the joint
    alone_seconds: float = 0.85  # how long an offset lasts while one view sees it
    freedom: float = 3.0
    """Degrees of freedom of the t distribution of slow errors. The fewer there are, the more the views'
    difference tells of their size."""
    usual_seconds: float = 20.0  # over how long the usual offsets are averaged, to which offsets decay
    outlier: float = 0.02  # probability that a tracked joint is an outlier
    inferred_outlier: float = 0.2  # the same of an inferred joint
    outlier_lasts: float = 0.9  # probability that an outlier lasts for 1/30 s
    outlier_side: float = 0.6  # side of the cube that outliers are spread over, metres
    surface_slow: float = 2.0
    """Factor on the errors of :data:`fusion.witness.SURFACE_SD`. An image errs to the same side as long as a
    pose lasts."""
    surface_fast: float = 0.008  # fast error of the surface in a depth image, metres
    surprise: float = 0.05  # probability of a movement within 1/30 s that the prediction does not cover
    length_error: float = 0.015
    """Error of a bone's length within a view, metres, that multiplies the odds of an outlier at either of its
    ends by e."""
    length_limit: float = 4.0  # largest logarithm of that factor
    other_limb_sd: float = 0.1
    """Deviation of a joint between views that both have it right, metres."""
    other_limb_limit: float = 6.0  # largest logarithm of the odds that a joint lies on the other limb
    scale_sd: float = 0.035
    """Standard deviation of a view's scale about 1; of the body's tracker, see :meth:`of`."""
    scale_seconds: float = 0.6  # how long a scale lasts
    bone_sd: float = 0.03  # standard deviation of one bone's relative length within a view
    spread: float = 0.95
    """Factor of all reported standard deviations, of the body's tracker. ``tests.benchmarks.coverage`` shows
    how many joints lie within them."""
    bones: bool = True
    """Whether the bones are held. An ablation only: S* always has its bones."""
    heading: bool = True
    """Whether shoulders and hips are turned towards the heading. An ablation only."""

    @staticmethod
    def of(body: Body) -> Constants:
        """The constants of a body's tracker.

        ``scale_sd``: published trials of the Azure Kinect say that its whole skeleton grows and shrinks by
        2.5 to 6.5 % from frame to frame; on its simulator the scale brings 7 % of the error. On eleven real
        pairs of Kinect v2 it brings nothing (roughness 0.496 of the views' with 0.01, 0.500 with 0.035), nor
        on the simulated one.

        ``spread``: simulated recordings of seed 8101, three movements at 60° and 120°, registered and
        labelled over the whole recording.

        ``inferred_outlier``: BlazePose guesses hidden arms 100 to 250 mm off. On nine scenes of seed 100, S*
        has 33.0 mm with 0.2, 32.2 mm with 0.4 and 32.1 mm with 0.6.
        """
        if body is BLAZEPOSE:
            return Constants(scale_sd=0.01, spread=0.8, inferred_outlier=0.4)
        if body is AZURE_KINECT:
            return Constants()
        return Constants(scale_sd=0.01, spread=1.3)


def calmness(smoothing: float) -> float:
    """The factor on the acceleration's variance for a smoothing from 0 to 1.

    ``((1 - s) / s)⁴`` up to the default of 0.5, where it is 1; so large at 0 that the prediction has no
    weight and each frame is estimated on its own. Beyond, it falls evenly in its logarithm to 0.03 at 1. With
    less, S* cannot follow a person, and every other movement would count as a surprise: it was rougher, not
    smoother, and up to a metre off.
    """
    if smoothing > DEFAULT_SMOOTHING:
        return float(_CALMEST ** ((smoothing - DEFAULT_SMOOTHING) / (1.0 - DEFAULT_SMOOTHING)))
    s = max(smoothing, 1e-3)
    return float(((1.0 - s) / s) ** 4)
