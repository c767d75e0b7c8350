"""Pictures of each layout: no view reports a problem, and none is empty."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rerun.experimental import ViewerClient

from devices.live.sensor_pair import StreamFigures
from fusion.body import BODIES, KINECT_V2, Body
from fusion.calibration.calibration import Calibration, nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings import layout
from recordings.appearance.coach_page import CoachPage
from recordings.session_arrays import RecordedFrame
from tests.helpers.live_frames import BODY, frames
from tests.helpers.pictures import headless_viewer, pixels_near
from tests.helpers.two_views import A_FROM_B
from tests.helpers.waiting import eventually
from viewer_app.sinks.live_session import LiveSession
from viewer_app.viewer.blueprint import LAYOUTS, Layout, bone_title, session_blueprint

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
    fuser = Fuser(FusionSetup(Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known")))
    return fuser, frames(fuser, 60, depth=True)


def saved(path: Path, fuser: Fuser, made: list[RecordedFrame], active: Layout) -> Path:
    blueprint = session_blueprint(fuser.setup, np.array([0.1, 0.1, 2.6]), active)
    with LiveSession(fuser.setup, ("a", "b"), blueprint, file=path) as live:
        live.coach(CoachPage("- **Mend:** step into the view of sensor A, to 2.5 m from both sensors\n" * 6))
        live.event("calibrated: known")
        for frame in made:
            live.write(frame)
    return path


def expected(active: Layout) -> set[str]:
    """Names of the views that a layout shows at first."""
    if active == "report":
        bones = {bone_title(KINECT_V2.bones[joint]) for joint in KINECT_V2.bone_joints}
        return bones | {"how good; above: bones in m, S_A brown, S_B blue, S* purple, target grey"}
    if active == "setup":
        return {
            "Kinect A", "Kinect B", "sensors, skeletons, points", "what to do next", "events",
            "joints tracked by each sensor",
        }  # fmt: skip
    limbs = {f"{side} {bone} (m)" for side in "LR" for bone in ("upper arm", "forearm", "thigh", "shin")}
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


def test_a_plot_of_one_figure_has_no_line_of_the_streams(tmp_path: Path) -> None:
    fuser = Fuser(FusionSetup(Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known")))
    made = [
        replace(frame, streams=StreamFigures(3.0, (5 * k, 9 * k), (7 * k, 4 * k)))
        for k, frame in enumerate(frames(fuser, 90))
    ]
    blueprint = session_blueprint(fuser.setup, np.array([0.1, 0.1, 2.6]), "inspect", live=True)
    file = tmp_path / "s.rrd"
    with LiveSession(fuser.setup, ("a", "b"), blueprint, file=file) as live:
        for frame in made:
            live.write(frame)
    with headless_viewer(str(file)) as viewer:
        picture = tmp_path / "plot.png"

        def of_plot() -> NDArray[np.uint8] | None:
            plots = [v for v in viewer.get_state().views if v.name == "S_A against S_B (mm)"]
            if not plots or ink_of(viewer, plots[0].view_id, tmp_path) < 0.002:
                return None
            viewer.save_screenshot(str(picture), plots[0].view_id)
            return np.asarray(cv2.imread(str(picture))[40:, :, ::-1])

        assert eventually(
            lambda: (
                (seen := of_plot()) is not None
                and pixels_near(seen, layout.SKELETON_COLORS["fused"], 40) > 50
            ),
            30.0,
        )
        plot = of_plot()
        assert plot is not None
        for side in layout.SIDES:
            assert pixels_near(plot, layout.SKELETON_COLORS[side], 40) == 0


def test_states_of_the_limbs_stand_second_among_the_tabs() -> None:
    fuser = Fuser(FusionSetup(Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known")))
    inspect = session_blueprint(fuser.setup, np.array([0.1, 0.1, 2.6]), "inspect").root_container.contents[1]
    tabs = inspect.contents[0].contents[1]
    assert [view.name for view in tabs.contents][:2] == ["S_A against S_B (mm)", "states, limbs"]


@pytest.mark.parametrize("body", BODIES.values(), ids=lambda body: body.name)
def test_a_report_has_full_rows_and_short_titles(body: Body) -> None:
    setup = FusionSetup(nominal_calibration(body))
    *rows, words = (
        session_blueprint(setup, np.array([0.1, 0.1, 2.6]), "report").root_container.contents[2].contents
    )
    counts = [len(row.contents) for row in rows]
    assert sum(counts) == len(body.bone_joints)
    assert max(counts) <= 6
    assert max(counts) - min(counts) <= 1
    assert max(len(plot.name) for row in rows for plot in row.contents) <= len("L upper arm")
    assert words.name.startswith("how good")
