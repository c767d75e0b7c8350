"""Random numbers of a simulation, by name: what one error draws changes no other error."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

import numpy as np

_BOTH = 2


@dataclass(frozen=True)
class Streams:
    """The random streams of one sensor.

    The key of a stream is its name, not the order in which streams are asked for. Keys are spawn keys of
    ``numpy.random.SeedSequence``, which keeps them apart from the seed; a seed may have 128 bits.
    """

    seed: int
    which: int  # 0 for sensor A, 1 for B
    person: int = 0  # of several people: whose errors these are

    def named(self, name: str, *numbers: int) -> np.random.Generator:
        """A new generator at the start of the stream of this name, and of these numbers (of a frame)."""
        key = (self.which + (_BOTH + 1) * self.person, zlib.crc32(name.encode()), *numbers)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))

    @property
    def of_both(self) -> Streams:
        """The streams that both sensors share."""
        return replace(self, which=_BOTH)
