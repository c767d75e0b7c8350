"""The choices the method leaves open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fusion.errors import FusionError
from fusion.estimator.constants import DEFAULT_SMOOTHING
from fusion.methods.reliability import PAPER_H

Method = Literal["duplex", "paper", "published"]


@dataclass(frozen=True)
class FuserSettings:
    """The choices the method leaves open, with the paper's values where it names one.

    Attributes:
        method: ``duplex``: an estimator in time (:mod:`fusion.estimator`). ``paper``: eqs. (10)-(13), t in
        every
            frame, with bones exact. ``published``: eqs. (3)-(9) as well, whose bones are only nearly right.
        h: How much more a tracked joint counts than an inferred one, in (0.5, 1); sec. 3. Not of ``duplex``.
        weights: ``paper`` (eqs. (10), (11)) or ``equal``. Not of ``duplex``.
        smoothing: How calm S* is, from 0 (each frame by itself) to 1. Of ``duplex`` only.
    """

    method: Method = "duplex"
    h: float = PAPER_H
    weights: Literal["paper", "equal"] = "paper"
    smoothing: float = DEFAULT_SMOOTHING

    def __post_init__(self) -> None:
        if not 0.5 < self.h < 1.0:
            raise FusionError(f"h must lie between 0.5 and 1 (sec. 3); got {self.h}.")
        if not 0.0 <= self.smoothing <= 1.0:
            raise FusionError(f"smoothing must lie between 0 and 1; got {self.smoothing}.")
        if self.method not in ("duplex", "paper", "published"):
            raise FusionError(f"The method is duplex, paper or published; got {self.method!r}.")
