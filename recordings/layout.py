"""A session's layout: entity paths, timelines, colours and names, said once for writer, reader and blueprint.

The layout is the same live and in a file. Positions are metres; the world is K_A's frame.
"""

from __future__ import annotations

APPLICATION_ID = "duplex_kinects"
VERSION = 2
"""Of this layout; goes up when a reader of the old one would misread the new one."""

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
FUSED_TRUST = "/fused/trust"
QUALITY = "/quality"
EVENTS = "/events"
TRUST_MATRIX = "/trust_matrix"
"""Picture, joint × time: whose view made each joint of S* over the last seconds."""
STATE_LANES = "/lanes"
COACH = "/coach"
"""Text: what to do next while setting up."""
PLACEMENT = "/kinect_b/placement"
"""R and t again, as float64 data: the viewer's transform has float32."""
CHECKS = "/checks"
"""Checksums of each frame: a damaged file must not pass for a whole one."""
NO_FRAME = -(2**63)

SIDES = ("a", "b")
"""The principal sensor K_A and the secondary K_B."""


def kinect(side: str) -> str:
    """The sensor itself: its place in K_A's frame."""
    return f"/kinect_{side}"


def skeleton(side: str) -> str:
    """S_A or S_B as the sensor gave it, in the sensor's own frame."""
    return f"/kinect_{side}/skeleton"


def states(side: str) -> str:
    """Tracking states 0, 1, 2 a joint, as data."""
    return f"/kinect_{side}/states"


def state_lane(side: str, joint: str) -> str:
    """A joint's tracking state where it changes, for the joints that ever change."""
    return f"{STATE_LANES}/{joint.lower()}/{side}"


def clock(side: str) -> str:
    """The sensor's own time of each frame, as data; :data:`NO_FRAME` where it gave none for the pair."""
    return f"/kinect_{side}/clock"


def weights(side: str) -> str:
    """w^A or w^B of eq. (11), one value a joint."""
    return f"/kinect_{side}/weights"


def depth(side: str) -> str:
    """The depth camera: pinhole and depth image."""
    return f"/kinect_{side}/depth"


def color(side: str) -> str:
    """The colour camera: where it is, pinhole and image."""
    return f"/kinect_{side}/color"


def points(side: str) -> str:
    """The point cloud of a depth image, thinned out, in the sensor's own frame."""
    return f"/kinect_{side}/points"


def bone(name: str) -> str:
    """Length of a bone: S_A, S_B, S*, target."""
    return f"/bones/{name}"


def quality(name: str) -> str:
    """One figure a frame; the name ends in its unit where it has one."""
    return f"{QUALITY}/{name}"


QUALITY_NAMES = (
    "fuse_ms",
    "skew_ms",
    "bone_error_mm",
    "disagreement_mm",
    "iterations",
    "predicted_joints",
    "tracked_joints",
    "stale",
)
"""What is logged under ``/quality``."""
STREAM_NAMES = ("drift_ppm", "dropped", "unpaired")
"""What is logged there too where two sensors run live."""

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
TARGET_COLOR = (128, 128, 128)
"""Of the target bone length: readable on light and on dark, where the paper's black is not."""
JOINT_RADII = {"a": 0.012, "b": 0.012, "fused": 0.020, "truth": 0.010}
"""Metres."""
