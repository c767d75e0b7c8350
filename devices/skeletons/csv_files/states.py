"""Columns that say whether a joint is seen, under the names and values of several programs."""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from devices.skeletons.name_tables import plain
from fusion.skeleton import TrackingState

_LIKE_A_STATE = re.compile(
    r"(joints?|tracker|tracking|skeleton|body|k4abt)*"
    r"(state|status|(confidence|conf)(level)?|(is)?(tracked|visible|valid|seen|inferred)|visibility|score|quality)"
)
_PREFIX = re.compile(r"^(k4abt)?(joint)?(trackingstate|tracking|confidencelevel|confidence|state)(?=.)")
_NAMES = (
    "nottracked untracked none false no lost missing invisible",
    "inferred low occluded estimated predicted",
    "tracked tracking medium high true yes visible seen valid nan null",  # nan: whether there is a position
)
_WORDS = {"": 2} | {word: state for state, words in enumerate(_NAMES) for word in words.split()}
_OF_INFERRED = {"0": 2, "0.0": 2, "false": 2, "1": 1, "1.0": 1, "true": 1, "": 2, "nan": 2}
"""States by the values of a column that says whether a joint is inferred; others are not known."""
_MOST = 64
"""Distinct values; states are fewer."""


class StateColumn:
    """A column that may hold states; its values are collected block after block.

    Args:
        name: As in the file.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.values: list[str] = []
        self._codes: list[NDArray[np.uint8]] = []
        self._is_flag = plain(name).endswith("inferred")
        self.known = "0, 1, false, true" if self._is_flag else "tracked, inferred, not_tracked, or 3, 2, 1, 0"

    @staticmethod
    def is_like(name: str) -> bool:
        """Whether a column's name is that of states."""
        return _LIKE_A_STATE.fullmatch(plain(name)) is not None

    def append(self, values: Sequence[str], code: NDArray[np.int64]) -> None:
        """Adds rows: the distinct values, and which of them each row has."""
        number = {value: self.values.index(value) for value in values if value in self.values}
        for value in values:
            if value not in number and len(self.values) < _MOST:
                number[value] = len(self.values)
                self.values.append(value)
        of = np.array([number.get(value, _MOST) for value in values], dtype=np.uint8)
        self._codes.append(of[code])

    def keep(self, rows: NDArray[np.int64]) -> None:
        """Keeps some of the rows."""
        self._codes = [np.concatenate(self._codes)[rows]]

    def states(self) -> NDArray[np.uint8] | None:
        """(N,) states of all rows; None if a value is none.

        1 counts as tracked in a column that knows no more, unless it is called ``state``, and as inferred in
        one called ``inferred``.
        """
        found = [self._state_of(value) for value in self.values]
        if None in found or len(self.values) == _MOST:
            return None
        table = np.array(found, dtype=np.uint8)
        knows_more = self._is_flag or "state" in self.name.lower()
        if table.max(initial=0) == TrackingState.INFERRED and not knows_more:
            table[table == TrackingState.INFERRED] = TrackingState.TRACKED
        return table[np.concatenate(self._codes)]

    def refused(self) -> tuple[int, str]:
        """The first row whose value is no state, and that value."""
        bad = [k for k, value in enumerate(self.values) if self._state_of(value) is None]
        row = int(np.flatnonzero(np.isin(np.concatenate(self._codes), [*bad, _MOST]))[0])
        return row, self.values[bad[0]] if bad else "another value"

    def _state_of(self, value: str) -> int | None:
        return _OF_INFERRED.get(value.lower()) if self._is_flag else state_of(value)


def state_of(value: str) -> int | None:
    """A state from a number 0 to 3 or a word in any spelling; None if it is none.

    3 is the highest of Azure Kinect's levels of confidence.
    """
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if number in (0.0, 1.0, 2.0, 3.0):
        return min(int(number), 2)
    return _WORDS.get(_PREFIX.sub("", plain(value)))
