"""The layouts on a session, and S* as a body in the scene."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import rerun.blueprint as rrb

from devices.events import Event
from fusion.body import BODIES, KINECT_V2
from fusion.calibration.calibration import Calibration, nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import TrackingState
from recordings.appearance.coach_page import CoachPage
from recordings.appearance.colors import SKELETON_COLORS, VIEW_COLORS
from recordings.data import layout
from recordings.data.session_arrays import SessionArrays
from recordings.writing.shown_figures import SHOWN_FIGURES
from tests.helpers.live_frames import BODY, frames, known_fuser
from tests.helpers.pictures import headless_viewer
from tests.helpers.two_views import A_FROM_B
from tests.helpers.waiting import eventually
from viewer_app.sinks.live_session import LiveSession
from viewer_app.viewer.blueprint import LAYOUTS, SCENE, bone_title, session_blueprint

_NO_DEFECT = (
    "oftware rasterizer",  # there is no graphics card
    "not found for screenshot",  # a hidden view that this test asked for
    "Failed to detect GOP",  # said of every RVL image, which is drawn all the same: rerun issue 12801
)
_INK = 60
"""Above the dark theme's background and frames (at most 40) and below its text and lines."""


@pytest.fixture
def seen():
    """Two seconds with depth images."""
    fuser = Fuser(FusionSetup(Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known")))
    return fuser, frames(fuser, 60, depth=True)


def saved(path, fuser, made, active):
    blueprint = session_blueprint(fuser.setup, np.array([0.1, 0.1, 2.6]), active)
    with LiveSession(fuser.setup, ("a", "b"), blueprint, file=path) as live:
        live.coach(CoachPage("- **Mend:** step into the view of sensor A, to 2.5 m from both sensors\n" * 6))
        live.event(Event("calibrated: known"))
        for frame in made:
            live.write(frame)
    return path


def expected(active):
    """Names of the views that a layout shows at first."""
    if active == "report":
        bones = [KINECT_V2.bones[joint] for joint in KINECT_V2.bone_joints]
        quality = {"how good", "views differ (mm)", "jitter (mm)", "placement of B"}
        return {bone_title(bone) for bone in bones if not bone.endswith("_right")} | quality
    if active == "setup":
        return {"Kinect A", "Kinect B", "sensors and person", "how good"}
    if active == "angles":
        limbs = ("hip flexion", "knee flexion", "hip abduction", "elbow flexion", "shoulder flexion")
        return {f"{name} (°)" for name in (*limbs, "shoulder abduction", "trunk")}
    limbs = {"upper arms (m)", "forearms (m)", "thighs (m)", "shins (m)"}
    return limbs | {SCENE, "how good it is; which sensor each limb follows", "views differ (mm)"}


def ink(picture):
    """Share of a view that is drawn on; its title's bar is left out."""
    return float((picture[40:].max(axis=2) > _INK).mean())


@pytest.mark.parametrize("active", LAYOUTS)
def test_no_view_of_a_layout_complains_or_is_empty(active, seen, tmp_path):
    file = saved(tmp_path / "s.rrd", *seen, active)
    with headless_viewer(str(file)) as viewer:
        assert eventually(lambda: len(viewer.get_state().views) > 20)
        drawn = {}

        def all_drawn():
            for view in viewer.get_state().views:
                if view.name not in expected(active) - drawn.keys():
                    continue
                if ink_of(viewer, view.view_id, tmp_path) > 0.002:
                    drawn[view.name] = True
            return drawn.keys() >= expected(active)

        assert eventually(all_drawn, 30.0), f"empty: {sorted(expected(active) - drawn.keys())}"
        complaints = [(view.name, each.summary) for view in viewer.get_state().views for each in view.reports]
        assert complaints == []
        logs = [log for log in viewer.get_logs() if str(log.level).upper().endswith(("WARN", "ERROR"))]
        assert [log.message for log in logs if not any(known in log.message for known in _NO_DEFECT)] == []


def test_the_eye_follows_the_person(seen, tmp_path):
    fuser, made = seen
    offsets = {0.5: (0.0, 0.0, 0.0), 1.5: (1.5, 0.0, 1.0)}  # metres, by seconds
    file = tmp_path / "s.rrd"
    for number, frame in enumerate(made):
        joints = frame.fused.positions + offsets[0.5 if number < 30 else 1.5]
        made[number] = replace(frame, fused=replace(frame.fused, positions=joints))
    saved(file, fuser, made, "inspect")
    middles = {}
    with headless_viewer(str(file)) as viewer:
        assert eventually(lambda: len(viewer.get_state().views) > 20)
        scene = next(view.view_id for view in viewer.get_state().views if view.name == SCENE)

        def drawn(moment):
            viewer.set_time(layout.TIME, duration=moment, play_state="paused")
            if ink_of(viewer, scene, tmp_path) > 0.002:
                picture = cv2.imread(str(tmp_path / "view.png")).astype(int)
                red_over_green = np.abs(picture[..., 2] - picture[..., 1])  # the floor is grey
                there = np.argwhere(red_over_green > _INK)
                middle = np.median(there, axis=0) / picture.shape[:2] if len(there) else np.zeros(2)
                middles.setdefault(moment, []).append(middle)
            found = middles.get(moment, [])
            return len(found) > 3 and np.allclose(found[-3:], found[-1], atol=1e-3)

        for moment in offsets:
            assert eventually(lambda moment=moment: drawn(moment), 60.0)
    for moment in offsets:
        np.testing.assert_allclose(middles[moment][-1], 0.5, atol=0.06, err_msg=f"at {moment} s")


def ink_of(viewer, view_id, folder):
    """Of one view; 0 where it is not on the screen."""
    path = folder / "view.png"
    try:
        viewer.save_screenshot(str(path), view_id)
    except ConnectionError:
        return 0.0
    picture = cv2.imread(str(path))
    return 0.0 if picture is None else ink(np.asarray(picture))


def layouts(body):
    blueprint = session_blueprint(
        FusionSetup(nominal_calibration(body)), np.array([0.1, 0.1, 2.6]), "inspect"
    )
    return {tab.name: tab for tab in blueprint.root_container.contents}


def panes(container):
    """The views that are seen at once: of a group of tabs only the first."""
    if isinstance(container, rrb.View):
        return [container]
    contents = container.contents[:1] if isinstance(container, rrb.Tabs) else container.contents
    return [view for content in contents for view in panes(content)]


def test_a_session_without_depth_images_promises_none():
    tabs = {}
    images = {}
    for depth in (False, True):
        blueprint = session_blueprint(
            FusionSetup(nominal_calibration(KINECT_V2)), np.array([0.1, 0.1, 2.6]), "inspect", depth=depth
        )
        setup, inspect, *_ = blueprint.root_container.contents
        tabs[depth] = [view.name for view in inspect.contents[0].contents[0].contents]
        images[depth] = [view.name for view in panes(setup)[:2]]
    assert tabs == {
        False: [SCENE, "spheres: 1 σ of a joint"],
        True: [SCENE, "spheres: 1 σ of a joint", "point clouds"],
    }
    assert images == {
        False: ["Kinect A: its skeleton", "Kinect B: its skeleton"], True: ["Kinect A", "Kinect B"],
    }  # fmt: skip


@pytest.mark.parametrize("live", [False, True])
def test_the_quality_of_each_second_is_announced_where_it_is_known(live):
    setup, person = FusionSetup(nominal_calibration(KINECT_V2)), np.array([0.1, 0.1, 2.6])
    inspect = session_blueprint(setup, person, "inspect", live=live).root_container.contents[1]
    (lanes,) = (view for view in panes(inspect) if f"{layout.TRUST_LANES}/**" in view.contents)
    assert (layout.SECONDS_LANE in lanes.contents) == (not live)
    assert ("how good" in lanes.name) == (not live)


@pytest.mark.parametrize("depth", [False, True])
def test_a_running_sensors_image_has_the_skeleton_of_its_moment(depth):
    person = np.array([0.1, 0.1, 2.6])
    shown = session_blueprint(FusionSetup(nominal_calibration(KINECT_V2)), person, "setup", depth=depth,
                              color=True, live=True, card=True)  # fmt: skip
    for view in panes(shown.root_container.contents[0])[:2]:
        side = view.name[len("Kinect ")].lower()
        assert layout.image_skeleton(side, "color") in view.contents
        assert layout.skeleton(side) not in view.contents


@pytest.mark.parametrize("a_from_b", [A_FROM_B, A_FROM_B.inverse()], ids=["B on the right", "B on the left"])
def test_a_is_on_the_left_in_every_tab_and_the_eye_follows_the_person(a_from_b):
    setup = FusionSetup(Calibration(BODY, a_from_b, BODY.nominal_lengths, "known"))
    person = np.array([0.1, 0.1, 2.6])
    tabs = session_blueprint(setup, person, "inspect").root_container.contents
    scenes = [view for tab in tabs for view in panes(tab) if isinstance(view, rrb.Spatial3DView)]
    assert len(scenes) == 2
    followed = []
    for scene in scenes:
        eye = scene.properties["EyeControls3D"]
        position, target = (
            np.array(each.as_arrow_array().to_pylist()[0]) for each in (eye.position, eye.look_target)
        )
        right = np.cross(target - position, [0.0, -1.0, 0.0])  # y is down
        assert -position @ right < (a_from_b.translation - position) @ right
        followed += [] if eye.tracking_entity is None else eye.tracking_entity.as_arrow_array().to_pylist()
    assert followed == [layout.PELVIS]  # in inspect; in setup the sensors are looked at


@pytest.mark.parametrize("body", BODIES.values(), ids=lambda body: body.name)
def test_a_report_has_every_bone_in_full_rows_with_short_titles(body):
    quality, *rows = layouts(body)["report"].contents
    counts = [len(row.contents) for row in rows]
    shown = {bone_title(body.bones[joint]) for joint in body.bone_joints}  # left and right share a title
    titles = [plot.name for row in rows for plot in row.contents]
    assert sorted(titles) == sorted(shown)
    assert max(counts) <= 6
    assert max(counts) - min(counts) <= 1
    assert max(map(len, titles)) <= len("upper arm L R (m)")
    assert quality.contents[0].name == "how good"


def shown_values(rows, entity, component):
    """(T, …) values of one derived figure; None where there are none."""
    return next(f for f in SHOWN_FIGURES if (f.entity, f.component) == (entity, component)).values(rows)


@pytest.mark.parametrize("side", layout.VIEWS)
def test_joints_of_a_view_are_dimmed_where_inferred_or_exchanged(side):
    made = frames(known_fuser(), 3)
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, made)
    states = {name: getattr(rows, f"states_{name}").copy() for name in layout.VIEWS}
    states[side][1, 5] = TrackingState.INFERRED
    exchanged = np.zeros((3, 2), dtype=np.int8)
    exchanged[2, layout.VIEWS.index(side)] = 3
    positions = {name: getattr(rows, f"positions_{name}").copy() for name in layout.VIEWS}
    positions[side][2] = positions[side][2, BODY.mirror]
    told = replace(
        rows, states_a=states["a"], states_b=states["b"], exchanged=exchanged,
        positions_a=positions["a"], positions_b=positions["b"],
    )  # fmt: skip
    colors = shown_values(told, layout.skeleton(side), "Points3D:colors")
    tracked, inferred, swapped = VIEW_COLORS[side]
    assert (colors[0] == tracked).all()
    assert (colors[1, 5] == inferred).all()
    assert (np.delete(colors[1], 5, axis=0) == tracked).all()
    assert (colors[2] == swapped).all()
    assert max(inferred) < 0.75 * max(tracked)
    assert max(swapped) < 0.75 * max(SKELETON_COLORS[layout.exchanged(side)])


STEP = 1.0 / 512.0  # metres, of the spheres' radii


def test_spheres_have_the_radius_of_one_standard_deviation():
    made = frames(known_fuser(), 3)
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, made)
    half_sizes = shown_values(rows, layout.FUSED_SKELETON, layout.SIGMA_SPHERES)
    assert half_sizes is not None
    sigma = np.array([frame.fused.sigma for frame in made])
    np.testing.assert_allclose(half_sizes, np.repeat(sigma[..., None], 3, axis=2), rtol=0, atol=0.51 * STEP)


