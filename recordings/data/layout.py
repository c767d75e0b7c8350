"""A session's layout: its entities, timelines and names, shared by writer, reader, blueprint and documents.

The layout is the same live and in a file. Positions are metres; the world is K_A's frame. Figures of frames
are declared in :class:`recordings.data.session_arrays.SessionArrays`, and those that follow from them in
:mod:`recordings.writing.shown_figures`.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

from fusion.skeleton import NO_FRAME as NO_FRAME

APPLICATION_ID = "duplex_kinects"
VERSION = 6
"""Version of this layout. It increases when a reader of the old layout would misread the new one."""
READABLE_VERSIONS = (5, 6)
"""Versions that this program reads: those that differ from :data:`VERSION` only in optional figures."""

FRAME = "frame"
"""Timeline: the number of the pair."""
TIME = "time"
"""Timeline: time since the first pair."""

When = Literal["once", "every pair", "every second pair", "twice a second", "on change", "with images"]
Kind = Literal["drawn", "plotted", "copied", "in a viewer"]
PLOTTED: Kind = "plotted"
"""Plotted or only read back; all others are drawn into the scene."""
COPIED: Kind = "copied"
"""Of the capture alone, and not of its frames: a session that is made of a live one keeps it as logged."""
VIEWER: Kind = "in a viewer"
"""Only a running viewer has it, no file."""


class Entity(NamedTuple):
    """An entity, or one of each sensor, joint or limb: braces in its path stand for the name of these."""

    path: str
    what: str
    logged: When
    kind: Kind


ENTITIES: dict[str, Entity] = {}
"""All entities by path. What is logged, plotted, copied, read back and documented follows from them."""


def _one(path: str, what: str, logged: When, kind: Kind = "drawn") -> str:
    ENTITIES[path] = Entity(path, what, logged, kind)
    return path


def _each(path: str, what: str, logged: When, kind: Kind = "drawn") -> Callable[..., str]:
    return _one(path, what, logged, kind).format


ROOT = _one("/", "coordinates, joint names, the bones that the viewer draws", "once")
kinect = _each("/kinect_{}", "the sensor's pose in K_A's frame; of B, R and t of every pair", "on change")
sensor_label = _each("/kinect_{}/label", "the sensor's name, beside it in the scene", "once")
skeleton = _each("/kinect_{}/skeleton", "S_A, S_B as the sensor gave it, in its own frame", "every pair")
image_skeleton = _each("/kinect_{}/skeleton_of_{}", "S_A, S_B when the image was seen", "with images", VIEWER)
others = _each("/kinect_{}/others", "the bones of people who are not followed", "on change")
depth = _each("/kinect_{}/depth", "the depth camera and its images (RVL)", "with images")
image_edge = _each("/kinect_{}/depth/edge", "the border of the depth image", "once")
infrared = _each("/kinect_{}/depth/infrared", "the infrared image, on the same pixels", "with images", VIEWER)
points = _each("/kinect_{}/points", "the sparse point cloud of a depth image", "with images", VIEWER)
color = _each("/kinect_{}/color", "the colour camera and its images", "with images")
FUSED_SKELETON = _one(
    "/fused/skeleton", "S* in K_A's frame, figures per joint, its body's shapes", "every pair"
)
PELVIS = _one("/fused/pelvis", "the pelvis: x to the person's right, y down, z forward", "every pair")
TRUTH_SKELETON = _one("/truth/skeleton", "true joints in K_A's frame; simulations only", "every pair")
FLOOR = _one("/floor", "the floor's pose in K_A's frame, and lines one metre apart", "on change")
named_frame = _each("/frames/{}", "names of the frames of K_A, K_B, floor and pelvis", "once")
CALIBRATION = _one("/calibration", "R, t and bone lengths in full precision", "on change")
BONES = _one("/bones", "lengths of S_A, S_B, S* and the target, metres", "every second pair", PLOTTED)
ANGLES = _one("/angles", "angles of S* and their variances, degrees", "every second pair", PLOTTED)
ANGLES_BEYOND = _one("/angles/beyond", "those that no joint reaches", "every second pair", PLOTTED)
QUALITY = _one("/quality", "figures of the frame and of each sensor; checksums", "every pair", PLOTTED)
JITTER = _one("/quality/jitter_mm", "noise of S_A, S_B and S*", "twice a second")
PLACEMENT = _one("/quality/placement", "how far B has moved (mm) and turned (°)", "twice a second")
DRIFT = _one("/quality/drift_ppm", "B's clock against A's; live sensors only", "on change", COPIED)
DROPPED = _one("/quality/dropped", "dropped frames of A, B; live sensors only", "on change", COPIED)
UNPAIRED = _one("/quality/unpaired", "frames without a partner; live sensors only", "on change", COPIED)
EVENTS = _one("/events", "what happened, as text with its level", "on change")
trust_lane = _each("/trust/{}", "which view a limb of S* follows", "on change")
SECONDS_LANE = _one("/how_good", "how good the seconds are", "on change")
_STATE_LANE = _one("/lanes/{1}/{0}", "the state of a joint in a view, if it changes", "on change")
COACH = _one("/coach", "text of the setup coach", "on change", COPIED)
coach_mark = _each("/coach/{}", "lines that the coach draws into the scene", "on change", COPIED)
coach_words = _each("/coach/{}/words", "words beside them", "on change", COPIED)
COACH_CARD = _one("/coach_card", "picture of the set-up's state and the next step", "on change", VIEWER)

TRUST_LANES, STATE_LANES = "/trust", "/lanes"
"""Above the lanes of limbs and joints."""
COACH_MARKS = ("spot", "sensor_a", "sensor_b", "better_b")
"""Marks of the coach: where to stand, which sensor has a problem, where B would see more."""
FRAME_NAMES = {"K_A": "/kinect_a", "K_B": "/kinect_b", "floor": FLOOR, "pelvis": PELVIS}
"""Named coordinate frames and the entities whose frames they are."""

BONE_LENGTHS = "lengths"
"""Component of :data:`BONES`: a struct with one field per bone, [S_A, S_B, S*, target] in metres."""
DEGREES, VARIANCES = "degrees", "variances"
"""Components of :data:`ANGLES`: structs, one field per angle."""
FIGURES, OF_EACH_SENSOR = "figures", "sensors"
"""Components of :data:`QUALITY`: structs with one value per frame, and with one value per sensor (A, B)."""
SIGMA_SPHERES = "sigma_spheres"
"""Component of :data:`FUSED_SKELETON`: half sizes of a sphere of one standard deviation per joint, metres."""
CAPSULE_LENGTHS, CAPSULE_ROTATIONS = "capsule_lengths", "capsule_rotations"
"""Components of :data:`FUSED_SKELETON`: of the capsule that begins at each joint, metres and quaternions."""
NOSE_ORIGIN, NOSE_VECTOR = "nose_origin", "nose_vector"
"""Components of :data:`FUSED_SKELETON`: an arrow from the head to where the person faces, metres."""
BONE_VECTORS = "bone_vectors"
"""Component of S_A and S_B: from each joint to its parent, metres."""

VIEWS = ("a", "b")
"""The principal sensor K_A and the secondary sensor K_B."""
IMAGE_KINDS = ("depth", "color")
STATE_NAMES = ("not tracked", "inferred", "tracked")
SKELETON_NAMES = {
    "a": "S_A",
    "b": "S_B",
    "fused": "S*",
    "truth": "truth",
    "exchanged_a": "S_A, left and right exchanged",
    "exchanged_b": "S_B, left and right exchanged",
}
CLASS_IDS = {"a": 1, "b": 2, "fused": 3, "truth": 4, "exchanged_a": 5, "exchanged_b": 6}
"""By the keys of :data:`SKELETON_NAMES`; of a view, another one while it reports its sides exchanged."""
LINELESS_CLASS = 7
"""Class of joints that are shown without lines between them."""


def state_lane(side: str, joint: str) -> str:
    """Changes of a joint's tracking state."""
    return _STATE_LANE.format(side, joint.lower())


def is_plotted(entity: str) -> bool:
    """Whether an entity is plotted or only read back. R and t of every pair are beside the pose of B."""
    return entity == kinect("b") or _is(entity, PLOTTED)


def is_logged(entity: str) -> bool:
    """Whether an entity is of the capture alone, and not of its frames: the coach, the figures of streams."""
    return entity.startswith(f"{COACH}/") or _is(entity, COPIED)


def _is(entity: str, kind: Kind) -> bool:
    return entity in ENTITIES and ENTITIES[entity].kind == kind
