"""A simulated body tracker: the truth, changed by one error after another, one class each.

An error has a method ``apply`` that changes the report of a frame, random numbers of its own, and the state
that it keeps from frame to frame. They apply in ``ORDER``, on one another's results: those that the tracker
has, and with a script also those in ``SCRIPTED``.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from devices.simulated.tracking.hiding import Hiding
from devices.simulated.tracking.mirroring import MirroringTracker
from devices.simulated.tracking.report import Error, Report, Tracked, Wandering
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.compiling.kernels import njit
from fusion.joint_kinds import by_joint
from fusion.skeleton import TRACKED, Skeleton
from fusion.support.types import Array

_BIAS = {
    "spine": 0.7, "head": 0.9, "girdle": 0.9, "elbow": 1.1, "wrist": 1.1, "hand": 1.1, "tip": 1.2,
    "thumb": 1.3, "knee": 0.9, "ankle": 1.0, "foot": 1.2, "face": 0.9,
}  # fmt: skip
"""Bias of each kind of joint as a multiple of the median: it is larger at the ends of limbs."""
_OUTLIER_SECONDS = 0.12


class ViewBias:
    """An offset of each joint. One part changes smoothly with the view; one is fixed to the body, in both."""

    def __init__(self, of: Tracked) -> None:
        spread = of.errors.view_bias * by_joint(of.body, _BIAS)[:, None]
        own, both = np.sqrt(1.0 - of.errors.shared), np.sqrt(of.errors.shared)
        # coefficients of 1, cos and sin of the view's azimuth
        drawn = of.streams.named("bias").standard_normal((len(of.body), 3, 3)) / np.sqrt(2.0)
        self._of_view = own * drawn * spread[:, None]
        # to the left, down and to the front
        self._of_body = both * of.streams.of_both.named("bias").standard_normal((len(of.body), 3)) * spread

    def apply(self, report: Report) -> None:
        axes = np.array(((-report.front[2], 0.0, report.front[0]), (0.0, 1.0, 0.0), report.front))
        waves = np.array((1.0, np.cos(report.angle), np.sin(report.angle)))
        report.at = report.at + self._of_view @ waves + self._of_body @ axes


class Depth:
    """A shift along the ray: towards the skin, and away from the sensor with the height above the root."""

    def __init__(self, of: Tracked) -> None:
        self._root, self._skin, self._lean = of.body.root, of.errors.skin, of.errors.lean

    def apply(self, report: Report) -> None:
        y, distance = report.joints[:, 1], np.linalg.norm(report.joints, axis=1)
        away = self._lean * (y[self._root] - y) - self._skin
        report.at = report.at * (1.0 + away / distance)[:, None]


class BoneLengths:
    """The tracker's body model: bones of nearly constant length, each wrong by a constant factor.

    A part of the factor is the same in both views.
    """

    def __init__(self, of: Tracked) -> None:
        shared, count = of.errors.shared, len(of.body)
        own, both = (
            streams.named("bones").standard_normal(count) for streams in (of.streams, of.streams.of_both)
        )
        self._factor = 1.0 + of.errors.bones * (np.sqrt(1.0 - shared) * own + np.sqrt(shared) * both)

    def apply(self, report: Report) -> None:
        body, held = report.of.body, report.at.copy()
        order, parents = body.order[1:], body.parent_indices
        hold(held, report.at, report.joints, order, parents, self._factor, report.of.errors.stretch)
        report.at = held


@njit()
def hold(held, at, joints, order, parents, factor, stretch):  # type: ignore[no-untyped-def]
    """Moves joints along their bones, from the root outwards: ``stretch`` of a length's error remains."""
    for joint in order:
        parent = parents[joint]
        true = given = 0.0
        for c in range(3):
            true += (joints[joint, c] - joints[parent, c]) ** 2
            given += (at[joint, c] - held[parent, c]) ** 2
        true, given = math.sqrt(true), math.sqrt(given)
        scale = (factor[joint] * true + stretch * (given - true)) / max(given, 1e-6)
        for c in range(3):
            held[joint, c] = held[parent, c] + (at[joint, c] - held[parent, c]) * scale


class Outliers:
    """A joint is reported elsewhere for a moment. Its tracking state does not show it."""

    def __init__(self, of: Tracked) -> None:
        self._random, self._size = of.streams.named("outliers"), of.errors.outlier_size
        self._rates = of.rates(of.errors.outliers, _OUTLIER_SECONDS)
        self._away = np.zeros((len(of.body), 3))

    def apply(self, report: Report) -> None:
        (start, stop), uniform = self._rates, self._random.random((4, len(self._away)))
        keeps = self._away.any(axis=1) & (uniform[0] >= stop)
        leaves = ~keeps & (uniform[0] < start)
        fresh = (2.0 * uniform[1:].T - 1.0) * self._size
        self._away = np.where(keeps[:, None], self._away, np.where(leaves[:, None], fresh, 0.0))
        report.at = report.at + self._away


class Added:
    """Errors that a caller adds."""

    def __init__(self, of: Tracked) -> None:
        assert of.errors.added is not None
        self._errors = of.errors.added(of.body, of.frame_seconds, of.streams.named("added"))

    def apply(self, report: Report) -> None:
        report.at = report.at + next(self._errors)


