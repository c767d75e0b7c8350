"""The picture of a set-up's state: told apart by everyone."""

import numpy as np
import pytest

from recordings.appearance.coach_page import CoachPage
from recordings.appearance.state_card import LOOKS, State, fits, state_card
from recordings.data import layout
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


def test_a_file_has_the_state_as_text():
    page = CoachPage("B: mirror image", card=(State.NOT_YET, "Turn mirroring off in B"))
    of_file, of_viewer = (dict(page.entities(card)) for card in (False, True))
    assert layout.COACH_CARD in of_viewer
    assert layout.COACH_CARD not in of_file
    texts = [each[layout.COACH][0].text.as_arrow_array().to_pylist()[0] for each in (of_file, of_viewer)]
    assert texts == ["## NOT YET: Turn mirroring off in B\n\nB: mirror image", "B: mirror image"]
