"""Calibration while pairs come in."""

from __future__ import annotations

from fusion.body import Body
from fusion.calibration.calibration import Calibration, calibrate, nominal_calibration
from fusion.calibration.start_up_pose import StartUpPose
from fusion.errors import CalibrationError
from fusion.skeleton import SkeletonPair

_PROVISIONAL_PAIRS = 30


class Calibrator:
    """Finds a calibration while pairs come in: a provisional one at once, the final one on the start-up pose.

    Args:
        body: The sensors' body.
        calibration: An earlier calibration, which is then kept.
    """

    def __init__(self, body: Body, calibration: Calibration | None = None) -> None:
        self._body = body
        self._pose = StartUpPose(body)
        self._seen: list[SkeletonPair] = []
        self._settled = calibration is not None
        self.calibration = calibration or nominal_calibration(body)

    @property
    def settled(self) -> bool:
        """Whether the calibration is final."""
        return self._settled

    @property
    def held(self) -> float:
        """Seconds for which the start-up pose has been held."""
        return self._pose.held

    def watch(self, pair: SkeletonPair) -> Calibration | None:
        """Takes the next pair.

        Returns:
            The new calibration where this pair completes one, else None.
        """
        if self._settled or pair.a is None or pair.b is None:
            return None
        held = self._pose.watch(pair)
        if held is not None:
            found = self._try(held, f"start-up pose, {len(held)} frames")
            self._settled = found is not None
            return found
        if len(self._seen) < _PROVISIONAL_PAIRS:
            self._seen.append(pair)
            if len(self._seen) in (1, _PROVISIONAL_PAIRS):
                frames = "frame" if len(self._seen) == 1 else "frames"
                return self._try(self._seen, f"provisional, {len(self._seen)} {frames} of any pose")
        return None

    def _try(self, pairs: list[SkeletonPair], how: str) -> Calibration | None:
        try:
            self.calibration = calibrate(self._body, pairs, how)
        except CalibrationError:
            return None
        return self.calibration
