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
MOST_STATES = 64
"""Distinct values, and more; states are fewer."""


def is_like_states(name: str) -> bool:
    """Whether a column's name is that of states."""
    return _LIKE_A_STATE.fullmatch(plain(name)) is not None


def states_of(name: str, values: Sequence[str]) -> tuple[NDArray[np.uint8], str, str]:
    """The states of the values of a column; the first value that is none, if any; and what is known.

    1 counts as tracked in a column that knows no more, unless it is called ``state``, and as inferred in
    one called ``inferred``.
    """
    of_inferred = plain(name).endswith("inferred")
    known = "0, 1, false, true" if of_inferred else "tracked, inferred, not_tracked, or 3, 2, 1, 0"
    found = [_OF_INFERRED.get(value.lower()) if of_inferred else _state_of(value) for value in values]
    if None in found or len(found) >= MOST_STATES:
        return np.zeros(0, np.uint8), values[found.index(None) if None in found else -1], known
    states = np.array(found, dtype=np.uint8)
    knows_more = of_inferred or "state" in name.lower()
    if states.max(initial=0) == TrackingState.INFERRED and not knows_more:
        states[states == TrackingState.INFERRED] = TrackingState.TRACKED
    return states, "", known


def _state_of(value: str) -> int | None:
    """A state from a number 0 to 3 or a word in any spelling; None if it is none.

    3 is the highest of Azure Kinect's levels of confidence.
    """
    try:
        number = float(value)
    except ValueError:
        return _WORDS.get(_PREFIX.sub("", plain(value)))
    return min(int(number), 2) if number in range(4) else _WORDS.get(value.lower())
