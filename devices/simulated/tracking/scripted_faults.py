"""Faults of a body tracker at given times, for demonstrations and tests.

The faults are those that real trackers have. A script only decides when they happen: the tracker makes them
in the same way as those that it draws by chance (see ``tracker`` and ``mirroring``).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.joint_kinds import of_kind


@dataclass(frozen=True)
class Spells:
    """Spells of one length that repeat."""

    begins: float  # start of the first spell, seconds of the sensor's clock
    seconds: float  # length of a spell
    every: float = np.inf
    """From the start of one spell to that of the next, seconds; infinity: there is only one."""

    def include(self, time: float) -> bool:
        """Whether a spell lasts at a time, seconds."""
        return time >= self.begins and (time - self.begins) % self.every < self.seconds

    def starts_before(self, end: float) -> list[float]:
        """Starts of all spells that end before a time, seconds."""
        left = end - self.seconds - self.begins
        if left < 0.0:
            return []
        return [self.begins, *(self.begins + k * self.every for k in range(1, int(left / self.every) + 1))]


@dataclass(frozen=True)
class ScriptedFaults:
    """The faults of one tracker."""

    body: Body  # the body that the tracker reports
    misplaced: Sequence[Spells] = ()
    """When the left arm is hidden and reported as tracked, near the joints that are in front of it in the
    image; where there are none, nearer to the pelvis."""
    mirrored: Sequence[Spells] = ()  # when left and right are exchanged

    def mirrors(self, time_ns: int) -> bool:
        """Whether left and right are exchanged at a time of the sensor's clock."""
        return any(spells.include(time_ns * 1e-9) for spells in self.mirrored)

    def misplaces(self, time_ns: int) -> NDArray[np.bool_]:
        """(J,) which joints are hidden and reported as tracked at a time of the sensor's clock."""
        lasts = any(spells.include(time_ns * 1e-9) for spells in self.misplaced)
        return self._joints if lasts else np.zeros(len(self.body), dtype=bool)

    @cached_property
    def _joints(self) -> NDArray[np.bool_]:
        left = ["left" in name.lower() for name in self.body.joints]
        return np.asarray(of_kind(self.body, "elbow", "wrist", "hand", "tip", "thumb") & left)
