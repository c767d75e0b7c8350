"""Appearance of a session's entities, logged once as static data."""

from collections.abc import Mapping, Sequence

import rerun as rr
from rerun.blueprint import Visualizer
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from fusion.body import Body
from fusion.intrinsics import Intrinsics
from recordings.appearance.body_shape import capsule_radii
from recordings.appearance.colors import (
    FACE_COLOR,
    JOINT_RADII,
    MARK_COLORS,
    PREDICTED_COLOR,
    SKELETON_COLORS,
    STATE_COLORS,
    TARGET_COLOR,
    Color,
)
from recordings.appearance.joint_trust import SOURCE_COLORS, SOURCES
from recordings.data import layout

_CLOUD_RADIUS = rr.components.Radius.ui_points(0.5)  # metres would hide the person behind points near the eye
_NOSE_RADIUS = 0.022  # metres
_BONE_RADIUS = 1.2  # points on the screen: seen beside the body from where the eye stands, light and dark
_FRUSTUM_DEPTH = 0.25  # metres
_ABOVE_SENSOR = (0.0, -0.42, 0.0)  # above the frustum, which is drawn 0.2 or 0.3 m deep
_DOT = 0.001  # metres: a frame without axes has no name in the viewer
_GRID_X, _GRID_Z = (-5, 5), (-1, 6)  # metres from K_A, to the right and forward
_GRID_COLOR = (128, 128, 136)
_MIRRORED = 0.7  # brightness of the right side's lines
_SPHERE_OPACITY = 110  # of 255: the skeleton inside stays visible


def annotation_context(body: Body) -> rr.AnnotationContext:
    """One class per skeleton, with the names of the joints and the bones between them."""
    classes = [
        skeleton_class(body, number, layout.SKELETON_NAMES[key], SKELETON_COLORS[key])
        for key, number in layout.CLASS_IDS.items()
    ]
    lone = rr.AnnotationInfo(id=layout.LINELESS_CLASS, label="joint")
    classes.append(rr.ClassDescription(info=lone, keypoint_annotations=_joints(body)))
    return rr.AnnotationContext(classes)


def skeleton_class(body: Body, number: int, label: str, color: Color) -> rr.ClassDescription:
    """A class whose keypoints are the joints of a body, with the bones between them."""
    return rr.ClassDescription(
        info=rr.AnnotationInfo(id=number, label=label, color=color),
        keypoint_annotations=_joints(body),
        keypoint_connections=[(int(body.parents[joint]), int(joint)) for joint in body.bone_joints],
    )


def _joints(body: Body) -> list[rr.AnnotationInfo]:
    return [rr.AnnotationInfo(id=j, label=name) for j, name in enumerate(body.joints)]


def joint_look(body: Body, key: str) -> rr.Points3D:
    """Appearance of the skeleton `key` of layout.SKELETON_NAMES.

    S* gets a colour per joint and frame. S_A and S_B get their class, and with it their colour, per frame.
    """
    return rr.Points3D.from_fields(
        class_ids=None if key in layout.VIEWS else layout.CLASS_IDS[key],
        keypoint_ids=range(len(body)),
        colors=SKELETON_COLORS[key] if key == "truth" else None,
        radii=JOINT_RADII[key],
        show_labels=False,
    )


def others_look() -> rr.Arrows3D:
    """Appearance of the bones of people who are not followed: dim."""
    return rr.Arrows3D.from_fields(colors=PREDICTED_COLOR, radii=rr.components.Radius.ui_points(_BONE_RADIUS))


def cloud_look(side: str) -> rr.Points3D:
    """Appearance of a sensor's point cloud: the colour of its skeleton, as in the paper's fig. 2."""
    return rr.Points3D.from_fields(colors=SKELETON_COLORS[side], radii=_CLOUD_RADIUS)


def words_at(words: str, place: Sequence[float], parent: str) -> tuple[rr.AsComponents, ...]:
    """Words beside a place in an entity's frame, in the text colour of the viewer's theme.

    They are the name of a frame, which stays: Rerun gives all other labels the colour of their entity.
    """
    return (
        rr.Transform3D.from_fields(translation=place, parent_frame=f"tf#{parent}", child_frame=words),
        rr.CoordinateFrame(words),  # else the entity's own frame is named, too
        rr.TransformAxes3D.from_fields(axis_length=_DOT, show_frame=True),
    )


def sensor_label(side: str) -> tuple[rr.AsComponents, ...]:
    """A sensor's name, a little above it."""
    return words_at(f"Kinect {side.upper()}", _ABOVE_SENSOR, layout.kinect(side))


