"""The error model of registration: each joint's view bias as a random effect.

The model of joint j in keyframe k is

    p = R q + t + Σ_f φ_f(h) β_jf + ε,      φ = (1, cos h, sin h),

with h the person's heading, ε of Student's t distribution and β_jf ~ N(0, σ_β²). A tracker places a joint
with an error that is the same in every frame of a view. Without β, ten thousand frames of one pose would
count as ten thousand observations and would outweigh a better pose that was held for two seconds.
"""

from dataclasses import dataclass
from functools import cache
from typing import Annotated, NamedTuple

import numpy as np

from fusion.body import Body
from fusion.compiling.kernels import compiles, kernel
from fusion.joint_kinds import by_joint
from fusion.registration.keyframes import Evidence
from fusion.registration.lasting_errors import COMMON_SD
from fusion.rigid import RigidTransform
from fusion.support.array_fields import new_arrays
from fusion.support.read_only import read_only
from fusion.support.types import Array

DEGREES_OF_FREEDOM = 4.0  # of Student's t distribution
_BASIS_VARIANCE = np.array([0.5, 0.25, 0.25])
_BASIS_INFORMATION = np.diag(1.0 / _BASIS_VARIANCE)
_RELATIVE_NOISE = {
    "spine": 1.0, "head": 1.2, "girdle": 1.2, "elbow": 1.5, "wrist": 2.0, "hand": 2.5, "tip": 3.5,
    "thumb": 4.0, "knee": 1.3, "ankle": 1.6, "foot": 2.5, "face": 1.3,
}  # fmt: skip
"""Noise by kind of joint, relative to the spine's: jitter of a still person and outlier rate of real Kinect
v2 and published Azure recordings, compressed to a factor of four and rounded by hand. No command reproduces
it."""


@dataclass(frozen=True)
class RobustFitSettings:
    """Assumptions of the fit."""

    bias_sd: float = 0.03
    """Metres, standard deviation σ_β of the difference of two views' biases of a joint, per axis. It is the
    same for all joints: on 15 real pairs of Kinect v2, head and spine are as far off along the ray (35 and 10
    mm) as elbows, knees and hands (5 to 10 mm). A smaller one for the trunk lets the depth error of the trunk
    determine t."""
    tempering: float = 10.0
    """Divisor of the information of keyframes: their errors beyond the bias are correlated over seconds and
    whole limbs. 10 gives the least error of R on the simulator."""
    inflation: float = 2.5
    """Factor on the covariance, for effects outside the model. On the simulator the error of R then lies
    within 1 and 2 stated standard deviations in 59 and 93 % of the recordings of the Azure Kinect, but in 27
    and 64 % of those of the Kinect v2."""
    common_sd: float = COMMON_SD  # metres, error common to all joints; see fusion.registration.lasting_errors


@cache
def relative_noise(body: Body) -> Array:
    """(J,) standard deviation of a joint's frame-to-frame error, relative to the spine's."""
    noise = by_joint(body, _RELATIVE_NOISE)
    return read_only(noise)  # all callers share it


class Observations(NamedTuple):
    """:class:`fusion.registration.keyframes.Evidence` without times."""

    a: Array
    b: Array
    weights: Array
    basis: Array


class ErrorModel(NamedTuple):
    """R, t and biases, and what is assumed of the residuals."""

    rotation: Array  # (3, 3)
    translation: Array  # (3,)
    centre: Array  # (3,) metres, about which θ turns
    beta: Array  # (3, J, 3)
    noise: Array  # (J,) relative to the spine's
    noise_sd: float
    tempering: float


class Sums(NamedTuple):
    """Weighted sums over the keyframes, for each joint or in all."""

    w: Annotated[Array, ("J", 3)]  # Σ w φ_f
    x: Annotated[Array, ("J", 3, 3)]  # Σ w φ_f x
    phi: Annotated[Array, ("J", 3, 3)]  # Σ w φ_f φ_g
    r: Annotated[Array, ("J", 3, 3)]  # Σ w φ_f r
    information: Annotated[Array, (6, 6)]
    gradient: Annotated[Array, (6,)]
    figures: Annotated[Array, (3,)]  # robust cost, Σ w |e|² σ², number of observations


