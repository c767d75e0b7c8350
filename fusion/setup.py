"""The inputs of a fusion besides skeletons: calibration, settings and both depth cameras."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.errors import BodyError, FusionError
from fusion.intrinsics import NOMINAL_INTRINSICS, Intrinsics

Method = Literal["duplex", "paper", "published"]
Hindsight = Literal["none", "labels", "whole"]
REVISIONS: dict[Method, int] = {"duplex": 15, "paper": 1, "published": 1}
"""Revision of each method; raised by a change of S*. That of ``duplex`` in version 1.0 is 1."""
PAPER_H = 0.786
"""h of sec. 3: weight of a tracked joint relative to an inferred one."""
DEFAULT_SMOOTHING = 0.5
"""The smoothing at which :class:`fusion.estimator.constants.Constants` were fitted."""


@dataclass(frozen=True)
class FuserSettings:
    """Settings of the method. Defaults are the paper's values where it gives them.

    Attributes:
        method: ``duplex``: an estimator in time (:mod:`fusion.estimator`). ``paper``: eqs. (10)-(13), with
            t in every frame and exact bones. ``published``: also eqs. (3)-(9); bone lengths are approximate.
        h: How much more a tracked joint counts than an inferred one, in (0.5, 1), sec. 3. Not for ``duplex``.
        weights: ``paper`` (eqs. (10), (11)) or ``equal``. Not for ``duplex``.
        smoothing: Smoothness of S*, from 0 (each frame on its own) to 1. ``duplex`` only.
        hindsight: Use of later frames in a recording. ``none``: as live. ``labels``: for exchanged sides
            (:func:`fusion.plan.plan_recording`). ``whole``: for everything, by a fixed-interval
            smoother. ``duplex`` only.
    """

    method: Method = "duplex"
    h: float = PAPER_H
    weights: Literal["paper", "equal"] = "paper"
    smoothing: float = DEFAULT_SMOOTHING
    hindsight: Hindsight = "none"

    def __post_init__(self) -> None:
        if self.method not in ("duplex", "paper", "published"):
            raise FusionError(f"The method is duplex, paper or published; got {self.method!r}.")
        if self.hindsight not in ("none", "labels", "whole"):
            raise FusionError(f"hindsight is none, labels or whole; got {self.hindsight!r}.")
        if not 0.5 < self.h < 1.0:
            raise FusionError(f"h must lie between 0.5 and 1 (sec. 3); got {self.h}.")
        if not 0.0 <= self.smoothing <= 1.0:
            raise FusionError(f"smoothing must lie between 0 and 1; got {self.smoothing}.")


@dataclass(frozen=True, eq=False, init=False)
class FusionSetup:
    """Configures a :class:`fusion.fuser.Fuser`; sessions, viewers and reports share it.

    Attributes:
        calibration: R, t and the bone lengths.
        settings: The method and its parameters.
        intrinsics_a, intrinsics_b: The sensors' depth cameras.
    """

    calibration: Calibration
    settings: FuserSettings
    intrinsics_a: Intrinsics
    intrinsics_b: Intrinsics

    def __init__(
        self,
        calibration: Calibration,
        settings: FuserSettings | None = None,
        intrinsics_a: Intrinsics | None = None,
        intrinsics_b: Intrinsics | None = None,
    ) -> None:
        """Takes the default settings and the sensor family's nominal cameras where None.

        Raises:
            BodyError: The bone lengths are not those of the body's joints.
            FusionError: A bone has no positive length.
        """
        body = calibration.body
        if calibration.bone_lengths.shape != (len(body),):
            shape = calibration.bone_lengths.shape
            raise BodyError(f"{body.name} has {len(body)} joints; bone lengths have shape {shape}.")
        bones = calibration.bone_lengths[body.bone_joints]
        if not (np.isfinite(bones).all() and (bones > 0.0).all()):
            raise FusionError(f"Every bone needs a length of more than 0 m; the shortest is {bones.min()} m.")
        object.__setattr__(self, "calibration", calibration)
        object.__setattr__(self, "settings", settings or FuserSettings())
        object.__setattr__(self, "intrinsics_a", intrinsics_a or NOMINAL_INTRINSICS[body.name])
        object.__setattr__(self, "intrinsics_b", intrinsics_b or NOMINAL_INTRINSICS[body.name])

    @property
    def body(self) -> Body:
        """The body that both sensors report."""
        return self.calibration.body

    @property
    def intrinsics(self) -> tuple[Intrinsics, Intrinsics]:
        """The depth cameras of A and B."""
        return self.intrinsics_a, self.intrinsics_b
