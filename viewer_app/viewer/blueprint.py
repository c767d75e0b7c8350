"""The layouts of the viewer: four tabs, one per task.

*setup* is for placing the sensors, *inspect* for explaining the motion of a joint, *report* for the bones,
*angles* for the person's movement.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from fusion.body import Body
from fusion.setup import FusionSetup
from recordings.appearance import entity_styles
from recordings.appearance.colors import PROMINENT_JOINTS, SIDE_COLORS, SKELETON_COLORS, Color
from recordings.appearance.state_card import HEIGHT, WIDTH
from recordings.data import layout
from recordings.quality.limits import PLOTTED_DEGREES
from viewer_app.coach.scene import places

Layout = Literal["setup", "inspect", "report", "angles"]
LAYOUTS: tuple[Layout, ...] = ("setup", "inspect", "report", "angles")

SCENE = "S*: orange from A, blue from B, violet from both, grey unseen; lines: S_A, S_B"
"""Title of the scene in *inspect*, which is its legend."""

_FIGURES = (
    ("disagreement_mm", "views differ (mm)"),
    ("bone_error_mm", "bone error of S* (mm)"),
    ("fuse_ms", "fusion (ms)"),
    ("skew_ms", "B captured after A (ms)"),
)
_STREAM_FIGURES = (
    (layout.DRIFT, "B's clock against A's (ppm)"),
    (layout.DROPPED, "frames dropped"),
    (layout.UNPAIRED, "frames without a partner"),
)
_LIMBS = {
    "upper_arm": "upper arms (m)",
    "forearm": "forearms (m)",
    "thigh": "thighs (m)",
    "shin": "shins (m)",
}
_OVERVIEW, _HIGH = 2.1, 1.4
"""In *setup*: times the distance of the sensors from the person, and metres above."""
_STEEP = math.radians(28.0)
"""In *setup* of running sensors: how far the eye looks down."""
_HALF_PICTURE, _WIDE = 0.85 * math.tan(math.radians(27.5)), 1.4
"""Half a 3D picture's height at a distance of one, without its edge: the viewer's eye sees 55°. Its width."""
_AWAY, _ABOVE = 2.9, 0.5
"""In *inspect*: metres from the person and over their middle. The eye follows the person."""
_PLOTS_A_ROW = 6
"""In *report*: at most, so that a laptop's screen has room for their titles."""
_FRUSTA = {"setup": 0.3, "inspect": 0.2}  # metres


def session_blueprint(
    setup: FusionSetup,
    person_at: NDArray[np.float64],
    active: Layout,
    *,
    live: bool = False,
    depth: bool = True,
    color: bool = False,
    infrared: bool = False,
    card: bool = False,
) -> rrb.Blueprint:
    """All layouts, with one of them open.

    Args:
        person_at: (3,) metres in K_A's frame: where to look.
        live: Whether two running sensors are shown, with figures of how their streams go.
        depth: Whether there are depth images, from which point clouds are computed.
        infrared: Whether there are infrared images, which are then shown instead of the depth images.
        card: Whether there is the picture of the set-up's state.
    """
    body = setup.body
    return rrb.Blueprint(
        rrb.Tabs(
            _setup(setup, person_at, live, depth, color, infrared, card),
            _inspect(setup, person_at, live, depth),
            _report(setup.calibration.bone_lengths, body),
            _angles(),
            active_tab=LAYOUTS.index(active),
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=layout.TIME),
        auto_views=False,
    )


