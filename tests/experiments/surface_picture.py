"""Draws what two sensors see of one person, registered by joints and by the surface, for the documentation.

``python -m tests.experiments.surface_picture`` writes ``docs/pictures/surface.svg``: slices of the point
clouds of two simulated Kinects v2, from above, with the joints of S*.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from devices.simulated.demonstration import demonstrated
from fusion.body import KINECT_V2
from tests.benchmarks.surface import Recorded
from tests.experiments.placement_picture import COLORS, write_svg

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "surface.svg"
SLICES = {"chest": ("SpineShoulder", 0.05), "hips": ("SpineBase", 0.0)}
"""A joint and metres below it, where the body is cut."""
_THICK, _AROUND = 0.03, 0.25  # metres to each side


def draw(seed=7903):
    """Writes the picture; x of K_A's frame to the right, its z upwards."""
    recorded = Recorded(KINECT_V2, demonstrated("walk"), 60.0, seed, 14.0)
    pairs = recorded.pairing.pairs.skeletons
    seen = {}

    def surfaces(moments):
        seen["shared"], seen["moments"] = recorded.surfaces(moments), moments
        return seen["shared"]

    found = {"by joints": recorded.of_file(None), "by the surface": recorded.of_file(surfaces)}
    shared, moment = seen["shared"], len(seen["shared"].moments) // 2
    a, b = shared.moments[moment]
    k = int(np.searchsorted(pairs.time_ns, seen["moments"].time_ns[moment]))
    figure = Figure(figsize=(7.2, 6.8), layout="constrained")
    panels = figure.subplots(len(SLICES), len(found))
    for (title, (calibration, fused)), column in zip(found.items(), panels.T, strict=True):
        in_a = calibration.a_from_b.apply(b.points)
        for (part, (joint, below)), axes in zip(SLICES.items(), column, strict=True):
            x, y, z = fused[k][KINECT_V2.joint(joint)]
            for name, points, color in zip("AB", (a.points, in_a), COLORS, strict=True):
                near = np.abs(points[:, 1] - y - below) < _THICK
                label = f"seen by {name}"
                axes.plot(points[near, 0], points[near, 2], ".", color=color, label=label, markersize=4)
            axes.plot(x, z, "o", color="#8b3fd1", label="S*")
            axes.set(aspect="equal", xlim=(x - _AROUND, x + _AROUND), ylim=(z - _AROUND, z + _AROUND))
            axes.set_title(f"{part}, {title}")
        column[-1].set_xlabel("x of sensor A (m)")
    for axes in panels[:, 0]:
        axes.set_ylabel("z of sensor A (m)")
    panels[0, 0].legend(loc="lower left", fontsize="small")
    write_svg(PICTURE, figure)


if __name__ == "__main__":
    draw()
