"""The paper's method, compiled, for :class:`fusion.fuser.Fuser`.

The caller owns all arrays, so that a frame allocates nothing.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.compiling.kernels import inner_kernel, kernel
from fusion.pair_arrays import repeats
from fusion.paper.reliability import ViewPixels, weigh_views
from fusion.setup import FusionSetup
from fusion.solvers.published import solve_published
from fusion.solvers.tree_solver import solve_tree
from fusion.solvers.tree_start import TreeWorkspace, copy
from fusion.support.types import Array

PAPER, EQUAL = 0, 1  # which weights
FORGET_NS = 1_000_000_000
"""After this time without a person the previous frame is forgotten."""


class Model(NamedTuple):
    """Everything that is constant from frame to frame."""

    parents: NDArray[np.int64]  # (J,)
    order: NDArray[np.int64]  # (J,)
    rest: Array  # (J, 3)
    torso: NDArray[np.int64]
    linked: NDArray[np.bool_]  # (J, J)
    bone_lengths: Array  # (J,)
    rotation: Array  # (3, 3) R
    focal_a: Array  # (2,) pixels; the principal point does not matter to distances
    focal_b: Array
    h: float
    weights: int


class Memory(NamedTuple):
    """The state between two frames, and workspace."""

    translation: Annotated[Array, (3,)]  # t
    last_fused: Annotated[Array, ("J", 3), np.nan]  # S* of the last frame that had one
    before_ns: Annotated[NDArray[np.int64], (2,)]  # its time, and 1 if there is one
    last_a: Annotated[NDArray[np.float32], ("J", 3), np.nan]  # the sensors' last skeletons,
    last_b: Annotated[NDArray[np.float32], ("J", 3), np.nan]
    last_states_a: Annotated[NDArray[np.uint8], ("J",)]
    last_states_b: Annotated[NDArray[np.uint8], ("J",)]
    b_in_a: Annotated[Array, ("J", 3)]  # q'
    pixels_a: Annotated[Array, ("J", 2)]
    pixels_b: Annotated[Array, ("J", 2)]
    usable: Annotated[NDArray[np.bool_], ("J",)]
    targets: Annotated[Array, ("J", 3)]  # m
    weights: Annotated[Array, ("J",)]  # w
    tree_work: TreeWorkspace
    paper_work: Annotated[Array, (2, "J", 3)]


class Result(NamedTuple):
    """Results of T frames; see :class:`fusion.fused_frame.FusedFrame`."""

    positions: Annotated[Array, ("T", "J", 3)]
    predicted: Annotated[NDArray[np.bool_], ("T", "J")]
    weights_a: Annotated[Array, ("T", "J")]
    weights_b: Annotated[Array, ("T", "J")]
    misleading_joint: Annotated[NDArray[np.int64], ("T", "J")]
    translation: Annotated[Array, ("T", 3)]
    iterations: Annotated[NDArray[np.int64], ("T",)]
    stale_a: Annotated[NDArray[np.bool_], ("T",)]
    stale_b: Annotated[NDArray[np.bool_], ("T",)]


def new_model(setup: FusionSetup) -> Model:
    """The model of one body, calibration and choice of settings."""
    body, calibration, (a, b) = setup.body, setup.calibration, setup.intrinsics
    return Model(
        parents=body.parent_indices.copy(),
        order=body.order.copy(),
        rest=np.array(body.rest),
        torso=np.array(body.torso, dtype=np.int64),
        linked=body.linked.copy(),
        bone_lengths=np.array(calibration.bone_lengths, dtype=np.float64),
        rotation=np.array(calibration.a_from_b.rotation, dtype=np.float64, order="C"),
        focal_a=np.array([a.fx, a.fy]),
        focal_b=np.array([b.fx, b.fy]),
        h=setup.settings.h,
        weights=EQUAL if setup.settings.weights == "equal" else PAPER,
    )


@kernel
def fuse_frames(model, memory, result, pairs):  # type: ignore[no-untyped-def]
    """The method over consecutive pairs, eq. (1) solved exactly.

    Args:
        model, memory: Of the fuser; the memory is updated.
        result: Written, T frames.
        pairs: T pairs, :class:`fusion.pair_arrays.PairArrays`.
    """
    for k in range(len(pairs.time_ns)):
        if prepare(model, memory, result, pairs, k):
            positions = result.positions[k]
            result.iterations[k], _, _, _ = solve_tree(
                model.parents, model.order, model.rest, memory.targets, memory.weights, model.bone_lengths,
                memory.last_fused, memory.tree_work, positions,
            )  # fmt: skip
            _store_frame(memory, positions, pairs.time_ns[k])


@kernel
def fuse_frames_as_published(model, memory, result, pairs):  # type: ignore[no-untyped-def]
    """:func:`fuse_frames` with eqs. (3)–(9); a kernel of its own, to compile only the method in use."""
    for k in range(len(pairs.time_ns)):
        if prepare(model, memory, result, pairs, k):
            positions = result.positions[k]
            copy(memory.last_fused, positions)
            result.iterations[k], _, _ = solve_published(
                model.parents, memory.targets, memory.weights, model.bone_lengths, True, positions,
                memory.paper_work,
            )  # fmt: skip
            _store_frame(memory, positions, pairs.time_ns[k])


@inner_kernel
def prepare(model, memory, result, pairs, k):  # type: ignore[no-untyped-def]
    """Prepares frame k; its solution remains NaN. Returns whether there is a problem to solve."""
    result.stale_a[k] = repeats(pairs.a[k], pairs.states_a[k], memory.last_a, memory.last_states_a)
    result.stale_b[k] = repeats(pairs.b[k], pairs.states_b[k], memory.last_b, memory.last_states_b)
    if pairs.time_ns[k] - memory.before_ns[0] > FORGET_NS:
        memory.before_ns[1] = 0
    update_translation(model, memory, pairs, k)
    set_weights(model, memory, result, pairs, k)
    anyone = set_targets(memory, result, pairs.a[k], k)
    for c in range(3):
        result.translation[k, c] = memory.translation[c]
        for i in range(len(memory.targets)):
            result.positions[k, i, c] = math.nan
    if anyone and memory.before_ns[1] == 0:
        first_guess(model, memory)
    return anyone


@inner_kernel
def _store_frame(memory, positions, time_ns):  # type: ignore[no-untyped-def]
    copy(positions, memory.last_fused)
    memory.before_ns[0], memory.before_ns[1] = time_ns, 1


@inner_kernel
def update_translation(model, memory, pairs, k):  # type: ignore[no-untyped-def]
    """t = c_p − R c_q over the torso joints of both views (sec. 4), else unchanged; then q' = R q + t."""
    R, t = model.rotation, memory.translation
    a, states_a, b, states_b = pairs.a[k], pairs.states_a[k], pairs.b[k], pairs.states_b[k]
    count = 0
    px = py = pz = qx = qy = qz = 0.0
    for i in model.torso:
        if states_a[i] != 0 and states_b[i] != 0:
            count += 1
            px, py, pz = px + a[i, 0], py + a[i, 1], pz + a[i, 2]
            qx, qy, qz = qx + b[i, 0], qy + b[i, 1], qz + b[i, 2]
    if count > 0:
        t[0] = (px - (R[0, 0] * qx + R[0, 1] * qy + R[0, 2] * qz)) / count
        t[1] = (py - (R[1, 0] * qx + R[1, 1] * qy + R[1, 2] * qz)) / count
        t[2] = (pz - (R[2, 0] * qx + R[2, 1] * qy + R[2, 2] * qz)) / count
    for i in range(len(b)):
        x, y, z = float(b[i, 0]), float(b[i, 1]), float(b[i, 2])
        for c in range(3):
            memory.b_in_a[i, c] = R[c, 0] * x + R[c, 1] * y + R[c, 2] * z + t[c]


