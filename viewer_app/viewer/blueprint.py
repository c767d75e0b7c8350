"""The layouts of the viewer: three tabs, one per task.

*setup* is for placing the sensors, *inspect* for explaining the motion of a joint, *report* for the bones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from fusion.body import Body
from fusion.calibration.calibration import nominal_calibration
from fusion.setup import FusionSetup
from recordings import layout
from recordings.appearance import entity_styles

Layout = Literal["setup", "inspect", "report"]
LAYOUTS: tuple[Layout, ...] = ("setup", "inspect", "report")

_FIGURES = (
    ("disagreement_mm", "S_A against S_B (mm)"),
    ("bone_error_mm", "S* bone error (mm)"),
    ("fuse_ms", "fusion (ms)"),
    ("skew_ms", "skew (ms)"),
)
_STREAM_FIGURES = (
    ("drift_ppm", "B's clock against A's (ppm)"),
    ("dropped", "frames dropped"),
    ("unpaired", "frames without a partner"),
)
_OVERVIEW, _HIGH = 2.1, 1.4
"""In *setup*: from behind both sensors, times their distance from the person, and metres above."""
_BEHIND, _ABOVE = 2.4, 0.4
"""In *inspect*: metres behind the person and over their middle, who then stands before both sensors."""
_PLOTS_A_ROW = 6
"""In *report*: at most, so that a laptop's screen has room for their titles."""
_FRUSTA = {"setup": 0.3, "inspect": 0.2}  # metres


def session_blueprint(
    setup: FusionSetup,
    person_at: NDArray[np.float64],
    active: Layout,
    *,
    live: bool = False,
    color: bool = False,
    infrared: bool = False,
) -> rrb.Blueprint:
    """All layouts, with one of them open.

    Args:
        setup: The body, the sensors and their placement.
        person_at: (3,) metres in K_A's frame: where to look.
        active: The layout that is open at first.
        live: Whether two running sensors are shown, with figures of how their streams go.
        color: Whether they give colour images.
        infrared: Whether they give infrared images, which are then shown instead of the depth images.
    """
    body = setup.body
    return rrb.Blueprint(
        rrb.Tabs(
            _setup(setup, person_at, color, infrared),
            _inspect(setup, person_at, live),
            _report(body),
            active_tab=LAYOUTS.index(active),
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="expanded" if active == "inspect" else "collapsed"),
        rrb.TimePanel(state="collapsed", timeline=layout.TIME),
        auto_views=False,
    )


def inspect_blueprint(body: Body, person_at: NDArray[np.float64]) -> rrb.Blueprint:
    """All layouts for a session whose sensors' placement is in its frames, with *inspect* open."""
    return session_blueprint(FusionSetup(nominal_calibration(body)), person_at, "inspect")


def _setup(setup: FusionSetup, person_at: NDArray[np.float64], color: bool, infrared: bool) -> rrb.Container:
    depths = [
        rrb.Spatial2DView(
            origin=layout.depth(side),
            contents=[*_images(side, infrared), layout.skeleton(side)],
            name=f"Kinect {side.upper()}, infrared" if infrared else f"Kinect {side.upper()}",
            visual_bounds=rrb.VisualBounds2D(x_range=(0, camera.width), y_range=(0, camera.height)),
        )
        for side, camera in zip(layout.SIDES, setup.intrinsics, strict=True)
    ]
    images: list[rrb.View | rrb.Container] = [*depths]
    if color:
        images = [
            rrb.Tabs(_color_view(side), depth) for side, depth in zip(layout.SIDES, depths, strict=True)
        ]
    forth = 0.5 * _place_of_b(setup, person_at) - person_at  # to half-way between the sensors
    seen = rrb.TimeSeriesView(
        origin=layout.QUALITY,
        contents=["$origin"],  # its children are stream figures in other units
        name="joints tracked by each sensor",
        overrides={layout.QUALITY: entity_styles.tracked_lines()},
        axis_y=rrb.ScalarAxis(range=(0.0, len(setup.body) + 1.0)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftBottom),
    )
    scene = _scene(
        person_at + _OVERVIEW * forth - np.array([0.0, _HIGH, 0.0]),
        person_at + 0.4 * forth,
        "sensors, skeletons, points",
        setup.body,
        frustum=_FRUSTA["setup"],
    )
    advice = rrb.TextDocumentView(origin=layout.COACH, contents=[layout.COACH], name="what to do next")
    return rrb.Horizontal(
        rrb.Vertical(*images, seen, row_shares=[5, 5, 3]),
        # an event's line does not wrap
        rrb.Vertical(scene, rrb.Horizontal(advice, _events(), column_shares=[1, 2]), row_shares=[7, 3]),
        column_shares=[3, 8],
        name="setup",
    )


def _images(side: str, infrared: bool) -> list[str]:
    """What the view of a depth camera's pixels shows: the pinhole is its origin."""
    if infrared:
        return [layout.infrared(side), layout.image_edge(side)]
    return ["$origin/**", f"- {layout.infrared(side)}"]


def _color_view(side: str) -> rrb.Spatial2DView:
    entity = layout.color(side)
    contents = ["$origin/**", layout.skeleton(side)]
    return rrb.Spatial2DView(origin=entity, contents=contents, name=f"Kinect {side.upper()}, colour")


def _place_of_b(setup: FusionSetup, person_at: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) position of K_B in K_A's frame, metres; if unknown, the ideal one: 90° around the person."""
    b_at = setup.calibration.a_from_b.translation
    if b_at.any():
        return b_at
    return np.asarray(person_at + np.linalg.norm(person_at) * np.array([1.0, 0.0, 0.0]))


