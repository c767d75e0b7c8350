"""Calibration while pairs come in.

There are three ways, in this order: the start-up pose seen whole by both sensors; the pose seen in part,
where that determines R well enough; and movement, where the pose is never held or never seen.
"""

from __future__ import annotations

import numpy as np

from fusion.body import Body
from fusion.calibration.bone_lengths import robust_bone_lengths
from fusion.calibration.calibration import Calibration, calibrate, nominal_calibration
from fusion.calibration.movement import GradualCalibration
from fusion.calibration.start_up_pose import StartUpPose
from fusion.errors import CalibrationError
from fusion.registration.robust_fit import registration_of
from fusion.skeleton import SkeletonPair

_PROVISIONAL_PAIRS = 30
_CERTAIN, _FAR = np.radians(2.3), 0.05
"""Of a start-up pose seen in part: largest standard error of R, radians; distance of the views, metres."""


class Calibrator:
    """Finds a calibration while pairs come in: a provisional one at once, the final one on the start-up pose.

    Args:
        body: The sensors' body.
        calibration: An earlier calibration, which is then kept.
    """

    def __init__(self, body: Body, calibration: Calibration | None = None) -> None:
        self._body = body
        self._pose, self._partly = StartUpPose(body), StartUpPose(body, partly=True)
        self._gradual = GradualCalibration(body)
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
        found = self._from_pose(pair) or self._from_movement(pair)
        if found is not None:
            self._settled, self.calibration = True, found
            return found
        if len(self._seen) < _PROVISIONAL_PAIRS:
            self._seen.append(pair)
            if len(self._seen) in (1, _PROVISIONAL_PAIRS):
                frames = "frame" if len(self._seen) == 1 else "frames"
                return self._try(self._seen, f"provisional, {len(self._seen)} {frames} of any pose")
        return None

    def _from_pose(self, pair: SkeletonPair) -> Calibration | None:
        """The calibration of a start-up pose that ends with this pair."""
        held, partly = self._pose.watch(pair), self._partly.watch(pair)
        try:
            if held is not None:
                return calibrate(self._body, held, f"start-up pose, {len(held)} frames")
            if partly is not None and self._pose.held == 0.0:
                found = calibrate(self._body, partly, f"start-up pose seen in part, {len(partly)} frames")
                known = found.registration
                if known is not None and known.rotation_sd < _CERTAIN and known.residual_median < _FAR:
                    return found
        except CalibrationError:
            pass
        return None

    def _from_movement(self, pair: SkeletonPair) -> Calibration | None:
        """The calibration of the movement so far, once it is certain."""
        fitted = self._gradual.watch(pair, self.calibration.a_from_b)
        if fitted is None:
            return None
        fit, evidence = fitted
        nominal = self._body.nominal_lengths
        try:
            lengths = robust_bone_lengths(self._body, evidence, fit.a_from_b, nominal)
        except CalibrationError:
            lengths = self.calibration.bone_lengths
        how = f"movement, {len(evidence.a)} keyframes"
        registration = registration_of(self._body, evidence, fit)
        return Calibration(self._body, fit.a_from_b, lengths, how, registration)

    def _try(self, pairs: list[SkeletonPair], how: str) -> Calibration | None:
        try:
            self.calibration = calibrate(self._body, pairs, how)
        except CalibrationError:
            return None
        return self.calibration
