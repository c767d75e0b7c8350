"""Fuses live pairs: follows one person and calibrates while pairs arrive."""

from __future__ import annotations

from collections.abc import Iterator

from devices.following import PersonOfPair
from devices.live.sensor_pair import TwoSensors
from devices.pairing import FramePair
from devices.sensor import Sensor
from fusion.calibration.calibration import nominal_calibration
from fusion.calibration.calibrator import Calibrator
from fusion.calibration.learner import CalibrationChange, CalibrationLearner
from fusion.facing.model import WHOLE
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.fusing.exchanged_sides import ExchangedSides, Told
from recordings.fusing.recorded import fuse_one
from recordings.session_arrays import RecordedFrame


class LiveFusion:
    """Fuses one pair after another to S*.

    Args:
        setup: Initial setup.
        calibrated: Whether to keep its calibration; otherwise one is found while pairs arrive, and refined.
        refine: Whether to refine a calibration that is kept.
    """

    def __init__(self, setup: FusionSetup, calibrated: bool = False, refine: bool = False) -> None:
        self.setup = setup
        """The setup with which the last pair was fused."""
        self.calibrator = Calibrator(setup.body, setup.calibration if calibrated or refine else None)
        self._fuser = Fuser(setup)
        self._people = PersonOfPair()
        learns = setup.settings.method == "duplex" and (refine or not calibrated)
        self._learner = CalibrationLearner(setup.body, setup.calibration) if learns else None
        self._changes: list[CalibrationChange] = []
        self._sides = ExchangedSides()
        self._told: list[Told] = []

    def chosen(self, pair: FramePair) -> FramePair:
        """Returns the pair with the followed person chosen."""
        calibrator = self.calibrator
        b_from_a = self.setup.calibration.a_from_b.inverse() if calibrator.settled else None
        return self._people.chosen(pair, b_from_a)

    def recalibrated(self, pair: FramePair) -> bool:
        """Returns whether a new calibration is used from this pair on.

        It comes from the start-up pose or from the learner. The person of the pair must be chosen.
        """
        found = self.calibrator.watch(pair.skeletons)
        if found is not None:
            if self._learner is not None:
                self._learner.adopt(found)
            self._changes.clear()
        elif self._changes:
            found = self._changes[-1].calibration
            self._changes.clear()
        if found is None or found is self.setup.calibration:
            return False
        self.setup = FusionSetup(found, self.setup.settings, *self.setup.intrinsics)
        if self.setup.settings.method == "duplex":
            self._fuser.recalibrate(self.setup)
        else:
            self._fuser = Fuser(self.setup)
        return True

    def fuse(self, pair: FramePair) -> RecordedFrame:
        """Fuses a pair whose person is chosen; then passes the pair to the calibration learner."""
        frame = fuse_one(self._fuser, pair)
        self._told = self._sides.observe(frame.fused)
        if self._learner is not None and self.calibrator.settled:
            fused = frame.fused
            codes = fused.exchanged_a & WHOLE, fused.exchanged_b & WHOLE
            stale = fused.stale_a, fused.stale_b
            changes = self._learner.observe(pair.skeletons, codes, stale, pair.skeletons.skew_ns)
            self._changes += changes
            for change in changes:
                level = "WARN" if change.kind in ("knocked", "followed") else "INFO"
                self._told.append((change.event, level, "", "moment"))
        return frame

    def told(self) -> list[Told]:
        """Returns the events of the last pair: sides exchanged, calibration refined, sensor moved."""
        return self._told


def fuse_live(a: Sensor, b: Sensor, setup: FusionSetup | None = None) -> Iterator[RecordedFrame]:
    """Fuses the frames of two sensors as they arrive, until both sensors end.

    Each sensor runs on its own thread. A sensor that fails is reopened until it works again.

    Args:
        a, b: The principal sensor K_A and the secondary sensor K_B, both not yet open. S* is in K_A's frame.
        setup: A setup whose calibration is kept. None: calibrate while frames arrive.

    Raises:
        DeviceError: A sensor cannot be opened.
    """
    with TwoSensors(a, b) as sensors:
        calibrated = setup is not None
        setup = setup or FusionSetup(nominal_calibration(a.body), None, a.intrinsics, b.intrinsics)
        fusion = LiveFusion(setup, calibrated)
        for pair in sensors.pairs():
            pair = fusion.chosen(pair)
            fusion.recalibrated(pair)
            yield fusion.fuse(pair)
