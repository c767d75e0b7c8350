"""The estimator's named arrays. The fuser owns them, so that no frame allocates memory.

J is the number of joints, T that of pairs (:func:`fusion.support.array_fields.new_arrays`). Arrays of both
views have the view first: 0 is A, 1 is B.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.estimator.constants import Constants, JointErrors, acceleration_shares, calmness
from fusion.facing.model import FacingModel, FacingState
from fusion.joint_kinds import by_joint, of_kind
from fusion.rigid import NOWHERE, RigidTransform
from fusion.setup import DEFAULT_SMOOTHING
from fusion.solvers.tree_start import TreeWorkspace
from fusion.support.types import Array
from fusion.witness import JointEvidence, WitnessModel, new_witness_model

Ints = NDArray[np.int64]


class Model(NamedTuple):
    """Everything that is constant from frame to frame."""

    parents: NDArray[np.int64]  # (J,)
    order: NDArray[np.int64]  # (J,) parents before children
    rest: Array  # (J, 3)
    linked: NDArray[np.bool_]  # (J, J)
    mirror: NDArray[np.int64]  # (J,) a joint's counterpart on the other side; itself on the middle line
    limb: NDArray[np.bool_]  # (J,) joints of arms and legs beyond shoulders and hips
    slow: Array  # (J,) metres
    fast: Array  # (J,) metres
    acceleration: Array  # (J,) relative to an elbow's
    bone_lengths: Array  # (J,) metres
    rotation: Array  # (3, 3) R of a_from_b
    translation: Array  # (3,) t, which is where K_B stands
    registration_variances: Array  # (2,) of R, rad², and of R q + t at the centre, m², along an axis
    registration_centre: Array  # (3,) metres, the mean place that R and t were found from; NaN where unknown
    rotations: Array  # (2, 3, 3) from each sensor's frame to K_A's: I, and R
    translations: Array  # (2, 3) likewise: 0, and t
    witness: WitnessModel  # tables for the evidence of depth images
    calmness: float
    constants: Constants


class State(NamedTuple):
    """What the filter knows of the person.

    :func:`fusion.estimator.process.forget` makes all of it unknown: what belongs to a joint counts only where
    the joint is known, and S* of the last frame only after one.
    """

    positions: Annotated[Array, ("J", 3)]  # S*, metres, K_A's frame
    velocities: Annotated[Array, ("J", 3)]  # m/s
    variances: Annotated[Array, ("J", 3)]  # position, position with velocity, velocity; any axis
    known: Annotated[NDArray[np.bool_], ("J",)]
    offsets: Annotated[Array, (2, "J", 3)]  # lasting error of each view relative to S*, metres
    offset_variances: Annotated[Array, (2, "J")]
    displacements: Annotated[Array, (2, 3)]  # of each view's whole skeleton, metres
    difference: Annotated[Array, (3,)]  # recent mean of A's points less B's, without displacements, metres
    compared: Annotated[Array, (1,), np.inf]  # seconds since the last pair in it
    usual_offsets: Annotated[Array, (2, "J", 3)]  # mean share of each view in the views' difference, metres
    agreed: Annotated[Array, ("J",)]  # seconds that usual_offsets are means of, at most usual_seconds
    from_b: Annotated[Array, ("J",)]  # B's share of the information when a view had the joint last
    alone: Annotated[Array, (2, "J")]  # probability that the position follows this view alone
    recalibrated: Annotated[Array, (1,), np.inf]  # seconds since the calibration changed
    lag: Annotated[Array, ("J", 3)]  # what S* still has to go since the calibration changed, metres
    error_size: Annotated[Array, ("J",)]  # factor on the variance of slow errors, from the views' difference
    shared_error: Annotated[Array, ("J", 3, 3)]  # covariance of the slow error of S*, m²
    outlier_probability: Annotated[Array, (2, "J")]  # that the view's last measurement was an outlier
    view_outlier_probability: Annotated[Array, (2,)]  # its mean over the joints that the view measured
    astray: Annotated[Array, (1,)]  # seconds for which S* has been where no view sees the person
    scales: Annotated[Array, (2,)]  # scale of each view's skeleton, minus 1
    scale_variances: Annotated[Array, (2,)]
    solver_start: Annotated[Array, ("J", 3), np.nan]  # S* of the last frame, the solver's start
    last_time: Annotated[Ints, (2,)]  # of the last frame with a person, ns; 1 if there was such a frame


class LastSkeletons(NamedTuple):
    """The last skeleton that each sensor gave, whosoever it was: one that repeats it is stale."""

    positions: Annotated[NDArray[np.float32], (2, "J", 3), np.nan]  # as the sensors gave them
    states: Annotated[NDArray[np.uint8], (2, "J")]


class Views(NamedTuple):
    """Both views of one pair, as measurements."""

    reported: Annotated[Array, (2, "J", 3)]  # as the sensors gave them, in K_A's frame, metres
    reported_states: Annotated[NDArray[np.uint8], (2, "J")]
    stale: Annotated[NDArray[np.bool_], (2,)]  # whether a view repeats its last skeleton
    positions: Annotated[Array, (2, "J", 3)]  # re-labelled, with the view's scale removed
    states: Annotated[NDArray[np.uint8], (2, "J")]  # re-labelled; 0 where the view gives no measurement
    delays: Annotated[Array, (2,)]  # s, capture time minus the pair's
    codes: Annotated[Ints, (2,)]  # exchange codes; see :mod:`fusion.facing.model`
    side_doubt: Annotated[Array, (2,)]  # probability that a view's sides are still wrong
    heading: Annotated[Array, (3,), np.nan]  # see :class:`fusion.facing.labels.Labels`
    points: Annotated[NDArray[np.bool_], ("J",)]  # middles that no exchange moves and both views track
    between: Annotated[Array, (3,)]  # mean of A's points less those of B, metres
    innovations: Annotated[Array, (2, "J", 3)]  # of these points, metres
    medians: Annotated[Array, (2, 3), np.nan]  # geometric medians of these, metres
    rays: Annotated[Array, (2, "J", 3)]  # unit vectors from the sensor to the joint
    covers: Annotated[Ints, (2, "J"), -1]  # covering joint nearest in the viewing plane, or -1
    cover_distances: Annotated[Array, (2, "J")]  # its distance across the ray, metres
    slow: Annotated[Array, (2, "J", 3, 3)]  # covariance of the slow error
    fast: Annotated[Array, (2, "J")]  # variance of the fast error
    surprise: Annotated[Array, ("J",)]  # probability that both views are right and the prediction is wrong
    misled: Annotated[Array, (2, "J")]  # probability that this view alone is right, and S* follows the other
    trust: Annotated[Array, (2, "J")]  # probability that the measurement is no outlier
    log_odds: Annotated[Array, (2, "J")]  # log likelihood ratio of no outlier, by depth image and bones
    length_errors: Annotated[Array, (2, "J")]  # largest error of its bones over the expected one; or -1
    places: Annotated[Array, (2, "J", 3), np.nan]  # position by the depth image, metres; NaN without one
    place_information: Annotated[Array, (2, "J", 3, 3)]  # 1/m²
    image: JointEvidence  # of one image, with the joints as its sensor labelled them
    sources: Annotated[Ints, ("J",)]  # the reported joint of each re-labelled joint of one view


class Solve(NamedTuple):
    """Workspace of the tree solver."""

    targets: Annotated[Array, ("J", 3)]
    information: Annotated[Array, ("J", 3, 3)]
    positions: Annotated[Array, ("J", 3)]
    upward: Annotated[Array, ("J", 4)]  # message of the subtree to the parent: direction, information
    covariance: Annotated[Array, ("J", 3, 3)]
    sums: Annotated[Array, (3, 3)]
    scratch: Annotated[Array, (3, 3)]
    tree_work: TreeWorkspace


class Filter(NamedTuple):
    """All arrays of one filter."""

    model: Model
    facing_model: FacingModel
    state: State
    last: LastSkeletons
    facing: FacingState
    views: Views
    solve: Solve


class Output(NamedTuple):
    """Results of T pairs; see :class:`fusion.fused_frame.FusedFrame`."""

    positions: Annotated[Array, ("T", "J", 3)]
    predicted: Annotated[NDArray[np.bool_], ("T", "J")]
    weights_a: Annotated[Array, ("T", "J")]
    weights_b: Annotated[Array, ("T", "J")]
    misleading_joint: Annotated[Ints, ("T", "J")]
    covariance: Annotated[Array, ("T", "J", 3, 3)]
    sigma: Annotated[Array, ("T", "J")]
    velocities: Annotated[Array, ("T", "J", 3)]
    exchanged_a: Annotated[Ints, ("T",)]
    exchanged_b: Annotated[Ints, ("T",)]
    doubt_a: Annotated[Array, ("T",)]
    doubt_b: Annotated[Array, ("T",)]
    heading: Annotated[Array, ("T", 3)]
    iterations: Annotated[Ints, ("T",)]
    stale_a: Annotated[NDArray[np.bool_], ("T",)]
    stale_b: Annotated[NDArray[np.bool_], ("T",)]


def new_model(
    body: Body,
    bone_lengths: Array,
    a_from_b: RigidTransform,
    smoothing: float = DEFAULT_SMOOTHING,
    constants: Constants | None = None,
    registration_variances: tuple[float, float] = (0.0, 0.0),
    registration_centre: Array = NOWHERE,
) -> Model:
    """The model of one body and calibration."""
    errors = JointErrors.of(body)
    return Model(
        parents=body.parent_indices.copy(),
        order=body.order.copy(),
        rest=np.array(body.rest),
        linked=body.linked.copy(),
        mirror=np.array(body.mirror, dtype=np.int64),
        limb=of_kind(body, "elbow", "wrist", "hand", "tip", "thumb", "knee", "ankle", "foot"),
        slow=by_joint(body, errors.slow),
        fast=by_joint(body, errors.fast),
        acceleration=by_joint(body, acceleration_shares()),
        bone_lengths=np.array(bone_lengths, dtype=np.float64),
        rotation=np.array(a_from_b.rotation, dtype=np.float64, order="C"),
        translation=np.array(a_from_b.translation, dtype=np.float64),
        registration_variances=np.array(registration_variances, dtype=np.float64),
        registration_centre=np.array(registration_centre, dtype=np.float64),
        rotations=np.array((np.eye(3), a_from_b.rotation), dtype=np.float64),
        translations=np.array((np.zeros(3), a_from_b.translation), dtype=np.float64),
        witness=new_witness_model(body),
        calmness=calmness(smoothing),
        constants=constants or Constants.of(body),
    )
