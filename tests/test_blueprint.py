"""Each layout is looked at: no view complains, none is empty."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rerun.experimental import ViewerClient

from fusion.body import KINECT_V2
from fusion.calibration import Calibration
from fusion.fuser import Fuser
from recordings.arrays import RecordedFrame
from recordings.coach_page import CoachPage
from tests.conftest import A_FROM_B
from tests.pictures import eventually, headless_viewer
from tests.test_live_session import BODY, frames
from viewer_app.blueprint import LAYOUTS, Layout, session_blueprint
from viewer_app.live_session import LiveSession

_NO_DEFECT = (
    "oftware rasterizer",  # there is no graphics card
    "not found for screenshot",  # a hidden view that this test asked for
    "Failed to detect GOP",  # said of every RVL image, which is drawn all the same: rerun issue 12801
)
_INK = 60
"""Above the dark theme's background and frames (at most 40) and below its text and lines."""


@pytest.fixture
def seen() -> tuple[Fuser, list[RecordedFrame]]:
    """Two seconds with depth images."""
    fuser = Fuser(Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known"))
    return fuser, frames(fuser, 60, depth=True)


def saved(path: Path, fuser: Fuser, made: list[RecordedFrame], active: Layout) -> Path:
    blueprint = session_blueprint(fuser, np.array([0.1, 0.1, 2.6]), active)
    with LiveSession(fuser, ("a", "b"), blueprint, file=path) as live:
        live.coach(CoachPage("- **Mend:** step into the view of sensor A, to 2.5 m from both sensors\n" * 6))
        live.event("calibrated: known")
        for frame in made:
            live.record(frame)
    return path


def expected(active: Layout) -> set[str]:
    """Names of the views that a layout shows before a tab is touched."""
    bones = {f"{KINECT_V2.bones[joint].replace('_', ' ')} (m)" for joint in KINECT_V2.bone_joints}
    if active == "report":
        return bones | {"how good"}
    if active == "setup":
        return {
            "Kinect A", "Kinect B", "sensors, skeletons, points", "what to do next", "events",
            "joints tracked by each sensor",
        }  # fmt: skip
    limbs = {bone for bone in bones if bone.startswith(("upper arm", "fore", "thigh", "shin"))}
    return limbs | {"S_A brown, S_B blue, S* purple", "whose view made each joint", "S_A against S_B (mm)"}


def ink(picture: NDArray[np.uint8]) -> float:
    """Share of a view that is drawn on; its title's bar is left out."""
    return float((picture[40:].max(axis=2) > _INK).mean())


@pytest.mark.parametrize("active", LAYOUTS)
def test_no_view_of_a_layout_complains_or_is_empty(
    active: Layout, seen: tuple[Fuser, list[RecordedFrame]], tmp_path: Path
) -> None:
    file = saved(tmp_path / "s.rrd", *seen, active)
    with headless_viewer(str(file)) as viewer:
        assert eventually(lambda: len(viewer.get_state().views) > 20)
        drawn = {}

        def all_drawn() -> bool:
            for view in viewer.get_state().views:
                if view.name not in expected(active) - drawn.keys():
                    continue
                if ink_of(viewer, view.view_id, tmp_path) > 0.002:
                    drawn[view.name] = True
            return drawn.keys() >= expected(active)

        assert eventually(all_drawn, 30.0), f"empty: {sorted(expected(active) - drawn.keys())}"
        complaints = [
            (view.name, report.summary) for view in viewer.get_state().views for report in view.reports
        ]
        assert complaints == []
        problems = [
            log.message
            for log in viewer.get_logs()
            if str(log.level).upper().endswith(("WARN", "ERROR"))
            and not any(known in log.message for known in _NO_DEFECT)
        ]
        assert problems == []


def ink_of(viewer: ViewerClient, view_id: str, folder: Path) -> float:
    """Of one view; 0 where it is not on the screen."""
    path = folder / "view.png"
    try:
        viewer.save_screenshot(str(path), view_id)
    except ConnectionError:
        return 0.0
    picture = cv2.imread(str(path))
    return 0.0 if picture is None else ink(np.asarray(picture))