@inner_kernel
def _project(positions, focal, pixels):  # type: ignore[no-untyped-def]
    """Projects joints to the sensor's own viewing plane; NaN behind the sensor."""
    for i in range(len(positions)):
        z = float(positions[i, 2])
        if z > 0.0:
            pixels[i, 0] = focal[0] * positions[i, 0] / z
            pixels[i, 1] = focal[1] * positions[i, 1] / z
        else:
            pixels[i, 0] = pixels[i, 1] = math.nan


@inner_kernel
def set_weights(model, memory, result, pairs, k):  # type: ignore[no-untyped-def]
    """w_A and w_B, eqs. (10), (11), or ½ each; 1 for a view if the other has no position."""
    states_a, states_b = pairs.states_a[k], pairs.states_b[k]
    weights_a, weights_b, misleading = result.weights_a[k], result.weights_b[k], result.misleading_joint[k]
    if model.weights == EQUAL:
        for i in range(len(states_a)):
            has_a, has_b = states_a[i] != 0, states_b[i] != 0
            share = 0.5 if has_a and has_b else 1.0
            weights_a[i] = share if has_a else 0.0
            weights_b[i] = share if has_b else 0.0
            misleading[i] = -1
        return
    _project(pairs.a[k], model.focal_a, memory.pixels_a)
    _project(pairs.b[k], model.focal_b, memory.pixels_b)
    pixels = ViewPixels(memory.pixels_a, memory.pixels_b, states_a, states_b, memory.usable)
    weigh_views(pixels, model.linked, model.h, weights_a, weights_b, misleading)


@inner_kernel
def set_targets(memory, result, a, k):  # type: ignore[no-untyped-def]
    """m_i and w_i of eq. (1): the weighted mean of the views, NaN and 0 for a joint without data."""
    weights_a, weights_b, predicted = result.weights_a[k], result.weights_b[k], result.predicted[k]
    anyone = False
    for i in range(len(weights_a)):
        w = weights_a[i] + weights_b[i]
        memory.weights[i] = w
        predicted[i] = w == 0.0
        for c in range(3):
            m = 0.0
            if weights_a[i] > 0.0:
                m += weights_a[i] * a[i, c]
            if weights_b[i] > 0.0:
                m += weights_b[i] * memory.b_in_a[i, c]
            memory.targets[i, c] = m / w if w > 0.0 else math.nan
        anyone = anyone or w > 0.0
    return anyone


@inner_kernel
def first_guess(model, memory):  # type: ignore[no-untyped-def]
    """Uses the targets as previous frame; a joint without target is placed as in the rest pose."""
    before, targets = memory.last_fused, memory.targets
    root = model.order[0]
    for c in range(3):
        total, count = 0.0, 0
        for i in range(len(targets)):
            if memory.weights[i] > 0.0:
                total, count = total + targets[i, c], count + 1
        before[root, c] = targets[root, c] if memory.weights[root] > 0.0 else total / count
    for k in range(1, len(model.order)):
        i = model.order[k]
        for c in range(3):
            if memory.weights[i] > 0.0:
                before[i, c] = targets[i, c]
            else:
                before[i, c] = before[model.parents[i], c] + model.bone_lengths[i] * model.rest[i, c]
