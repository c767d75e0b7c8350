"""Colours of skeletons, joints and states, and what is shown by default."""

from __future__ import annotations

Color = tuple[int, int, int]

SKELETON_COLORS: dict[str, Color] = {
    "a": (184, 115, 51),  # the paper's brown,
    "b": (58, 134, 255),  # blue
    "fused": (178, 78, 232),  # and purple
    "truth": (64, 168, 96),
    "exchanged_a": (240, 220, 70),  # yellow, and cyan: each next to the color of its own view
    "exchanged_b": (70, 225, 225),
}
"""By the names of :data:`recordings.layout.SKELETON_NAMES`."""
VIEW_COLORS: dict[str, tuple[Color, Color, Color]] = {
    "a": (SKELETON_COLORS["a"], (134, 104, 76), (176, 156, 36)),
    "b": (SKELETON_COLORS["b"], (92, 116, 164), (28, 164, 164)),
}
"""Of a joint of S_A and S_B that is tracked, that is inferred, and whose sides were exchanged. The last two
are dimmed."""
PREDICTED_COLOR: Color = (150, 150, 150)
"""Colour of a joint of S* without data from any sensor."""
STATE_COLORS: tuple[Color, ...] = ((190, 60, 60), (226, 168, 60), (86, 160, 96))
"""By the indices of :data:`recordings.layout.STATE_NAMES`."""
TARGET_COLOR = (128, 128, 128)
"""Colour of the target bone length. Unlike the paper's black, it is readable on light and dark
backgrounds."""
JOINT_RADII = {"a": 0.006, "b": 0.006, "fused": 0.016, "truth": 0.010}
"""Metres."""
PROMINENT_JOINTS = ("ELBOW_LEFT", "ELBOW_RIGHT", "WRIST_LEFT", "WRIST_RIGHT", "KNEE_LEFT", "KNEE_RIGHT")
"""Joints whose weights are shown by default: those most often occluded and confused."""
PROMINENT_BONES = ("upper_arm", "forearm", "thigh", "shin")
"""Bones shown by default, on both sides: those of the paper's fig. 5."""
