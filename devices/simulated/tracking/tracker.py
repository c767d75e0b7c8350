"""Simulates the reports of a Kinect's body tracker: the truth, changed by one error after another."""

import numpy as np

from devices.simulated.tracking.errors import ORDER, SCRIPTED
from devices.simulated.tracking.report import Error, Report, Tracked
from fusion.skeleton import TRACKED, Skeleton
from fusion.support.types import Array


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
