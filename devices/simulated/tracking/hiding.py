"""What a body tracker reports of joints that it does not see."""

import numpy as np
from numpy.typing import NDArray

from devices.depth.camera import project
from devices.simulated.tracking.report import Report, Tracked, Wandering
from fusion.joint_kinds import by_joint
from fusion.skeleton import INFERRED, TRACKED, TrackingState
from fusion.support.types import Array

_HIDING_SECONDS = 0.08  # time constant of the transition from observation to guess
_GUESS_SECONDS = 0.6  # correlation time of the error of a guess
_UNSURE_SECONDS = 0.4


class Hiding:
    """A joint that is hidden, or unsure, is guessed, or put near the joint that covers it (sec. 3).

    What becomes of a joint is drawn when it disappears, and holds for that spell.
    """

    def __init__(self, of: Tracked) -> None:
        count = len(of.body)
        self._random = of.streams.named("hiding")
        self._guess = Wandering(
            (count, 3), np.exp(-of.frame_seconds / _GUESS_SECONDS), of.streams.named("guess")
        )
        self._unsure_rates = of.rates(by_joint(of.body, of.errors.unsure), _UNSURE_SECONDS)
        self._weight = np.zeros(count)  # 0 seen … 1 guessed
        self._hidden = self._unsure = self._misplaced = np.zeros(count, dtype=bool)
        self._state = np.full(count, INFERRED)  # reported of a joint while it is hidden
        self._cover = np.arange(count)  # the joint that covers it; itself where none does

    def apply(self, report: Report) -> None:
        errors = report.of.errors
        hidden = self._begin(report, self._random.random((3, len(self._weight))))
        self._weight = self._weight + (hidden - self._weight) * -np.expm1(
            -report.of.frame_seconds / _HIDING_SECONDS
        )
        guess = report.at + errors.inferred_error * self._guess.next()
        snapped = self._state == TRACKED
        covers = report.joints[self._cover]
        guess[snapped] = (report.at + errors.snap * (covers - report.at))[snapped]
        report.at = report.at + self._weight[:, None] * (guess - report.at)
        report.states = np.where(hidden, self._state, report.states).astype(np.uint8)
        report.hiding = self._weight

    def _begin(self, report: Report, uniform: Array) -> NDArray[np.bool_]:
        """Returns (J,) which joints are hidden; draws what becomes of those that were not."""
        errors, (start, stop) = report.of.errors, self._unsure_rates
        self._unsure = np.where(self._unsure, uniform[0] >= stop, uniform[0] < start)
        hidden = (report.visible < errors.seen_share) | self._unsure
        begins = hidden & ~self._hidden
        lost = np.where(uniform[2] < errors.not_tracked, TrackingState.NOT_TRACKED, INFERRED)
        self._state = np.where(begins, np.where(uniform[1] < errors.mistracked, TRACKED, lost), self._state)
        told, before = np.zeros_like(hidden), self._misplaced
        if report.of.script is not None:
            told = report.of.script.misplaces(report.time_ns)
            self._state = np.where(told, TRACKED, np.where(before & ~told, INFERRED, self._state))
        self._misplaced = told
        if (begins | (told & ~before)).any():
            cover = _covering(report)
            self._cover = np.where(begins, cover, self._cover)
            # a script puts a joint that nothing covers nearer to the pelvis
            alone = cover == np.arange(len(cover))
            self._cover = np.where(told & ~before, np.where(alone, report.of.body.root, cover), self._cover)
        self._hidden = hidden | told
        return self._hidden


def _covering(report: Report) -> NDArray[np.int64]:
    """(J,) The joint that covers each: nearest in the image, in front, no neighbour; or itself."""
    joints, lens = report.joints, report.of.intrinsics
    pixels = project(lens, joints)
    apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=2)
    nearer = joints[None, :, 2] < joints[:, None, 2] - 0.05
    possible = nearer & ~report.of.body.linked & (report.visible > 0.5)[None]
    apart = np.where(possible, np.nan_to_num(apart, nan=np.inf), np.inf)
    nearest = apart.argmin(axis=1)
    itself = np.arange(len(joints))
    near = apart[itself, nearest] * joints[:, 2] / lens.fx < 0.30  # metres across the ray
    return np.where(near, nearest, itself)
