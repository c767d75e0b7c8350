"""Degrees that joints reach, and the axes of their plots."""

POSSIBLE = {
    "hip_flexion": (-45.0, 165.0),
    "knee_flexion": (-15.0, 165.0),
    "hip_abduction": (-50.0, 80.0),
    "shoulder_flexion": (-90.0, 185.0),
    "shoulder_abduction": (-60.0, 185.0),
    "elbow_flexion": (-15.0, 165.0),
}
"""Degrees that a joint reaches, with room for very mobile people; those of the trunk depend on the pose."""
PLOTTED_DEGREES = {
    "hip_flexion": (-45.0, 125.0),
    "knee_flexion": (-15.0, 155.0),
    "hip_abduction": (-32.0, 32.0),
    "elbow_flexion": (-15.0, 155.0),
    "shoulder_flexion": (-65.0, 185.0),
    "shoulder_abduction": (-65.0, 185.0),
    "trunk": (-32.0, 32.0),
}
"""Axes of the viewer's plots. Rerun numbers whole tens or hundreds: an axis has two on a small screen."""
