"""People with red-green colour blindness tell all colours apart that have to be told apart."""

import itertools

import numpy as np
import pytest
from skimage.color import deltaE_ciede2000, rgb2lab

from recordings.appearance.colors import (
    MARK_COLORS,
    PREDICTED_COLOR,
    SKELETON_COLORS,
    STATE_COLORS,
    VIEW_COLORS,
)

PROTAN = (0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998)
DEUTAN = (0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.011820, 0.042940, 0.968881)
VISION = np.eye(3), np.array(PROTAN), np.array(DEUTAN)
"""Linear RGB as seen without colour blindness, with protanopia and with deuteranopia: Machado et al. 2009."""
BODY = {**{key: SKELETON_COLORS[key] for key in ("a", "b", "fused")}, "predicted": PREDICTED_COLOR}
DARK, LIGHT = (13, 16, 17), (255, 255, 255)
"""Backgrounds of the viewer's themes and of the page."""


def linear(color):
    """(3,) of sRGB without its gamma."""
    srgb = np.array(color) / 255.0
    return np.asarray(np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4))


def least_distance(first, second):
    """CIEDE2000 between two colours, the least of all kinds of colour vision."""
    found = []
    for matrix in VISION:
        seen = [np.clip(matrix @ linear(each), 0.0, 1.0) for each in (first, second)]
        srgb = [np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055) for rgb in seen]
        found.append(float(deltaE_ciede2000(*(rgb2lab(rgb) for rgb in srgb))))
    return min(found)


def contrast(color, background):
    """Contrast of WCAG 2, from 1 to 21."""
    bright = sorted(float(linear(each) @ (0.2126, 0.7152, 0.0722)) + 0.05 for each in (color, background))
    return bright[1] / bright[0]


@pytest.mark.parametrize(
    "colors",
    [{"truth": SKELETON_COLORS["truth"], **BODY}, MARK_COLORS, dict(enumerate(STATE_COLORS))],
    ids=["body and truth", "marks", "states"],
)
def test_colors_that_stand_side_by_side_differ_for_everyone(colors):
    for one, other in itertools.combinations(colors, 2):
        assert least_distance(colors[one], colors[other]) > 20.0, (one, other)


@pytest.mark.parametrize("side", "ab")
def test_an_exchanged_view_differs_from_its_own_and_from_the_other(side):
    for exchanged in (VIEW_COLORS[side][2], SKELETON_COLORS[f"exchanged_{side}"]):
        assert all(least_distance(exchanged, VIEW_COLORS[other][0]) > 12.0 for other in "ab")


@pytest.mark.parametrize("name", MARK_COLORS)
def test_a_mark_differs_from_the_body(name):
    assert all(least_distance(MARK_COLORS[name], color) > 10.0 for color in BODY.values())


@pytest.mark.parametrize("name", BODY)
def test_a_color_is_seen_on_dark_and_on_light(name):
    assert contrast(BODY[name], DARK) > 3.0
    assert contrast(BODY[name], LIGHT) > 2.0