def floor_grid() -> rr.LineStrips3D:
    """Lines one metre apart on the floor, in the floor's frame; in a grey for light and dark backgrounds."""
    (left, right), (near, far) = _GRID_X, _GRID_Z
    along = [[(x, 0.0, near), (x, 0.0, far)] for x in range(left, right + 1)]
    across = [[(left, 0.0, z), (right, 0.0, z)] for z in range(near, far + 1)]
    return rr.LineStrips3D([*along, *across], colors=_GRID_COLOR, radii=rr.components.Radius.ui_points(0.4))


def camera(intrinsics: Intrinsics, side: str) -> rr.Pinhole:
    """A camera's frustum, in the colour of its skeleton."""
    return rr.Pinhole(
        focal_length=(intrinsics.fx, intrinsics.fy),
        principal_point=(intrinsics.cx, intrinsics.cy),
        width=intrinsics.width,
        height=intrinsics.height,
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=_FRUSTUM_DEPTH,
        color=SKELETON_COLORS[side],
    )


def image_edge(intrinsics: Intrinsics) -> rr.Boxes2D:
    """The border of a depth image; shown even while there is no image."""
    return rr.Boxes2D(
        array=[0, 0, intrinsics.width, intrinsics.height],
        array_format=rr.Box2DFormat.XYWH,
        colors=PREDICTED_COLOR,
        radii=rr.components.Radius.ui_points(0.5),
    )


def depth_look(raw: bool) -> rr.DepthImage | rr.EncodedDepthImage:
    """Appearance of depth images: grey, so that a skeleton's colour stands out over it."""
    archetype = rr.DepthImage if raw else rr.EncodedDepthImage
    return archetype.from_fields(colormap=rr.components.Colormap.Grayscale)


TRUST_LANES = rr.StateConfiguration(values=SOURCES, labels=SOURCES, colors=SOURCE_COLORS)
STATE_LANES = rr.StateConfiguration(values=layout.STATE_NAMES, labels=layout.STATE_NAMES, colors=STATE_COLORS)


def seconds_lane(words: Mapping[str, str]) -> rr.StateConfiguration:
    """Of layout.SECONDS_LANE: the colour of each text by its word."""
    marks = {"good": "do", "usable": "better", "poor": "mend"}
    colors = [MARK_COLORS[marks[word]] for word in words.values()]
    return rr.StateConfiguration(values=list(words), labels=list(words), colors=colors)


def followed(distance: float) -> Visualizer:
    """Invisible points above and below an entity's place, so that an eye which tracks it stays so far away.

    Rerun follows an entity that has a size, from a distance in proportion to it.
    """
    far = distance / 3.0
    return rr.Points3D([(0.0, -far, 0.0), (0.0, far, 0.0)], colors=(0, 0, 0, 0), radii=0.0).visualizer()


def bone_lines(bone: str, *, mirrored: bool = False) -> Visualizer:
    """Plot lines of a bone's length, as in the paper's fig. 5; those of a mirrored bone are darker."""
    keys = ("a", "b", "fused")
    side = bone.rpartition("_")[2]
    of = f", {side}" if side in ("left", "right") else ""
    look = rr.SeriesLines(
        names=[*(layout.SKELETON_NAMES[key] + of for key in keys), f"target{of}"],
        colors=[*(_darker(SKELETON_COLORS[key], mirrored) for key in keys), TARGET_COLOR],
        widths=[1.0, 1.0, 2.5, 1.0],
        visible_series=[True, True, True, False],
    )
    return _lines(look, layout.BONE_LENGTHS, bone)


def _darker(color: Color, darker: bool) -> Color:
    red, green, blue = (round(_MIRRORED * each) if darker else each for each in color)
    return red, green, blue


def angle_band(angle: str, name: str, color: Color) -> Visualizer:
    """Plot line of an angle of layout.ANGLES, with a band of one standard deviation."""
    look = rr.Measurements.from_fields(names=name, colors=color)
    fields = {"values": layout.DEGREES, "variances": layout.VARIANCES}
    return look.visualizer(
        mappings=[_field(f"Measurements:{of}", component, angle) for of, component in fields.items()]
    )


def beyond_marks(angle: str) -> Visualizer:
    """Crosses of an angle of layout.ANGLES_BEYOND; in a legend those of both sides are one."""
    look = rr.SeriesPoints(names="beyond reach", colors=TARGET_COLOR, markers="Cross", marker_sizes=5.0)
    return look.visualizer(mappings=[_field("Scalars:scalars", layout.DEGREES, angle)])