class Scale:
    """The size of the whole skeleton wanders."""

    def __init__(self, of: Tracked) -> None:
        memory = np.exp(-of.frame_seconds / of.errors.rescale_seconds)
        self._scale = Wandering((1,), memory, of.streams.named("scale"))

    def apply(self, report: Report) -> None:
        root = report.at[report.of.body.root]
        report.at = root + (report.at - root) * (1.0 + report.of.errors.rescale * self._scale.next())


class Jitter:
    """Each joint trembles, more where it moves or is guessed."""

    def __init__(self, of: Tracked) -> None:
        self._size = by_joint(of.body, of.errors.jitter)
        self._jitter = Wandering((len(of.body), 3), of.errors.jitter_memory, of.streams.named("jitter"))
        self._before: Array | None = None

    def apply(self, report: Report) -> None:
        errors, before = report.of.errors, self._before
        moved = report.joints - (report.joints if before is None else before)
        self._before = report.joints
        speed = np.linalg.norm(moved, axis=1) / report.of.frame_seconds
        size = (self._size + errors.moving_jitter * speed) * (
            1.0 + (errors.inferred_jitter - 1.0) * report.hiding
        )
        report.at = report.at + size[:, None] * self._jitter.next()


class Mirrored:
    """The person is reported as facing the sensor, with sides exchanged; see ``mirroring``."""

    def __init__(self, of: Tracked) -> None:
        self._mirroring = MirroringTracker(
            of.body, of.errors.mirroring, of.frame_seconds, of.streams.named("mirroring")
        )

    def apply(self, report: Report) -> None:
        script = report.of.script
        told = script is not None and script.mirrors(report.time_ns)
        report.at, report.states = self._mirroring.apply(
            report.at, report.states, report.front, report.angle, told
        )


class Stale:
    """A frame repeats the one before."""

    def __init__(self, of: Tracked) -> None:
        self._random = of.streams.named("stale")
        self._last: tuple[Array, NDArray[np.uint8]] | None = None

    def apply(self, report: Report) -> None:
        if self._random.random() < report.of.errors.stale and self._last is not None:
            report.at, report.states = self._last
        self._last = report.at, report.states


class Loss:
    """No person is reported for a while, by chance or because hardly any joint is visible."""

    def __init__(self, of: Tracked) -> None:
        self._random, self._lost = of.streams.named("loss"), False
        self._rates = of.rates(of.errors.lost, of.errors.lost_seconds)

    def apply(self, report: Report) -> None:
        (start, stop), chance = self._rates, self._random.random()
        self._lost = bool(chance >= stop if self._lost else chance < start)
        report.lost = self._lost or (
            report.of.errors.seen_share > 0.0 and bool(np.mean(report.visible > 0.0) < 0.25)
        )


ORDER: tuple[tuple[Callable[[Tracked], Error], Callable[[TrackerErrors], bool]], ...] = (
    (ViewBias, lambda errors: errors.view_bias > 0.0),
    (Depth, lambda errors: errors.skin != 0.0 or errors.lean != 0.0),
    (Hiding, lambda errors: errors.seen_share > 0.0 or any(errors.unsure.values())),
    (BoneLengths, lambda errors: errors.stretch != 1.0 or errors.bones > 0.0),
    (Outliers, lambda errors: errors.outliers > 0.0),
    (Added, lambda errors: errors.added is not None),
    (Scale, lambda errors: errors.rescale > 0.0),
    (Jitter, lambda errors: any(errors.jitter.values()) or errors.moving_jitter > 0.0),
    (Mirrored, lambda errors: errors.mirroring.back > 0.0 or errors.mirroring.faces_sensor > 0.0),
    (Stale, lambda errors: errors.stale > 0.0),
    (Loss, lambda errors: errors.lost > 0.0 or errors.seen_share > 0.0),
)
"""The errors in the order in which they apply, and which of them a tracker has."""
SCRIPTED = (Hiding, Mirrored)
"""The errors that a script may cause."""


class Tracker:
    """The body tracker of one sensor.

    Call :meth:`report` once for each frame, in order: a call draws random numbers and is a step of
    ``frame_seconds``. The same streams of random numbers and frames give the same reports.
    """

    def __init__(self, of: Tracked) -> None:
        self._of = of
        self._errors: list[Error] = [
            error(of)
            for error, has in ORDER
            if has(of.errors) or (of.script is not None and error in SCRIPTED)
        ]

    def report(self, joints: Array, visible: Array, time_ns: int) -> Skeleton | None:
        """The skeleton that is reported of (J, 3) true joints in the sensor's frame, metres, with (J,)
        visible shares; None while the person is lost.
        """
        count, rolled = len(joints), self._of.rolled
        joints = joints @ rolled.T
        report = Report(
            self._of, joints, visible, time_ns, joints, np.full(count, TRACKED, np.uint8), np.zeros(count)
        )
        for error in self._errors:
            error.apply(report)
        return None if report.lost else Skeleton.of(self._of.body, report.at @ rolled, report.states, time_ns)
