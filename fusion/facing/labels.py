"""What is known about the sides and the heading of pairs before they are fused."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.errors import FusionError
from fusion.support.array_fields import new_arrays

DOUBT_STEPS, HEADING_STEPS = 255, 1024
"""Sessions store doubt and heading in steps of 1/255 and 1/1024."""


class Labels(NamedTuple):
    """Exchanged sides and heading of T pairs. Each value that is missing is found by the facing filter."""

    codes: Annotated[NDArray[np.int8], ("T", 2), -1]
    """Exchange codes of A and of B (:mod:`fusion.facing.model`); -1 where missing."""
    doubt: Annotated[NDArray[np.float32], ("T", 2), np.nan]
    """Probability that the sides of A and of B are wrong all the same; NaN where missing."""
    heading: Annotated[NDArray[np.float32], ("T", 3), np.nan]
    """The direction in which the person faces, normal to the body's axis (:mod:`fusion.facing.evidence`), in
    K_A's frame; its length, from 0 to 1, is the confidence: that of the mean of the unit vectors of all
    headings. NaN where missing."""
    mirrored: Annotated[NDArray[np.float32], ("T", 2), np.nan]
    """Probability that A and B report the person mirrored; a result only."""

    @staticmethod
    def unknown(pairs: int) -> Labels:
        """Those of T pairs of which nothing is known."""
        return new_arrays(Labels, T=pairs)

    @staticmethod
    def with_sides(codes: ArrayLike, doubt: ArrayLike = 0.0) -> Labels:
        """Those with known (T, 2) exchange codes and a doubt; the heading is missing."""
        labels = Labels.unknown(len(np.asarray(codes)))
        labels.codes[:], labels.doubt[:] = codes, doubt
        return labels

    @staticmethod
    def joined(parts: Iterable[Labels]) -> Labels:
        """Those of consecutive pairs."""
        each: Any = zip(Labels.unknown(0), *parts, strict=True)
        return Labels(*map(np.concatenate, each))

    def of_pairs(self, pairs: int) -> Labels:
        """These labels, which a kernel reads by the number of the pair.

        Raises:
            FusionError: They are not of T = ``pairs`` pairs.
        """
        if any(len(values) != pairs for values in self):
            raise FusionError(f"Labels of {len(self.codes)} pairs are given for {pairs}.")
        return self

    def rows(self, pairs: slice) -> Labels:
        """Those of some of the pairs."""
        each: Any = self
        return Labels(*(values[pairs] for values in each))

    def as_stored(self) -> Labels:
        """Rounded as a session stores them."""
        doubt, heading = np.round(DOUBT_STEPS * self.doubt), np.round(HEADING_STEPS * self.heading)
        return self._replace(
            doubt=(doubt / DOUBT_STEPS).astype(np.float32),
            heading=(heading / HEADING_STEPS).astype(np.float32),
        )
