"""S* is a body in the scene, S_A and S_B are thin, and both show where they come from."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fusion.skeleton import TrackingState
from recordings import layout
from recordings.appearance.colors import SKELETON_COLORS, VIEW_COLORS
from recordings.session_arrays import SessionArrays, SessionFrame
from tests.helpers.live_frames import BODY, frames, inspected_scenes, known_fuser, session_of_view
from tests.helpers.pictures import headless_viewer, picture_of, pixels_near
from tests.helpers.shown_values import shown_values
from tests.helpers.waiting import eventually


def picture(made: list[SessionFrame], folder: Path) -> NDArray[np.uint8]:
    """The scene, as soon as the viewer draws it."""
    with headless_viewer(str(session_of_view(inspected_scenes()[0], made, folder))) as viewer:
        drawn: list[NDArray[np.uint8]] = []

        def settled() -> bool:
            drawn.append(picture_of(viewer, folder / "w.png"))
            return (
                len(drawn) > 1 and bool((drawn[-1] == drawn[-2]).all()) and shaded(drawn[-1], "fused") > 500
            )

        assert eventually(settled, 30.0)
        assert [report for view in viewer.get_state().views for report in view.reports] == []
        return drawn[-1]


def shaded(seen: NDArray[np.uint8], key: str) -> int:
    """Pixels of a colour in any light: its hue within 12°, and clearly coloured."""
    hsv = cv2.cvtColor(seen, cv2.COLOR_RGB2HSV).astype(int)
    wanted = np.array([[SKELETON_COLORS[key]]], dtype=np.uint8)
    hue = int(cv2.cvtColor(wanted, cv2.COLOR_RGB2HSV)[0, 0, 0])
    off = np.abs(hsv[..., 0] - hue)
    return int(((np.minimum(off, 180 - off) <= 6) & (hsv[..., 1] > 100) & (hsv[..., 2] > 60)).sum())


def test_the_fused_skeleton_is_a_body_and_the_views_are_lines(tmp_path: Path) -> None:
    """Views and S* agree here: thick lines would hide much of the body."""
    seen = picture(frames(known_fuser(), 10), tmp_path)
    person = seen[:, seen.shape[1] // 3 : 2 * seen.shape[1] // 3]  # the sensors are outside
    assert shaded(person, "fused") > 5 * (shaded(person, "a") + shaded(person, "b"))
    # seen from the side it is about 1.75 m high and 0.12 m wide on average, in a window some 3 m high;
    # lines of three pixels would cover a tenth of that
    assert shaded(person, "fused") > 0.5 * 1.75 * 0.12 * (seen.shape[0] / 3.0) ** 2 / 2.0


def test_a_body_without_a_person_is_not_drawn_and_not_a_fault(tmp_path: Path) -> None:
    made = frames(known_fuser(), 10)
    nobody = np.full_like(made[-1].fused.positions, np.nan)
    made[-1] = replace(made[-1], fused=replace(made[-1].fused, positions=nobody))
    with headless_viewer(str(session_of_view(inspected_scenes()[0], made, tmp_path))) as viewer:

        def shaded_at(frame: int) -> int:
            with contextlib.suppress(ConnectionError, RuntimeError, ValueError):  # not loaded yet
                viewer.set_time(layout.FRAME, sequence=frame, play_state="paused")
            return shaded(picture_of(viewer, tmp_path / "w.png"), "fused")

        assert eventually(lambda: shaded_at(5) > 500, 30.0)
        assert eventually(lambda: shaded_at(9) < 50, 30.0)
        assert [report for view in viewer.get_state().views for report in view.reports] == []


@pytest.mark.parametrize("side", layout.SIDES)
def test_joints_of_a_view_are_dimmed_where_inferred_or_exchanged(side: str) -> None:
    made = frames(known_fuser(), 3)
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, made)
    states = {name: getattr(rows, f"states_{name}").copy() for name in layout.SIDES}
    states[side][1, 5] = TrackingState.INFERRED
    exchanged = np.zeros((3, 2), dtype=np.int8)
    exchanged[2, layout.SIDES.index(side)] = 3
    told = replace(rows, states_a=states["a"], states_b=states["b"], exchanged=exchanged)
    colors = shown_values(told, layout.skeleton(side), "Points3D:colors")
    assert colors is not None
    tracked, inferred, swapped = VIEW_COLORS[side]
    assert (colors[0] == tracked).all()
    assert (colors[1, 5] == inferred).all()
    assert (np.delete(colors[1], 5, axis=0) == tracked).all()
    assert (colors[2] == swapped).all()
    assert max(inferred) < 0.75 * max(tracked)
    assert max(swapped) < 0.75 * max(SKELETON_COLORS[layout.exchanged(side)])


def test_an_exchanged_view_looks_other_than_a_tracked_one(tmp_path: Path) -> None:
    made = frames(known_fuser(), 10)
    away = np.array([0.4, 0.0, 0.0])
    aside = [replace(f, fused=replace(f.fused, positions=f.fused.positions + away)) for f in made]
    swapped = [replace(f, fused=replace(f.fused, exchanged_b=3)) for f in aside]
    color = VIEW_COLORS["b"][2]
    (tmp_path / "t").mkdir()
    (tmp_path / "x").mkdir()
    tracked = pixels_near(picture(aside, tmp_path / "t"), color, 20)
    assert pixels_near(picture(swapped, tmp_path / "x"), color, 20) > tracked + 50
