"""Figures of S* on simulated scenes and on real pairs, in ``tests/data/summaries.json``.

    python -m tests.helpers.golden_summaries ../shared/real

writes them again after a change of S* that is meant, and prints what changed. The scores are those of the
benchmarks; a scene is read from files, as by ``duplex fuse``.
"""

import json
import sys
from dataclasses import dataclass, field
from math import isclose
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from devices.simulated.kinect import Movement, simulated_pair
from devices.simulated.rig import Rig
from fusion.body import AZURE_KINECT, KINECT_V1, KINECT_V2, Body
from fusion.rigid import RigidTransform
from recordings import fuse
from recordings.quality.without_truth import FusedPair, figures_without_truth
from tests.benchmarks.scores import accuracy
from tests.experiments.example_recordings import csv_of
from tests.helpers.recorded_pairs import REAL
from tests.helpers.two_people import BEHIND

FILE = Path(__file__).parents[1] / "data" / "summaries.json"
TOLERANCE, DIGITS = 0.01, 3
"""The same S* on another machine differs by less than 1e-9; a figure that changes by 1 % is worth a look."""


@dataclass(frozen=True)
class Scene:
    """A simulated person, in front of two sensors for some seconds."""

    motion: str
    body: Body = AZURE_KINECT
    rig: dict[str, Any] = field(default_factory=dict)
    other: Movement | None = None
    late: int = 0  # the first frame of B
    seconds: float = 7.0


SCENES = {
    "walk": Scene("walk"),
    "squat": Scene("squat", KINECT_V2),
    "arms": Scene("arms", rig={"angle_deg": 45.0}),
    "sit": Scene("sit", KINECT_V1),
    "turn": Scene("turn", KINECT_V2, {"angle_deg": 60.0}, seconds=8.0),
    "two people": Scene("walk", KINECT_V2, {"frame_seconds": 1.0 / 15.0}, other=BEHIND),
    "B late": Scene("boxing", late=45, rig={"skew_seconds": 0.015}),
    "15 frames per second": Scene("basketball", KINECT_V2, {"frame_seconds": 1.0 / 15.0}),
}


def of_scene(scene):
    """The figures of a simulated scene."""
    rig = Rig(**scene.rig)
    a, b, truth = simulated_pair(
        motion=scene.motion, body=scene.body, rig=rig, other=scene.other, seconds=scene.seconds, seed=52
    )
    with TemporaryDirectory() as work:
        for name, sensor, first in (("a", a, 0), ("b", b, scene.late)):
            text = csv_of(scene.body, list(sensor.frames())[first:])
            (Path(work) / f"{name}.csv").write_text(text, encoding="utf-8")
        session = fuse(Path(work) / "a.csv", Path(work) / "b.csv")
    rows = session.rows
    seen = np.flatnonzero(rows.clock_a > 0)
    times = rows.time_ns + rows.clock_a[seen[0]] - rows.time_ns[seen[0]]
    scores = accuracy(
        scene.body, rows.fused, truth.positions_at(times), rows.states_a, rows.states_b, rig.frame_seconds,
        rows.sigma,
    )  # fmt: skip
    return summary(session) | {
        "mean error, mm": 1e3 * scores["mpjpe"],
        "95 % of errors, mm": 1e3 * scores["p95"],
        "within one sigma, %": 1e2 * scores["within_1sd"],
        "within two sigma, %": 1e2 * scores["within_2sd"],
    }


def of_real(name, folder):
    """The figures of a real pair in a folder of them."""
    pair = folder / f"kinect_v2_90deg_{name}"
    return summary(fuse(pair / "a.csv", pair / "b.csv"))


def summary(session):
    """The figures of a session that need no truth."""
    rows = session.rows
    places = zip(rows.rotation, rows.translation, strict=True)
    pair = FusedPair(
        session.body, rows.time_ns, rows.positions_a, rows.positions_b, rows.fused,
        tuple(RigidTransform(R, t) for R, t in places),
    )  # fmt: skip
    found = figures_without_truth(pair)
    return {
        "frames": found.frames,
        "events": len(session.events),
        "roughness of the views'": found.roughness_ratio,
        "own jumps, %": 1e2 * found.jumps_own,
        "hands together, %": 1e2 * found.hands_together,
        "flips a minute": found.flips_per_minute,
        "views apart, mm": 1e3 * found.apart,
        "error of a bone, mm": 1e3 * float(np.nanmax(session.quality.bone_error)),
        "sigma, mm": 1e3 * float(np.nanmedian(rows.sigma)),
        "rotation off, degrees": float(np.degrees(found.rotation_off)),
        "calibrations": len(session.calibrations),
    }


def expected():
    """The stored figures, by the name of the scene or of the real pair."""
    return json.loads(FILE.read_text(encoding="utf-8"))


def differences(found, stored):
    """A line for each figure that has changed, with the old and the new one."""
    return [
        f"{name:26} {stored.get(name)} -> {found.get(name)}"
        for name in {**stored, **found}
        if name not in found or name not in stored or not _alike(found[name], stored[name])
    ]


def _alike(one, other):
    return isclose(one, other, rel_tol=TOLERANCE, abs_tol=10.0**-DIGITS) or (one != one and other != other)


def main(real=None):
    """Writes the figures of today; those of real pairs stay if there is no folder of them."""
    stored = expected() if FILE.exists() else {}
    found = {name: of_scene(scene) for name, scene in SCENES.items()}
    for name in REAL:
        found[f"real {name}"] = of_real(name, real) if real else stored[f"real {name}"]
    for name, figures in found.items():
        figures |= {figure: round(value, DIGITS) for figure, value in figures.items()}
        print(name, *differences(figures, stored.get(name, {})), sep="\n  ")
    FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
