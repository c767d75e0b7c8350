"""A session's layout: entity paths, timelines and names, shared by writer, reader and blueprint.

The layout is the same live and in a file. Positions are metres; the world is K_A's frame.
"""

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

ROOT = "/"
FUSED_SKELETON = "/fused/skeleton"
TRUTH_SKELETON = "/truth/skeleton"
"""True joint positions in K_A's frame; simulations only."""
CALIBRATION = "/calibration"
"""R, t and bone lengths in full precision, logged when a calibration takes effect."""
BONES = "/bones"
"""Bone lengths of S_A, S_B, S* and the target, for plots: one component per bone, every second frame."""
BONE_LENGTHS = "lengths"
"""Component of :data:`BONES`: a struct with one field per bone, [S_A, S_B, S*, target] in metres."""
ANGLES, DEGREES, VARIANCES = "/angles", "degrees", "variances"
"""Joint angles of S*, for plots, every second frame, and their components: structs, one field per angle."""
ANGLES_BEYOND = "/angles/beyond"
"""Those that no joint reaches, as :data:`DEGREES`, but at the edge of the plot; NaN where one is possible."""
QUALITY = "/quality"
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
EVENTS = "/events"
TRUST_LANES = "/trust"
"""Which view each limb of S* follows: changes, one entity per limb."""
SECONDS_LANE = "/how_good"
"""How good the seconds are: changes."""
STATE_LANES = "/lanes"
COACH = "/coach"
"""Text of the setup coach. Child entities are its drawings in the scene."""
COACH_CARD = "/coach_card"
"""Picture of the set-up's state and the next step; in a running viewer only, files have none."""
COACH_MARKS = ("spot", "sensor_a", "sensor_b", "better_b")
"""Marks of the coach: where to stand, which sensor has a problem, where B would see more."""

FLOOR = "/floor"
"""The floor: its pose in K_A's frame, and lines one metre apart."""
PELVIS = "/fused/pelvis"
"""Pose of the person's pelvis in K_A's frame: x to the person's right, y down, z forward."""
FRAME_NAMES = {"K_A": "/kinect_a", "K_B": "/kinect_b", "floor": FLOOR, "pelvis": PELVIS}
"""Named coordinate frames and the entities whose frames they are."""

VIEWS = ("a", "b")
"""The principal sensor K_A and the secondary sensor K_B."""


def kinect(side: str) -> str:
    """The sensor: its pose in K_A's frame."""
    return f"/kinect_{side}"


def skeleton(side: str) -> str:
    """S_A or S_B as the sensor gave it, in the sensor's own frame."""
    return f"/kinect_{side}/skeleton"


def image_skeleton(side: str, kind: str) -> str:
    """S_A or S_B at the moment of the depth or colour image that is shown; in a running viewer only."""
    return f"/kinect_{side}/skeleton_of_{kind}"


def trust_lane(limb: str) -> str:
    """Changes of the view that a limb of S* follows."""
    return f"{TRUST_LANES}/{limb.replace(' ', '_')}"


def others(side: str) -> str:
    """The bones of the people who are not followed, in the sensor's own frame."""
    return f"/kinect_{side}/others"


def state_lane(side: str, joint: str) -> str:
    """Changes of a joint's tracking state; only for joints whose state changes."""
    return f"{STATE_LANES}/{joint.lower()}/{side}"


def depth(side: str) -> str:
    """The depth camera: pinhole and depth image."""
    return f"/kinect_{side}/depth"


def infrared(side: str) -> str:
    """The infrared image, on the pixels of the depth image; in a viewer only, files have none."""
    return f"{depth(side)}/infrared"


def sensor_label(side: str) -> str:
    """The sensor's name, beside it in the scene."""
    return f"/kinect_{side}/label"


def named_frame(name: str) -> str:
    """Connects a name of :data:`FRAME_NAMES` to the frame of its entity."""
    return f"/frames/{name}"


def color(side: str) -> str:
    """The colour camera: pose, pinhole and image."""
    return f"/kinect_{side}/color"


def image_edge(side: str) -> str:
    """The border of the depth image."""
    return f"{depth(side)}/edge"


def points(side: str) -> str:
    """The sparse point cloud of a depth image, in the sensor's own frame."""
    return f"/kinect_{side}/points"


def coach_mark(name: str) -> str:
    """Lines that the coach draws into the scene, in K_A's frame."""
    return f"{COACH}/{name}"


def coach_words(name: str) -> str:
    """Words beside a mark of the coach."""
    return f"{coach_mark(name)}/words"


def exchanged(side: str) -> str:
    """Class of S_A or S_B while the view reports left and right exchanged, of the body or of limbs."""
    return f"exchanged_{side}"


def stream_figure(name: str) -> str:
    """A figure that is not logged with every pair: drift_ppm, dropped and unpaired of live streams, logged
    when they change; jitter_mm and placement, logged twice a second."""
    return f"{QUALITY}/{name}"


def is_logged(entity: str) -> bool:
    """Whether an entity is of the capture alone, and not of its frames: the coach, the figures of streams."""
    return entity in LOGGED or entity.startswith(f"{COACH}/")


LOGGED = (COACH, *map(stream_figure, ("drift_ppm", "dropped", "unpaired")))
"""What a session that is made of a live one keeps as it was logged; see :func:`is_logged`."""
SKELETON_NAMES = {
    "a": "S_A",
    "b": "S_B",
    "fused": "S*",
    "truth": "truth",
    "exchanged_a": "S_A, left and right exchanged",
    "exchanged_b": "S_B, left and right exchanged",
}
CLASS_IDS = {"a": 1, "b": 2, "fused": 3, "truth": 4, "exchanged_a": 5, "exchanged_b": 6}
LINELESS_CLASS = 7
"""Class of joints that are shown without lines between them."""
IMAGE_KINDS = ("depth", "color")
STATE_NAMES = ("not tracked", "inferred", "tracked")