def test_a_sphere_of_an_older_session_is_no_larger_than_its_bone_allows():
    """A point on a sphere of radius L is √2 L from a random one (RMS): L² (1 − cos) · 2 on average."""
    made = frames(known_fuser(), 1)
    thumb = BODY.joint("THUMB_LEFT")
    parent = int(BODY.parents[thumb])
    sigma = np.full(len(BODY), 0.03)
    sigma[thumb] = 0.7
    lost = [replace(made[0], fused=replace(made[0].fused, sigma=sigma))]
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, lost)
    drawn = shown_values(rows, layout.FUSED_SKELETON, layout.SIGMA_SPHERES)[0, :, 0]
    most = np.hypot(sigma[parent], np.sqrt(2.0) * BODY.nominal_lengths[thumb])
    assert drawn[thumb] == pytest.approx(most, abs=0.51 * STEP)
    np.testing.assert_allclose(np.delete(drawn, thumb), 0.03, rtol=0, atol=0.51 * STEP)


def test_the_papers_methods_have_no_spheres():
    fuser = known_fuser()
    setup = replace(fuser.setup, settings=FuserSettings(method="paper"))
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, frames(type(fuser)(setup), 2))
    assert shown_values(rows, layout.FUSED_SKELETON, layout.SIGMA_SPHERES) is None
