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
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.exchanged_sides import ExchangedSides, Told
from recordings.fusing import fuse_one
from recordings.session_arrays import RecordedFrame


class LiveFusion:
    """Fuses one pair after another to S*.

    Args:
        setup: To begin with.
        calibrated: Whether to keep its calibration; else one is found while pairs come in, and refined.
        refine: Whether a calibration that is kept is refined as well.
    """

    def __init__(self, setup: FusionSetup, calibrated: bool = False, refine: bool = False) -> None:
        self.setup = setup
        """What the last pair was fused with."""
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
        """Whether a new calibration is used from this pair on, whose person is chosen.

        The start-up pose gives one, or what was learned from the pairs before.
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
        """S* of the pair, whose person is chosen; the pair then teaches the calibration."""
        frame = fuse_one(self._fuser, pair)
        self._told = self._sides.observe(frame.fused)
        if self._learner is not None and self.calibrator.settled:
            fused = frame.fused
            codes = fused.exchanged_a & _LIMBS, fused.exchanged_b & _LIMBS
            stale = fused.stale_a, fused.stale_b
            changes = self._learner.observe(pair.skeletons, codes, stale, pair.skeletons.skew_ns)
            self._changes += changes
            for change in changes:
                level = "WARN" if change.kind in ("knocked", "followed") else "INFO"
                self._told.append((change.event, level, "", "moment"))
        return frame

    def told(self) -> list[Told]:
        """What happened with the last pair: sides exchanged, a refined calibration, a sensor that moved."""
        return self._told


_LIMBS = 3  # arms and legs of an exchange code


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