def disagreement(
    body: Body,
    evidence: Evidence,
    a_from_b: RigidTransform,
    settings: RobustFitSettings,
    noise_sd: float,
    iterations: int = 3,
) -> float:
    """Minus the log-likelihood of the evidence under a transform, up to a constant.

    The biases are fitted to the transform, at the price of their prior, so that a transform gains nothing by
    absorbing them. Compare two transforms on pairs that neither was fitted to.
    """
    bias_information = np.full(len(body), settings.bias_sd**-2)
    beta = np.zeros((3, len(body), 3))
    cost = 0.0
    for k in range(iterations + 1):
        sums = accumulated(evidence, error_model(body, settings, a_from_b, beta, noise_sd))
        cost = float(sums.figures[0]) + 0.5 * float(
            np.sum(beta**2 * (bias_information[None, :, None] / _BASIS_VARIANCE[:, None, None]))
        )
        if k < iterations:
            beta = np.moveaxis(_covariances(sums, bias_information) @ sums.r, 0, 1)
    return cost


def cost_of(
    body: Body,
    evidence: Evidence,
    a_from_b: RigidTransform,
    settings: RobustFitSettings,
    noise_sd: float,
    biases: Array,
) -> float:
    """Minus the log-likelihood of the evidence and of given biases, up to a constant."""
    sums = accumulated(evidence, error_model(body, settings, a_from_b, biases, noise_sd))
    price = np.sum(biases**2 / _BASIS_VARIANCE[:, None, None]) / settings.bias_sd**2
    return float(sums.figures[0]) + 0.5 * float(price)


def error_model(
    body: Body,
    settings: RobustFitSettings,
    a_from_b: RigidTransform,
    beta: Array,
    noise_sd: float,
    centre: Array | None = None,
) -> ErrorModel:
    """Everything that the residuals depend on; every call has the types for which the kernel is compiled."""
    return ErrorModel(
        _plain(a_from_b.rotation),
        _plain(a_from_b.translation),
        np.zeros(3) if centre is None else _plain(centre),
        _plain(beta),
        _plain(relative_noise(body)),
        float(noise_sd),
        float(settings.tempering),
    )


def accumulated(evidence: Evidence, model: ErrorModel) -> Sums:
    """The sums over all observations, with robust weights of their residuals."""
    sums = new_arrays(Sums, J=evidence.a.shape[1])
    observations = Observations(*(_plain(values) for values in evidence[:4]))
    _accumulate(observations, model, sums)
    return sums


def _plain(values: Array) -> Array:
    """The values in a contiguous, writable array: numba compiles anew for any other layout."""
    flags = values.flags  # np.require takes longer than the rest of what is called here
    if flags.c_contiguous and flags.writeable and values.dtype == np.float64:
        return values
    return np.array(values, dtype=np.float64, order="C")


def eliminate_biases(sums: Sums, bias_information: Array) -> tuple[Array, Array, Array, Array]:
    """Schur complement of each joint's β: information and gradient of (dt, θ), and β as a function of them.

    Returns:
        (6, 6) information, (6,) gradient, (J, 3, 3) β for a step of 0, (J, 3, 3, 6) the
        decrease of β per step.
    """
    joints = len(sums.w)
    inverse = _covariances(sums, bias_information)
    # How φ_f β couples with (dt, θ): [I, −[x]×] summed with weight φ_f.
    coupling = np.zeros((joints, 3, 3, 6))
    for axis in range(3):
        coupling[:, :, axis, axis] = sums.w
    for row, column, axis, sign in _CROSS:
        coupling[:, :, row, 3 + column] = sign * sums.x[:, :, axis]
    flat = coupling.reshape(joints, 3, 18)
    coupled = inverse @ flat
    alone = inverse @ sums.r
    information = sums.information - np.einsum(
        "jfay,jfaz->yz", coupling, coupled.reshape(coupling.shape), optimize=False
    )
    gradient = sums.gradient - np.tensordot(coupling, alone, axes=([0, 1, 2], [0, 1, 2]))
    return information, gradient, alone, coupled.reshape(coupling.shape)


def _covariances(sums: Sums, bias_information: Array) -> Array:
    """(J, 3, 3) of each joint's β."""
    return np.asarray(np.linalg.inv(sums.phi + bias_information[:, None, None] * _BASIS_INFORMATION))


