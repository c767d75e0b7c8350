"""Fuses live pairs: follows one person and calibrates while pairs arrive."""

from __future__ import annotations

from collections.abc import Iterator

from devices.following import PersonOfPair
from devices.live.sensor_pair import TwoSensors
from devices.pairing import FramePair
from devices.sensor import Sensor
from fusion.calibration.calibration import nominal_calibration
from fusion.calibration.calibrator import Calibrator
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.fusing import fuse_one
from recordings.session_arrays import RecordedFrame


class LiveFusion:
    """Fuses one pair after another to S*.

    Args:
        setup: The setup at the start.
        calibrated: Whether to keep the calibration of `setup`. If not, one is computed while pairs arrive.
    """

    def __init__(self, setup: FusionSetup, calibrated: bool = False) -> None:
        self.setup = setup
        """The setup used for the last pair."""
        self.calibrator = Calibrator(setup.body, setup.calibration if calibrated else None)
        self._fuser = Fuser(setup)
        self._people = PersonOfPair()

    def chosen(self, pair: FramePair) -> FramePair:
        """Returns the pair with the followed person chosen."""
        calibrator = self.calibrator
        b_from_a = calibrator.calibration.a_from_b.inverse() if calibrator.settled else None
        return self._people.chosen(pair, b_from_a)

    def recalibrated(self, pair: FramePair) -> bool:
        """Passes a pair with a chosen person to the calibrator; True if it completes a calibration.

        The new calibration applies from this pair on.
        """
        found = self.calibrator.watch(pair.skeletons)
        if found is None:
            return False
        intrinsics = self.setup.intrinsics
        self.setup = FusionSetup(found, self.setup.settings, *intrinsics)
        self._fuser = Fuser(self.setup)
        return True

    def fuse(self, pair: FramePair) -> RecordedFrame:
        """Fuses a pair with a chosen person."""
        return fuse_one(self._fuser, pair)


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
