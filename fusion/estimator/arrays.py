"""The estimator's named arrays. The fuser owns them, so that no frame allocates memory.

J is the number of joints. Arrays of both views have the view first: 0 is A, 1 is B.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.estimator.constants import Constants, JointErrors, acceleration_shares, calmness
from fusion.facing.model import FacingModel, FacingState
from fusion.joint_kinds import by_joint
from fusion.rigid import RigidTransform
from fusion.setup import DEFAULT_SMOOTHING
from fusion.solvers.tree_start import TreeWorkspace, new_tree_workspace
from fusion.witness import JointEvidence, WitnessModel, new_joint_evidence, new_witness_model

Array = NDArray[np.float64]


class Model(NamedTuple):
    """Everything that is constant from frame to frame."""

    parents: NDArray[np.int64]  # (J,)
    order: NDArray[np.int64]  # (J,) parents before children
    rest: Array  # (J, 3)
    linked: NDArray[np.bool_]  # (J, J)
    lateral: NDArray[np.bool_]  # (J,) whether a joint has a counterpart on the other side
    hinges: NDArray[np.int64]  # (4, 3) near end, hinge, far end: both knees, both elbows
    bends: Array  # (4,) 1 where the hinge lies before the line of its ends, -1 behind
    sides: NDArray[np.int64]  # (4,) left and right hip, left and right shoulder
    slow: Array  # (J,) metres
    fast: Array  # (J,) metres
    acceleration: Array  # (J,) relative to an elbow's
    bone_lengths: Array  # (J,) metres
    rotation: Array  # (3, 3) R of a_from_b
    translation: Array  # (3,) t, which is where K_B stands
    rotations: Array  # (2, 3, 3) from each sensor's frame to K_A's: I, and R
    translations: Array  # (2, 3) likewise: 0, and t
    witness: WitnessModel  # tables for the evidence of depth images
    up: Array  # (3,) against gravity in K_A's frame; NaN where it is learned from the person
    calmness: float
    constants: Constants


class State(NamedTuple):
    """The filter's state between two frames."""

    positions: Array  # (J, 3) S*, metres, K_A's frame
    velocities: Array  # (J, 3) m/s
    variances: Array  # (J, 3) of position, of position with velocity, of velocity; along any axis
    known: NDArray[np.bool_]  # (J,)
    offsets: Array  # (2, J, 3) lasting error of each view relative to S*, metres
    offset_variances: Array  # (2, J)
    usual_offsets: Array  # (2, J, 3) mean share of each view in the views' difference, metres
    agreed: Array  # (J,) seconds that these are means of, at most usual_seconds
    shared_error: Array  # (J, 3, 3) covariance of the slow error of S*, m²
    doubt: Array  # (2, J) probability that the view's last measurement was an outlier
    view_doubt: Array  # (2,) its mean over the joints that the view measured
    scales: Array  # (2,) scale of each view's skeleton, minus 1
    scale_variances: Array  # (2,)
    before: Array  # (J, 3) S* of the last frame, the solver's start
    clock: NDArray[np.int64]  # (2,) time of the last frame with a person, ns; 1 if there was such a frame
    last_positions: NDArray[np.float32]  # (2, J, 3) as the sensors gave them
    last_states: NDArray[np.uint8]  # (2, J)


class Views(NamedTuple):
    """Both views of one pair, as measurements."""

    reported: Array  # (2, J, 3) as the sensors gave them, in K_A's frame, metres
    reported_states: NDArray[np.uint8]  # (2, J)
    stale: NDArray[np.bool_]  # (2,) whether a view repeats its last skeleton
    positions: Array  # (2, J, 3) re-labelled, with the view's scale removed
    states: NDArray[np.uint8]  # (2, J) re-labelled; 0 where the view gives no measurement
    delays: Array  # (2,) s, capture time minus the pair's
    codes: NDArray[np.int64]  # (2,) exchange codes; see :mod:`fusion.facing.model`
    side_doubt: Array  # (2,) probability that a view's sides are still wrong
    rays: Array  # (2, J, 3) unit vectors from the sensor to the joint
    covers: NDArray[np.int64]  # (2, J) covering joint nearest in the viewing plane, or -1
    cover_distances: Array  # (2, J) its distance across the ray, metres
    slow: Array  # (2, J, 3, 3) covariance of the slow error
    fast: Array  # (2, J) variance of the fast error
    surprise: Array  # (J,) probability that both views are right and the prediction is wrong
    trust: Array  # (2, J) probability that the measurement is no outlier
    evidence: Array  # (2, J) log likelihood ratio that the joint is no outlier, by depth image and bones
    length_errors: Array  # (2, J) largest error of a bone at the joint over the expected one; -1 without any
    places: Array  # (2, J, 3) position by the depth image, metres; NaN without one
    place_information: Array  # (2, J, 3, 3) 1/m²
    image: JointEvidence  # of one image, with the joints as its sensor labelled them
    sources: NDArray[np.int64]  # (J,) the reported joint of each re-labelled joint of one view


class Solve(NamedTuple):
    """Workspace of the tree solver."""

    targets: Array  # (J, 3)
    information: Array  # (J, 3, 3)
    positions: Array  # (J, 3)
    upward: Array  # (J, 4) message of a joint's subtree to its parent: direction, information along it
    covariance: Array  # (J, 3, 3)
    sums: Array  # (3, 3)
    scratch: Array  # (3, 3)
    tree_work: TreeWorkspace


class Filter(NamedTuple):
    """All arrays of one filter."""

    model: Model
    facing_model: FacingModel
    state: State
    facing: FacingState
    views: Views
    solve: Solve


