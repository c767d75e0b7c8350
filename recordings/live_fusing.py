"""Pairs fused as they come: the person followed, the calibration found on the way."""

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
    """Makes S* of one pair after the other.

    Args:
        setup: To begin with.
        calibrated: Whether to keep its calibration; else one is found while pairs come in.
    """

    def __init__(self, setup: FusionSetup, calibrated: bool = False) -> None:
        self.setup = setup
        """What the last pair was fused with."""
        self.calibrator = Calibrator(setup.body, setup.calibration if calibrated else None)
        self._fuser = Fuser(setup)
        self._people = PersonOfPair()

    def chosen(self, pair: FramePair) -> FramePair:
        """The pair with the person who is followed."""
        calibrator = self.calibrator
        b_from_a = calibrator.calibration.a_from_b.inverse() if calibrator.settled else None
        return self._people.chosen(pair, b_from_a)

    def recalibrated(self, pair: FramePair) -> bool:
        """Whether the pair, whose person is chosen, completes a new calibration, which is then used."""
        found = self.calibrator.watch(pair.skeletons)
        if found is None:
            return False
        intrinsics = self.setup.intrinsics
        self.setup = FusionSetup(found, self.setup.settings, *intrinsics)
        self._fuser = Fuser(self.setup)
        return True

    def fuse(self, pair: FramePair) -> RecordedFrame:
        """S* of the pair, whose person is chosen."""
        return fuse_one(self._fuser, pair)


def fuse_live(a: Sensor, b: Sensor, setup: FusionSetup | None = None) -> Iterator[RecordedFrame]:
    """Fuses what two sensors give, as they give it, until both have ended.

    The sensors run on threads of their own; a sensor that fails is waited for and comes back.

    Args:
        a, b: The principal sensor K_A, in whose frame S* is, and the secondary one K_B; not yet open.
        setup: With a calibration to keep; one is found while frames come in where None.

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