def _inspect(setup: FusionSetup, person_at: NDArray[np.float64], live: bool) -> rrb.Container:
    body = setup.body
    away = person_at - 0.5 * _place_of_b(setup, person_at)
    away /= max(float(np.linalg.norm(away)), 1e-6)
    behind = person_at + _BEHIND * away - np.array([0.0, _ABOVE, 0.0])
    limbs = [f"{bone}_{side}" for bone in layout.PROMINENT_BONES for side in ("left", "right")]
    prominent = [body.joints[body.joint(name)] for name in layout.PROMINENT_JOINTS]
    disagreement, *others = (_plot(*figure) for figure in _FIGURES)
    trust_lines = rrb.TimeSeriesView(
        origin=layout.FUSED_SKELETON,
        name="trust in A, limbs",
        overrides={layout.FUSED_SKELETON: entity_styles.weight_lines(body, "a")},
        axis_y=rrb.ScalarAxis(range=(-0.05, 1.05)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
    )
    hidden = [*(layout.points(side) for side in layout.SIDES), f"{layout.COACH}/**"]

    def scene(name: str, *hidden: str, sigma: bool = False) -> rrb.View:
        frustum = _FRUSTA["inspect"]
        return _scene(behind, person_at, name, body, frustum, layout.FUSED_SKELETON, hidden, sigma)

    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Tabs(
                scene("S_A brown, S_B blue, S* purple", *hidden),
                scene("S* with 1 σ", *hidden, *(layout.skeleton(side) for side in layout.SIDES), sigma=True),
                active_tab=0,
            ),
            rrb.Tabs(
                disagreement,
                rrb.StateTimelineView(
                    origin="/",
                    contents=[layout.state_lane(side, joint) for joint in prominent for side in layout.SIDES],
                    name="states, limbs",
                ),
                *others,
                *(
                    rrb.TimeSeriesView(origin=layout.stream_figure(name), name=title)
                    for name, title in (_STREAM_FIGURES if live else ())
                ),
                rrb.StateTimelineView(origin=layout.STATE_LANES, name="states"),
                trust_lines,
                _events(),
                active_tab=0,
            ),
            row_shares=[3, 2],
        ),
        rrb.Vertical(
            rrb.Spatial2DView(origin=layout.TRUST_MATRIX, name="whose view made each joint"),
            rrb.Grid(*_bone_plots([bone for bone in limbs if bone in body.bones], " (m)"), grid_columns=2),
            row_shares=[1, 1],
        ),
        column_shares=[5, 6],
        name="inspect",
    )


def _report(body: Body) -> rrb.Container:
    plots = _bone_plots(body.bones[joint] for joint in body.bone_joints)
    rows = np.array_split(np.arange(len(plots)), math.ceil(len(plots) / _PLOTS_A_ROW))
    legend = "how good; above: bones in m, S_A brown, S_B blue, S* purple, target grey"
    return rrb.Vertical(
        *(rrb.Horizontal(*(plots[k] for k in row)) for row in rows),
        rrb.TextDocumentView(origin=layout.COACH, contents=[layout.COACH], name=legend),
        name="report",
    )


def _bone_plots(bones: Iterable[str], unit: str = "") -> list[rrb.View]:
    return [
        rrb.TimeSeriesView(
            origin=layout.BONES,
            name=bone_title(bone) + unit,
            plot_legend=rrb.PlotLegend(visible=False),
            overrides={layout.BONES: entity_styles.bone_lines(bone)},
        )
        for bone in bones
    ]


def bone_title(bone: str) -> str:
    """upper_arm_left as ``L upper arm``: short enough for the plot of one bone among thirty."""
    name, _, side = bone.rpartition("_")
    words = f"{side[0].upper()} {name}" if side in ("left", "right") else bone
    return words.replace("_", " ")


def _plot(name: str, title: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=layout.QUALITY,
        contents=["$origin"],
        name=title,
        plot_legend=rrb.PlotLegend(visible=False),
        overrides={layout.QUALITY: entity_styles.figure_lines(name)},
    )


def _events() -> rrb.TextLogView:
    """The event log without the entity path, which is the same in every row."""
    columns = rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])
    return rrb.TextLogView(origin=layout.EVENTS, name="events", columns=columns)


def _scene(
    eye: NDArray[np.float64],
    looks_at: NDArray[np.float64],
    name: str,
    body: Body,
    frustum: float,
    track: str | None = None,
    hidden: Sequence[str] = (),
    sigma: bool = False,
) -> rrb.Spatial3DView:
    """Everything in K_A's frame; depth cameras as frusta: their points are an entity of their own.

    With `sigma`, a sphere of one standard deviation is drawn about each joint of S*.
    """
    infrared = [layout.infrared(side) for side in layout.SIDES]
    left_out = [layout.TRUTH_SKELETON, f"{layout.TRUST_MATRIX}/**", *infrared, *hidden]
    return rrb.Spatial3DView(
        origin="/",
        contents=["$origin/**", *(f"- {entity}" for entity in left_out)],
        name=name,
        overrides={
            **{
                layout.depth(side): rr.Pinhole.from_fields(image_plane_distance=frustum).visualizer()
                for side in layout.SIDES
            },
            **{
                layout.skeleton(side): [entity_styles.lone_joints(), entity_styles.thin_bones()]
                for side in layout.SIDES
            },
            layout.FUSED_SKELETON: [rr.Points3D.from_fields().visualizer(), entity_styles.sigma_spheres()]
            if sigma
            else [entity_styles.lone_joints(), entity_styles.body_capsules(body)],
        },
        eye_controls=rrb.EyeControls3D(
            position=eye, look_target=looks_at, eye_up=(0.0, -1.0, 0.0), tracking_entity=track
        ),
        line_grid=rrb.LineGrid3D(visible=False),
    )
