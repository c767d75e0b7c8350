"""The picture of a set-up's state: told apart by everyone."""

import numpy as np
import pytest

from recordings.appearance.state_card import LOOKS, State, fits, state_card
from tests.recordings.test_appearance import contrast


def drawn(state, step=""):
    return state_card(state, step)


def inked(picture, state):
    """Where a picture has more of the ink than of the ground."""
    ink, ground = (np.abs(picture.astype(int) - color).sum(axis=2) for color in LOOKS[state][::-1])
    return ink < ground


@pytest.mark.parametrize("state", State)
def test_ink_stands_out_from_its_ground(state):
    assert contrast(*LOOKS[state]) >= 4.5


def test_states_differ_in_shape_too():
    shapes = [inked(drawn(state), state)[:130, :140] for state in State]
    for k, shape in enumerate(shapes):
        for other in shapes[:k]:
            assert (shape != other).mean() > 0.1


def test_a_long_step_is_drawn_smaller_and_stays_inside():
    long = "Only 30 degrees apart: " * 4
    assert not fits(long)
    assert fits(long[:50])
    picture = inked(drawn(State.NOT_YET, long), State.NOT_YET)
    assert not picture[[0, -1]].any()
    assert not picture[:, [0, -1]].any()
