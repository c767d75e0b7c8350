"""Colours of skeletons, joints, states and advice, and what is shown by default.

People with protanopia or deuteranopia tell them apart as well; a test computes the distances (CIEDE2000, with
the model of colour vision of Machado et al. 2009).
"""

Color = tuple[int, int, int]

SKELETON_COLORS: dict[str, Color] = {
    "a": (197, 96, 0),  # orange
    "b": (32, 97, 172),  # blue
    "fused": (215, 134, 255),  # light violet
    "truth": (20, 188, 149),  # green
    "exchanged_a": (250, 240, 60),  # yellow, and cyan: each next to the colour of its own view
    "exchanged_b": (90, 220, 235),
}
"""By the names of :data:`recordings.data.layout.SKELETON_NAMES`."""
SIDE_COLORS: dict[str, Color] = {"left": (220, 50, 47), "right": (38, 139, 210)}
"""Of the person's sides in plots of angles: red and blue. Pages draw the right side dashed, too."""
VIEW_COLORS: dict[str, tuple[Color, Color, Color]] = {
    "a": (SKELETON_COLORS["a"], (134, 92, 56), (186, 170, 36)),
    "b": (SKELETON_COLORS["b"], (66, 94, 128), (40, 170, 175)),
}
"""Of a joint of S_A and S_B that is tracked, that is inferred, and whose sides were exchanged. The last two
are dimmed."""
PREDICTED_COLOR: Color = (97, 97, 97)
"""Colour of a joint of S* without data from any sensor."""
MARK_COLORS: dict[str, Color] = {"do": (20, 188, 149), "mend": (190, 10, 60), "better": (240, 192, 24)}
"""Of the coach's marks: where to go, what is wrong, and where a sensor could stand: green, red, amber."""
STATE_COLORS: tuple[Color, ...] = (PREDICTED_COLOR, MARK_COLORS["better"], MARK_COLORS["do"])
"""By the indices of :data:`recordings.data.layout.STATE_NAMES`."""
FACE_COLOR: Color = (235, 225, 205)
"""Of the nose of S*, which shows where the person faces."""
TARGET_COLOR = (128, 128, 128)
"""Colour of the target bone length. Unlike the paper's black, it is readable on light and dark
backgrounds."""
JOINT_RADII = {"a": 0.006, "b": 0.006, "fused": 0.016, "truth": 0.010}
"""Metres."""
PROMINENT_JOINTS = ("ELBOW_LEFT", "ELBOW_RIGHT", "WRIST_LEFT", "WRIST_RIGHT", "KNEE_LEFT", "KNEE_RIGHT")
"""Joints whose weights are shown by default: those most often occluded and confused."""
PROMINENT_BONES = ("upper_arm", "forearm", "thigh", "shin")
"""Bones shown by default, on both sides: those of the paper's fig. 5."""