def figure_lines(name: str) -> Visualizer:
    """Plot line of a figure of layout.QUALITY; its name ends in its unit, if any."""
    words = name.replace("_mm", " (mm)").replace("_ms", " (ms)").replace("_", " ")
    return _lines(rr.SeriesLines(names=words, colors=SKELETON_COLORS["fused"]), layout.FIGURES, name)


def tracked_lines() -> Visualizer:
    """Plot lines of the number of joints that each sensor tracks."""
    look = rr.SeriesLines(
        names=[f"tracked by {side.upper()}" for side in layout.VIEWS],
        colors=[SKELETON_COLORS[side] for side in layout.VIEWS],
    )
    return _lines(look, layout.OF_EACH_SENSOR, "tracked_joints")


def _lines(look: rr.SeriesLines, component: str, field: str | None = None) -> Visualizer:
    """Plots a component other than Scalars, or one field of it."""
    return look.visualizer(mappings=[_field("Scalars:scalars", component, field)])


def _field(target: str, component: str, field: str | None = None) -> VisualizerComponentMapping:
    return VisualizerComponentMapping(
        target,
        ComponentSourceKind.SourceComponent,
        source_component=component,
        selector=None if field is None else f".{field}",
    )


def sigma_spheres() -> Visualizer:
    """Transparent spheres around the joints of S*, one standard deviation in radius."""
    look = rr.Ellipsoids3D.from_fields(
        fill_mode=rr.components.FillMode.TransparentFillMajorWireframe,
        colors=(*SKELETON_COLORS["fused"], _SPHERE_OPACITY),
        line_radii=rr.components.Radius.ui_points(0.5),
    )
    return look.visualizer(
        mappings=_mapped("Ellipsoids3D", half_sizes=layout.SIGMA_SPHERES, centers="Points3D:positions")
    )


def lone_joints() -> Visualizer:
    """The joints of a skeleton without the viewer's own lines between them, whose width is fixed."""
    return rr.Points3D.from_fields(class_ids=layout.LINELESS_CLASS).visualizer()


def body_capsules(body: Body) -> Visualizer:
    """S* as a body: a capsule per bone, in the colour of the joint at its far end."""
    look = rr.Capsules3D.from_fields(
        radii=capsule_radii(body), fill_mode=rr.components.FillMode.Solid, show_labels=False
    )
    return look.visualizer(
        mappings=_mapped(
            "Capsules3D",
            lengths=layout.CAPSULE_LENGTHS,
            quaternions=layout.CAPSULE_ROTATIONS,
            translations="Points3D:positions",
            colors="Points3D:colors",
        )
    )


def nose() -> Visualizer:
    """An arrow out of the head of S*: the side to which the person faces."""
    look = rr.Arrows3D.from_fields(radii=_NOSE_RADIUS, colors=FACE_COLOR, show_labels=False)
    return look.visualizer(
        mappings=_mapped("Arrows3D", vectors=layout.NOSE_VECTOR, origins=layout.NOSE_ORIGIN)
    )


def thin_bones() -> Visualizer:
    """The bones of S_A or S_B as thin lines, each in the colour of the joint at its far end."""
    look = rr.Arrows3D.from_fields(radii=rr.components.Radius.ui_points(_BONE_RADIUS), show_labels=False)
    return look.visualizer(
        mappings=_mapped(
            "Arrows3D", vectors=layout.BONE_VECTORS, origins="Points3D:positions", colors="Points3D:colors"
        )
    )


def _mapped(archetype: str, **sources: str) -> list[VisualizerComponentMapping]:
    """Where each field of a visualizer comes from: components of its entity."""
    return [_field(f"{archetype}:{field}", component) for field, component in sources.items()]


LINES = {
    layout.DRIFT: rr.SeriesLines(names="drift (ppm)", colors=SKELETON_COLORS["fused"]),
    **{
        entity: rr.SeriesLines(
            names=[f"{title} {side.upper()}" for side in layout.VIEWS],
            colors=[SKELETON_COLORS[side] for side in layout.VIEWS],
        )
        for entity, title in ((layout.DROPPED, "dropped of"), (layout.UNPAIRED, "without a partner, of"))
    },
    layout.JITTER: rr.SeriesLines(
        names=[layout.SKELETON_NAMES[key] for key in ("a", "b", "fused")],
        colors=[SKELETON_COLORS[key] for key in ("a", "b", "fused")],
        widths=[1.0, 1.0, 2.5],
    ),
    layout.PLACEMENT: rr.SeriesLines(
        names=["moved (mm)", "turned (°)"], colors=[SKELETON_COLORS["b"], TARGET_COLOR]
    ),
}
"""Plot titles by entity."""
