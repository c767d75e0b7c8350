"""Draws two sensors from above, and where both see a whole person, for the documentation.

``python -m tests.experiments.placement_picture`` writes ``docs/pictures/placement.svg``. The area and the
best place come from :mod:`viewer_app.coach.standing_spot`, as in the viewer.
"""

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from devices.findings.rules import farthest, nearest
from fusion.intrinsics import NOMINAL_INTRINSICS
from fusion.rigid import RigidTransform
from recordings.appearance.floor import LEVEL_FLOOR
from viewer_app.coach.standing_spot import ARM, standing_spot

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "placement.svg"
BODY = "azure_kinect"
CAMERA = NOMINAL_INTRINSICS[BODY]
COLORS = ("#d9822b", "#2b7bba")
FARTHEST = farthest(BODY, CAMERA)
PERSON_AT = np.array([0.0, 0.0, 2.6])


def a_from_b(angle_deg):
    """Sensor B, turned round the person by an angle; both look at the person."""
    turn = Rotation.from_euler("y", -angle_deg, degrees=True).as_matrix()
    return RigidTransform(turn, PERSON_AT - turn @ PERSON_AT)


def seen_by_both(b, points):
    """Whether points (…, 3) in A's frame are places for a person whom both sensors see whole."""
    return _seen(points) & _seen(b.inverse().apply(points))


def _seen(points):
    across, away = points[..., 0], points[..., 2]
    half = away * CAMERA.width / 2.0 / CAMERA.fx - ARM
    return (away >= nearest(CAMERA)) & (away <= FARTHEST) & (np.abs(across) <= half)


def draw(angle_deg=90.0):
    """Writes the picture; x of K_A's frame to the right, its z upwards."""
    b = a_from_b(angle_deg)
    figure = Figure(figsize=(6.4, 5.0), layout="constrained")
    axes = figure.subplots()
    x, z = np.meshgrid(np.arange(-1.6, 3.6, 0.01), np.arange(-0.6, 4.6, 0.01))
    both = seen_by_both(b, np.stack((x, np.zeros_like(x), z), axis=-1))
    axes.contourf(x, z, both, levels=[0.5, 1.5], colors=["#7fb3d9"])
    edge = CAMERA.width / 2.0 / CAMERA.fx * FARTHEST
    corners = np.array([[-edge, 0.0, FARTHEST], [0.0, 0.0, 0.0], [edge, 0.0, FARTHEST]])
    for name, pose, color in zip("AB", (RigidTransform.identity(), b), COLORS, strict=True):
        cone = pose.apply(corners)
        axes.fill(cone[:, 0], cone[:, 2], color=color, alpha=0.12)
        axes.plot(*pose.apply(np.zeros(3))[[0, 2]], "s", color=color, markersize=11)
        axes.annotate(
            f"sensor {name}", pose.apply(np.zeros(3))[[0, 2]], (10, -14), textcoords="offset points"
        )
    spot = standing_spot(b, (CAMERA, CAMERA), BODY, LEVEL_FLOOR)
    axes.plot(spot.x, spot.z, "o", color="black", markersize=20, fillstyle="none", markeredgewidth=2)
    axes.annotate("stand here", (spot.x, spot.z), (14, 14), textcoords="offset points")
    axes.set(xlabel="x of sensor A (m)", ylabel="z of sensor A (m)", aspect="equal", ylim=(-0.6, 4.6))
    write_svg(PICTURE, figure)


def write_svg(path, figure):
    """Writes a figure without a date and with fixed identifiers: the same figure is the same file."""
    with rc_context({"svg.hashsalt": "duplex-kinects"}):
        figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    draw()
