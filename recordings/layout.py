"""A session's layout: entity paths, timelines, colours and names, said once for writer, reader and blueprint.

The layout is the same live and in a file. Positions are metres; the world is K_A's frame.
"""

from __future__ import annotations

APPLICATION_ID = "duplex_kinects"
VERSION = 6
"""Of this layout; goes up when a reader of the old one would misread the new one."""
READABLE_VERSIONS = (5, 6)
"""The layouts that this program reads: all that differ from :data:`VERSION` in optional figures only."""

FRAME = "frame"
"""Timeline: the number of the pair."""
TIME = "time"
"""Timeline: duration since the first pair."""

ROOT = "/"
FUSED_SKELETON = "/fused/skeleton"
TRUTH_SKELETON = "/truth/skeleton"
"""Where the joints really are, in K_A's frame; simulations only."""
CALIBRATION = "/calibration"
"""R, t and bone lengths in full precision, whenever a calibration takes effect."""
BONES = "/bones"
"""Lengths of every bone of S_A, S_B, S* and its target, a component a bone, for eyes: every second frame."""
BONE_LENGTHS = "lengths"
"""Component of :data:`BONES`: a struct with a field a bone, [S_A, S_B, S*, target] in metres."""
QUALITY = "/quality"
FIGURES, OF_EACH_SENSOR = "figures", "sensors"
"""Components of :data:`QUALITY`: structs with one value a frame, and with A's and B's."""
JOINT_DIGESTS = "joint_digests"
"""Component of :data:`QUALITY`: a byte a joint of S* in float64, which the file has in float32 only."""
EVENTS = "/events"
TRUST_MATRIX = "/trust_matrix"
"""Picture, joint × time: whose view made each joint of S* around a moment, in pages of half a minute."""
MATRIX_FRAME = f"{TRUST_MATRIX}/frame"
"""What is the same in every page: the joints' names, and a legend."""
STATE_LANES = "/lanes"
COACH = "/coach"
"""Text: what to do next while setting up; beneath it, what is drawn into the scene for that."""
COACH_MARKS = ("spot", "sensor_a", "sensor_b", "better_b")
"""Where to stand, which sensor has a problem, where B would see more."""
NO_FRAME = -(2**63)
"""A sensor's time where it gave no frame for the pair."""

SIDES = ("a", "b")
"""The principal sensor K_A and the secondary K_B."""


def kinect(side: str) -> str:
    """The sensor itself: its place in K_A's frame."""
    return f"/kinect_{side}"


def skeleton(side: str) -> str:
    """S_A or S_B as the sensor gave it, in the sensor's own frame."""
    return f"/kinect_{side}/skeleton"


def state_lane(side: str, joint: str) -> str:
    """A joint's tracking state where it changes, for the joints that ever change."""
    return f"{STATE_LANES}/{joint.lower()}/{side}"


def depth(side: str) -> str:
    """The depth camera: pinhole and depth image."""
    return f"/kinect_{side}/depth"


def color(side: str) -> str:
    """The colour camera: where it is, pinhole and image."""
    return f"/kinect_{side}/color"


def image_edge(side: str) -> str:
    """Where the depth image ends."""
    return f"{depth(side)}/edge"


def points(side: str) -> str:
    """The point cloud of a depth image, thinned out, in the sensor's own frame."""
    return f"/kinect_{side}/points"


def coach_mark(name: str) -> str:
    """Lines that the coach draws into the scene, in K_A's frame."""
    return f"{COACH}/{name}"


def weight(side: str) -> str:
    """Component of :data:`FUSED_SKELETON`: w^A or w^B of eq. (11), one value a joint."""
    return f"weight_{side}"


def state(side: str) -> str:
    """Component of :data:`FUSED_SKELETON`: the joint's tracking state, one of :data:`STATE_NAMES`."""
    return f"state_{side}"


def stream_figure(name: str) -> str:
    """How two running sensors' streams go: drift_ppm, dropped or unpaired; logged where that changes."""
    return f"{QUALITY}/{name}"


Color = tuple[int, int, int]

SKELETON_NAMES = {"a": "S_A", "b": "S_B", "fused": "S*", "truth": "truth"}
SKELETON_COLORS: dict[str, Color] = {
    "a": (184, 115, 51),  # the paper's brown,
    "b": (58, 134, 255),  # blue
    "fused": (178, 78, 232),  # and purple
    "truth": (64, 168, 96),
}
CLASS_IDS = {"a": 1, "b": 2, "fused": 3, "truth": 4}
PREDICTED_COLOR: Color = (150, 150, 150)
"""Of a joint of S* that no sensor gave."""
STATE_NAMES = ("not tracked", "inferred", "tracked")
STATE_COLORS: tuple[Color, ...] = ((190, 60, 60), (226, 168, 60), (86, 160, 96))
PROMINENT_JOINTS = ("ELBOW_LEFT", "ELBOW_RIGHT", "WRIST_LEFT", "WRIST_RIGHT", "KNEE_LEFT", "KNEE_RIGHT")
"""Whose weights are shown until one asks for more: the joints that hide and are mixed up most."""
PROMINENT_BONES = ("upper_arm", "forearm", "thigh", "shin")
"""Of both sides: those of the paper's fig. 5."""
TARGET_COLOR = (128, 128, 128)
"""Of the target bone length: readable on light and on dark, where the paper's black is not."""
JOINT_RADII = {"a": 0.012, "b": 0.012, "fused": 0.020, "truth": 0.010}
"""Metres."""