def _setup(
    setup: FusionSetup,
    person_at: NDArray[np.float64],
    live: bool,
    depth: bool,
    color: bool,
    infrared: bool,
    card: bool,
) -> rrb.Container:
    shown = ", infrared" if infrared else "" if depth else ": its skeleton"

    def drawn_over(side: str, kind: str) -> str:
        there = {"depth": depth, "color": color}[kind]
        return layout.image_skeleton(side, kind) if card and there else layout.skeleton(side)

    depths = [
        rrb.Spatial2DView(
            origin=layout.depth(side),
            contents=[*_images(side, infrared), drawn_over(side, "depth"), layout.others(side)],
            name=f"Kinect {side.upper()}{shown}",
            visual_bounds=rrb.VisualBounds2D(x_range=(0, camera.width), y_range=(0, camera.height)),
        )
        for side, camera in zip(layout.VIEWS, setup.intrinsics, strict=True)
    ]
    images: list[rrb.View | rrb.Container] = [*depths]
    if color:
        images = [
            rrb.Tabs(_color_view(side, drawn_over(side, "color")), depth)
            for side, depth in zip(layout.VIEWS, depths, strict=True)
        ]
    forth = 0.5 * _place_of_b(setup, person_at) - person_at  # to half-way between the sensors
    towards_eye = _towards_eye(setup, person_at)
    if live:
        eye, target = overview(places(setup), towards_eye)
    else:
        eye = person_at + _OVERVIEW * float(np.linalg.norm(forth)) * towards_eye
        eye, target = eye - np.array([0.0, _HIGH, 0.0]), person_at + 0.4 * forth
    scene = _scene(
        eye,
        target,
        "where to stand" if live else "sensors and person",
        setup.body,
        frustum=_FRUSTA["setup"],
    )
    advice = rrb.TextDocumentView(
        origin=layout.COACH, contents=[layout.COACH], name="what is wrong" if live else "how good"
    )
    if card:
        state = rrb.Spatial2DView(
            origin=layout.COACH_CARD,
            name="what to do next",
            visual_bounds=rrb.VisualBounds2D(x_range=(0, WIDTH), y_range=(0, HEIGHT)),
        )
        beside = rrb.Vertical(state, rrb.Horizontal(scene, advice, column_shares=[5, 3]), row_shares=[9, 13])
    else:
        beside = rrb.Vertical(advice, scene, row_shares=[2, 3])
    return rrb.Horizontal(rrb.Vertical(*images), beside, column_shares=[1, 2], name="setup")