class Output(NamedTuple):
    """Results of T pairs; see :class:`fusion.fused_frame.FusedFrame`."""

    positions: Array  # (T, J, 3)
    predicted: NDArray[np.bool_]  # (T, J)
    weights_a: Array  # (T, J)
    weights_b: Array  # (T, J)
    misleading: NDArray[np.int64]  # (T, J)
    covariance: Array  # (T, J, 3, 3)
    sigma: Array  # (T, J)
    velocities: Array  # (T, J, 3)
    codes: NDArray[np.int64]  # (T, 2)
    side_doubt: Array  # (T, 2)
    counts: NDArray[np.int64]  # (T, 3) iterations, stale A, stale B


_LIMBS = (("Hip", "Knee", "Ankle"), ("Shoulder", "Elbow", "Wrist"))


def new_model(
    body: Body,
    bone_lengths: Array,
    a_from_b: RigidTransform,
    smoothing: float = DEFAULT_SMOOTHING,
    constants: Constants | None = None,
) -> Model:
    """The model of one body and calibration."""
    errors = JointErrors.of(body)
    return Model(
        parents=body.parent_indices,
        order=body.order,
        rest=np.ascontiguousarray(body.rest),
        linked=body.linked,
        lateral=body.mirror != np.arange(len(body)),
        hinges=np.array(
            [[body.joint(joint + side) for joint in limb] for limb in _LIMBS for side in ("Left", "Right")],
            dtype=np.int64,
        ),
        bends=np.array([1.0, 1.0, -1.0, -1.0]),
        sides=np.array(
            [body.joint(j) for j in ("HipLeft", "HipRight", "ShoulderLeft", "ShoulderRight")], dtype=np.int64
        ),
        slow=by_joint(body, errors.slow),
        fast=by_joint(body, errors.fast),
        acceleration=by_joint(body, acceleration_shares()),
        bone_lengths=np.array(bone_lengths, dtype=np.float64),
        rotation=np.array(a_from_b.rotation, dtype=np.float64),
        translation=np.array(a_from_b.translation, dtype=np.float64),
        rotations=np.array((np.eye(3), a_from_b.rotation), dtype=np.float64),
        translations=np.array((np.zeros(3), a_from_b.translation), dtype=np.float64),
        witness=new_witness_model(body),
        up=np.full(3, np.nan),
        calmness=calmness(smoothing),
        constants=constants or Constants.of(body),
    )


def new_state(joints: int) -> State:
    """The state before the first frame."""
    return State(
        positions=np.zeros((joints, 3)),
        velocities=np.zeros((joints, 3)),
        variances=np.zeros((joints, 3)),
        known=np.zeros(joints, dtype=np.bool_),
        offsets=np.zeros((2, joints, 3)),
        offset_variances=np.zeros((2, joints)),
        usual_offsets=np.zeros((2, joints, 3)),
        agreed=np.zeros(joints),
        shared_error=np.zeros((joints, 3, 3)),
        doubt=np.zeros((2, joints)),
        view_doubt=np.zeros(2),
        scales=np.zeros(2),
        scale_variances=np.zeros(2),
        before=np.full((joints, 3), np.nan),
        clock=np.zeros(2, dtype=np.int64),
        last_positions=np.full((2, joints, 3), np.nan, dtype=np.float32),
        last_states=np.zeros((2, joints), dtype=np.uint8),
    )


def new_views(joints: int) -> Views:
    """Workspace for one pair."""
    return Views(
        reported=np.zeros((2, joints, 3)),
        reported_states=np.zeros((2, joints), dtype=np.uint8),
        stale=np.zeros(2, dtype=np.bool_),
        positions=np.zeros((2, joints, 3)),
        states=np.zeros((2, joints), dtype=np.uint8),
        delays=np.zeros(2),
        codes=np.zeros(2, dtype=np.int64),
        side_doubt=np.zeros(2),
        rays=np.zeros((2, joints, 3)),
        covers=np.full((2, joints), -1, dtype=np.int64),
        cover_distances=np.zeros((2, joints)),
        slow=np.zeros((2, joints, 3, 3)),
        fast=np.zeros((2, joints)),
        surprise=np.zeros(joints),
        trust=np.zeros((2, joints)),
        evidence=np.zeros((2, joints)),
        length_errors=np.zeros((2, joints)),
        places=np.full((2, joints, 3), np.nan),
        place_information=np.zeros((2, joints, 3, 3)),
        image=new_joint_evidence(joints),
        sources=np.zeros(joints, dtype=np.int64),
    )


def new_solve(joints: int) -> Solve:
    """Workspace for one solution."""
    return Solve(
        targets=np.zeros((joints, 3)),
        information=np.zeros((joints, 3, 3)),
        positions=np.zeros((joints, 3)),
        upward=np.zeros((joints, 4)),
        covariance=np.zeros((joints, 3, 3)),
        sums=np.zeros((3, 3)),
        scratch=np.zeros((3, 3)),
        tree_work=new_tree_workspace(joints),
    )


def new_output(frames: int, joints: int) -> Output:
    """Arrays for the results of ``frames`` pairs."""
    return Output(
        positions=np.empty((frames, joints, 3)),
        predicted=np.empty((frames, joints), dtype=np.bool_),
        weights_a=np.empty((frames, joints)),
        weights_b=np.empty((frames, joints)),
        misleading=np.empty((frames, joints), dtype=np.int64),
        covariance=np.empty((frames, joints, 3, 3)),
        sigma=np.empty((frames, joints)),
        velocities=np.empty((frames, joints, 3)),
        codes=np.zeros((frames, 2), dtype=np.int64),
        side_doubt=np.zeros((frames, 2)),
        counts=np.empty((frames, 3), dtype=np.int64),
    )