_CROSS = ((0, 1, 2, 1.0), (0, 2, 1, -1.0), (1, 0, 2, -1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0), (2, 1, 0, -1.0))
"""Row, column, axis of x and sign of −[x]×."""


@kernel
def _accumulate(observations, model, sums):  # type: ignore[no-untyped-def]
    """Adds every observation's share to the sums, with robust weights of its residual."""
    a, b, weights, basis = observations
    R, t, centre, beta, noise, noise_sd, tempering = model
    nu = DEGREES_OF_FREEDOM
    w_sums, x_sums, phi_sums, r_sums, information, gradient, figures = sums
    for j in range(a.shape[1]):
        sd2 = (noise[j] * noise_sd) ** 2
        for k in range(a.shape[0]):
            importance = weights[k, j]
            if importance <= 0.0:
                continue
            q0, q1, q2 = b[k, j, 0], b[k, j, 1], b[k, j, 2]
            x0 = R[0, 0] * q0 + R[0, 1] * q1 + R[0, 2] * q2 + t[0]
            x1 = R[1, 0] * q0 + R[1, 1] * q1 + R[1, 2] * q2 + t[1]
            x2 = R[2, 0] * q0 + R[2, 1] * q1 + R[2, 2] * q2 + t[2]
            r0, r1, r2 = a[k, j, 0] - x0, a[k, j, 1] - x1, a[k, j, 2] - x2
            e0, e1, e2 = r0, r1, r2
            for f in range(3):
                e0 -= basis[k, f] * beta[f, j, 0]
                e1 -= basis[k, f] * beta[f, j, 1]
                e2 -= basis[k, f] * beta[f, j, 2]
            square = e0 * e0 + e1 * e1 + e2 * e2
            robust = (nu + 3.0) / (nu + square / sd2)
            figures[0] += importance * 0.5 * (nu + 3.0) * np.log1p(square / (nu * sd2)) / tempering
            figures[1] += importance * robust * square / (3.0 * noise[j] ** 2)
            figures[2] += importance
            w = importance * robust / (sd2 * tempering)
            x0, x1, x2 = x0 - centre[0], x1 - centre[1], x2 - centre[2]
            for f in range(3):
                wf = w * basis[k, f]
                w_sums[j, f] += wf
                x_sums[j, f, 0] += wf * x0
                x_sums[j, f, 1] += wf * x1
                x_sums[j, f, 2] += wf * x2
                r_sums[j, f, 0] += wf * r0
                r_sums[j, f, 1] += wf * r1
                r_sums[j, f, 2] += wf * r2
                for g in range(3):
                    phi_sums[j, f, g] += wf * basis[k, g]
            information[0, 0] += w
            information[3, 3] += w * (x1 * x1 + x2 * x2)
            information[4, 4] += w * (x0 * x0 + x2 * x2)
            information[5, 5] += w * (x0 * x0 + x1 * x1)
            information[3, 4] -= w * x0 * x1
            information[3, 5] -= w * x0 * x2
            information[4, 5] -= w * x1 * x2
            information[0, 4] += w * x2
            information[0, 5] -= w * x1
            information[1, 5] += w * x0
            gradient[0] += w * r0
            gradient[1] += w * r1
            gradient[2] += w * r2
            gradient[3] += w * (x1 * r2 - x2 * r1)
            gradient[4] += w * (x2 * r0 - x0 * r2)
            gradient[5] += w * (x0 * r1 - x1 * r0)
    information[1, 1] = information[2, 2] = information[0, 0]
    information[1, 3] = -information[0, 4]
    information[2, 3] = -information[0, 5]
    information[2, 4] = -information[1, 5]
    for y in range(6):
        for z in range(y):
            information[y, z] = information[z, y]


@compiles(_accumulate)
def warm_up() -> None:
    """Compiles or loads the kernel, so that no frame of a live session waits for it."""
    model = ErrorModel(np.eye(3), np.zeros(3), np.zeros(3), np.zeros((3, 1, 3)), np.ones(1), 1.0, 1.0)
    accumulated(new_arrays(Evidence, K=1, J=1), model)