def overview(
    points: NDArray[np.float64], towards_eye: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The nearest eye that has all (N, 3) points in its picture, and where it looks.

    Args:
        towards_eye: (3,) horizontal unit vector, from the points to the eye.
    """
    back = math.cos(_STEEP) * towards_eye - np.array([0.0, math.sin(_STEEP), 0.0])  # y is down
    right = np.cross(back, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    target = 0.5 * (points.min(axis=0) + points.max(axis=0))
    off = points - target
    aside, high = np.abs(off @ right), np.abs(off @ np.cross(right, back))
    away = off @ back + np.maximum(aside / (_WIDE * _HALF_PICTURE), high / _HALF_PICTURE)
    return target + float(away.max()) * back, target


def _images(side: str, infrared: bool) -> list[str]:
    """What the view of a depth camera's pixels shows: the pinhole is its origin."""
    if infrared:
        return [layout.infrared(side), layout.image_edge(side)]
    return ["$origin/**", f"- {layout.infrared(side)}"]


def _color_view(side: str, skeleton: str) -> rrb.Spatial2DView:
    entity = layout.color(side)
    contents = ["$origin/**", skeleton, layout.others(side)]
    return rrb.Spatial2DView(origin=entity, contents=contents, name=f"Kinect {side.upper()}, colour")


def _place_of_b(setup: FusionSetup, person_at: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) position of K_B in K_A's frame, metres; if unknown, the ideal one: 90° around the person."""
    b_at = setup.calibration.a_from_b.translation
    if b_at.any():
        return b_at
    return np.asarray(person_at + np.linalg.norm(person_at) * np.array([1.0, 0.0, 0.0]))


def _towards_eye(setup: FusionSetup, person_at: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) horizontal unit vector from the person to the eye, which looks so that A is on the left."""
    b_at = _place_of_b(setup, person_at)
    back = 0.5 * b_at - person_at
    back[1] = 0.0
    if (far := float(np.linalg.norm(back))) < 1e-6:  # the person is half-way between the sensors
        return np.array([0.0, 0.0, -1.0])
    back /= far
    to_the_right = float(np.array([-back[2], 0.0, back[0]]) @ b_at)  # of B from A, seen from there
    return back if to_the_right >= 0.0 else -back


def _inspect(setup: FusionSetup, person_at: NDArray[np.float64], live: bool, depth: bool) -> rrb.Container:
    body = setup.body
    eye = person_at + _AWAY * _towards_eye(setup, person_at) - np.array([0.0, _ABOVE, 0.0])
    lengths = setup.calibration.bone_lengths
    prominent = [body.joints[body.joint(name)] for name in PROMINENT_JOINTS]
    disagreement, *others = (_plot(*figure) for figure in _FIGURES)
    hidden = [*(layout.points(side) for side in layout.VIEWS), f"{layout.COACH}/**"]

    def scene(name: str, *hidden: str, sigma: bool = False) -> rrb.View:
        frustum = _FRUSTA["inspect"]
        return _scene(eye, person_at, name, body, frustum, hidden, sigma, follow=True)

    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Tabs(
                scene(SCENE, *hidden),
                scene(
                    "spheres: 1 σ of a joint",
                    *hidden,
                    *(layout.skeleton(side) for side in layout.VIEWS),
                    sigma=True,
                ),
                *(
                    [scene(f"point clouds{', up to 0.25 s old' if live else ''}", f"{layout.COACH}/**")]
                    if depth
                    else []
                ),
                active_tab=0,
            ),
            rrb.Tabs(
                disagreement,
                # without the entity path, which is the same in every row
                rrb.TextLogView(
                    origin=layout.EVENTS,
                    name="events",
                    columns=rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"]),
                ),
                rrb.StateTimelineView(
                    origin="/",
                    contents=[layout.state_lane(side, joint) for joint in prominent for side in layout.VIEWS],
                    name="states of limbs",
                ),
                _seen(body),
                *others,
                *(
                    rrb.TimeSeriesView(origin=entity, name=title)
                    for entity, title in (_STREAM_FIGURES if live else ())
                ),
                rrb.StateTimelineView(origin=layout.STATE_LANES, name="all states"),
                active_tab=0,
            ),
            row_shares=[5, 2],
        ),
        rrb.Vertical(
            rrb.StateTimelineView(
                origin="/",
                contents=[*([] if live else [layout.SECONDS_LANE]), f"{layout.TRUST_LANES}/**"],
                name=f"{'' if live else 'how good it is; '}which sensor each limb follows",
            ),
            rrb.Grid(
                *(_bone_plot(body, lengths, f"{bone}_left", title) for bone, title in _LIMBS.items()),
                grid_columns=2,
            ),
            row_shares=[1, 1],
        ),
        column_shares=[7, 5],
        name="inspect",
    )


def _report(lengths: NDArray[np.float64], body: Body) -> rrb.Container:
    bones = [body.bones[joint] for joint in body.bone_joints]
    plots = [
        _bone_plot(body, lengths, bone, bone_title(bone)) for bone in bones if not bone.endswith("_right")
    ]
    rows = np.array_split(np.arange(len(plots)), math.ceil(len(plots) / _PLOTS_A_ROW))
    return rrb.Vertical(
        rrb.Horizontal(
            rrb.TextDocumentView(origin=layout.COACH, contents=[layout.COACH], name="how good"),
            _plot("disagreement_mm", "views differ (mm)"),
            _quality_plot(layout.JITTER, "jitter (mm)"),
            _quality_plot(layout.PLACEMENT, "placement of B"),
            column_shares=[5, 3, 3, 3],
        ),
        *(rrb.Horizontal(*(plots[k] for k in row)) for row in rows),
        row_shares=[5, *([2] * len(rows))],
        name="report",
    )


def _angles() -> rrb.Container:
    def plot(name: str, *lines: tuple[str, str, Color]) -> rrb.View:
        return rrb.TimeSeriesView(
            origin=layout.ANGLES,
            name=f"{name.replace('_', ' ')} (°)",
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
            axis_y=rrb.ScalarAxis(range=PLOTTED_DEGREES[name]),
            overrides={
                layout.ANGLES: [entity_styles.angle_band(*line) for line in lines],
                layout.ANGLES_BEYOND: [entity_styles.beyond_marks(angle) for angle, *_ in lines],
            },
        )

    forwards, aside = SKELETON_COLORS["fused"], SKELETON_COLORS["truth"]
    trunk = ("trunk_flexion", "forwards", forwards), ("trunk_lean", "to the right", aside)
    of_sides = (
        plot(name, *((f"{name}_{side}", side, color) for side, color in SIDE_COLORS.items()))
        for name in PLOTTED_DEGREES
        if name != "trunk"
    )
    return rrb.Grid(*of_sides, plot("trunk", *trunk), grid_columns=3, name="angles")


def _seen(body: Body) -> rrb.View:
    return rrb.TimeSeriesView(
        origin=layout.QUALITY,
        contents=["$origin"],  # its children are figures in other units
        name="joints tracked",
        overrides={layout.QUALITY: entity_styles.tracked_lines()},
        axis_y=rrb.ScalarAxis(range=(0.0, len(body) + 1.0)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftBottom),
    )


def _quality_plot(entity: str, title: str) -> rrb.View:
    return rrb.TimeSeriesView(origin=entity, name=title, plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop))


def _bone_plot(body: Body, lengths: NDArray[np.float64], bone: str, title: str) -> rrb.View:
    """Lengths of a bone in S_A, S_B and S*; a left bone comes with the right one, in darker colours.

    The axis ends half a target length from the target: otherwise single spikes of a tracker would scale it.
    """
    target = float(lengths[body.bone(bone)])
    lines = [entity_styles.bone_lines(bone)]
    if bone.endswith("_left"):
        lines.insert(0, entity_styles.bone_lines(bone.replace("_left", "_right"), mirrored=True))
    return rrb.TimeSeriesView(
        origin=layout.BONES,
        name=title,
        plot_legend=rrb.PlotLegend(visible=False),
        axis_y=rrb.ScalarAxis(range=(0.5 * target, 1.5 * target)),
        overrides={layout.BONES: lines},
    )


def bone_title(bone: str) -> str:
    """upper_arm_left as ``upper arm L R (m)``: short enough for one plot among twenty."""
    name, _, side = bone.rpartition("_")
    words = f"{name} L R" if side in ("left", "right") else bone
    return words.replace("_", " ") + " (m)"


def _plot(name: str, title: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=layout.QUALITY,
        contents=["$origin"],
        name=title,
        plot_legend=rrb.PlotLegend(visible=False),
        overrides={layout.QUALITY: entity_styles.figure_lines(name)},
    )


def _scene(
    eye: NDArray[np.float64],
    looks_at: NDArray[np.float64],
    name: str,
    body: Body,
    frustum: float,
    hidden: Sequence[str] = (),
    sigma: bool = False,
    follow: bool = False,
) -> rrb.Spatial3DView:
    """Everything in K_A's frame; depth cameras as frusta: their points are an entity of their own.

    With `sigma`, a sphere of one standard deviation is drawn about each joint of S*. With `follow`, the eye
    moves with the person.
    """
    infrared = [layout.infrared(side) for side in layout.VIEWS]
    of_image = [layout.image_skeleton(side, kind) for side in layout.VIEWS for kind in layout.IMAGE_KINDS]
    left_out = [layout.TRUTH_SKELETON, layout.COACH_CARD, *of_image, *infrared, *hidden]
    return rrb.Spatial3DView(
        origin="/",
        contents=["$origin/**", *(f"- {entity}" for entity in left_out)],
        name=name,
        overrides={
            **{
                layout.depth(side): rr.Pinhole.from_fields(image_plane_distance=frustum).visualizer()
                for side in layout.VIEWS
            },
            **({layout.PELVIS: entity_styles.followed(_AWAY)} if follow else {}),
            **{
                layout.skeleton(side): [entity_styles.lone_joints(), entity_styles.thin_bones()]
                for side in layout.VIEWS
            },
            layout.FUSED_SKELETON: [
                rr.Points3D.from_fields().visualizer(),
                entity_styles.sigma_spheres(),
                entity_styles.nose(),
            ]
            if sigma
            else [entity_styles.lone_joints(), entity_styles.body_capsules(body), entity_styles.nose()],
        },
        eye_controls=rrb.EyeControls3D(
            position=eye,
            look_target=looks_at,
            eye_up=(0.0, -1.0, 0.0),
            tracking_entity=layout.PELVIS if follow else None,
        ),
        line_grid=rrb.LineGrid3D(visible=False),
    )
