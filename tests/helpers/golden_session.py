"""The golden session: what pins S* of the method ``duplex``, and the command that makes it again.

    python -m tests.helpers.golden_session

fuses the same pairs with today's method and writes ``tests/data/golden_duplex.npz``. It refuses to where S*
has changed and the revision of :data:`fusion.setup.REVISIONS` has not. The pairs are a simulated person
before two Kinects v2, who turns the back to each sensor and leaves for 2.4 s; in B every third skeleton is
missing for a second, and both views lose an arm.
"""

import hashlib
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion.body import KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.calibration.calibration import Calibration
from fusion.facing.sequence import relabel_sequence, reported_pairs
from fusion.fuser import Fuser
from fusion.pair_arrays import Pairs
from fusion.rigid import RigidTransform
from fusion.setup import REVISIONS, FusionSetup
from fusion.skeleton import Skeleton, SkeletonPair

FILE = Path(__file__).parents[1] / "data" / "golden_duplex.npz"
STEP = 0.00025
"""Metres: the positions are stored as multiples of it."""
EVERY = 5
"""The figures of every fifth pair are stored as float32; the digests are of all pairs."""
FIGURES = ("positions", "velocities", "sigma", "heading", "doubt_a", "doubt_b", "exchanged_a", "exchanged_b")
DIGESTED = (
    *FIGURES, "covariance", "predicted", "weights_a", "weights_b", "misleading_joint", "stale_a", "stale_b",
)  # fmt: skip
BODY = KINECT_V2


@dataclass(frozen=True)
class Run:
    """One fusion of the session's pairs."""

    digest: str  # SHA-256 of all figures of all pairs, as float64
    figures: dict[str, Any]  # by name, of every fifth pair


def c_library_rounds_likewise():
    """Whether exp, log and sine are those of Linux' C library for processors with fused multiply-add."""
    cpuinfo = Path("/proc/cpuinfo")
    return sys.platform == "linux" and cpuinfo.exists() and " fma " in cpuinfo.read_text()


def pairs_of(stored):
    """The session's pairs and its calibrations: the first one, and one that B's place is corrected to."""
    views = []
    for side, late in (("a", 0), ("b", stored["skew_ns"])):
        states = stored[f"states_{side}"]
        at = np.where(states[..., None] > 0, stored[side] * np.float32(STEP), np.nan).astype(np.float32)
        seen = zip(at, states, stored["time_ns"] + late, strict=True)
        views.append([Skeleton(BODY, x, s, int(t)) if s.any() else None for x, s, t in seen])
    times = zip(*views, stored["time_ns"].tolist(), stored["skew_ns"].tolist(), strict=True)
    pairs = [SkeletonPair(*of_one) for of_one in times]
    places = zip(stored["rotations"], stored["translations"], strict=True)
    return pairs, [
        Calibration(BODY, RigidTransform(R, t), stored["bone_lengths"], "golden session") for R, t in places
    ]


def runs_of(stored):
    """By name: ``live``, with a recalibration half-way, and ``whole``, as ``--smooth whole`` fuses."""
    pairs, (before, after) = pairs_of(stored)
    fuser, live = Fuser(FusionSetup(before)), []
    for k, pair in enumerate(pairs):
        if k == len(pairs) // 4:
            fuser.recalibrate(FusionSetup(after))
        live.append(fuser.update(pair))
    arrays = Pairs.of(BODY, pairs).arrays()
    views = arrays.a, after.a_from_b.apply(arrays.b)
    reported = reported_pairs(views, (arrays.states_a, arrays.states_b), after.a_from_b.translation)
    labels = relabel_sequence(BODY, reported, arrays.time_ns).as_stored()
    whole = Fuser(FusionSetup(after)).smooth_sequence(pairs, labels)
    return {"live": _run(live), "whole": _run(whole)}


def _run(frames):
    every = {name: np.array([getattr(frame, name) for frame in frames]) for name in DIGESTED}
    digest = hashlib.sha256()
    for values in every.values():
        numbers = values.astype(np.float64)
        numbers[np.isnan(numbers)] = 0.0  # a NaN has many bit patterns
        digest.update(numbers.tobytes())
    return Run(digest.hexdigest(), {name: every[name][::EVERY].astype(np.float32) for name in FIGURES})


def load():
    """The stored arrays by name."""
    with np.load(FILE) as stored:
        return dict(stored)


def expected_runs(stored):
    """The stored runs, as :func:`runs_of` gives them."""
    return {
        name: Run(str(stored[f"{name}/digest"]), {figure: stored[f"{name}/{figure}"] for figure in FIGURES})
        for name in ("live", "whole")
    }


def simulated_inputs():
    """The pairs as they were simulated at first; a simulator of today gives others."""
    from devices.simulated.kinect import simulated_pair
    from devices.simulated.rig import Rig
    from tests.helpers.frame_pairs import paired

    a, b, truth = simulated_pair(motion="walk", seed=35, body=BODY, seconds=16.0, rig=Rig(skew_seconds=0.012))
    pairs = [p.skeletons for p in paired(a.frames(), b.frames()).pairs]
    pairs = [p for p in pairs if p.a is not None and p.b is not None]
    pairs = [p for k, p in enumerate(pairs) if 150 <= k < 250 or 322 <= k < 412]
    stored = {
        "time_ns": np.array([p.time_ns for p in pairs]),
        "skew_ns": np.array([p.skew_ns for p in pairs]),
        "bone_lengths": _bones_of(truth, pairs),
    }
    for side in ("a", "b"):
        at = np.array([getattr(p, side).positions for p in pairs])
        stored[side] = np.round(np.nan_to_num(at) / STEP).astype(np.int16)
        stored[f"states_{side}"] = np.array([getattr(p, side).states for p in pairs])
    arm = [BODY.joint(f"{part}Left") for part in ("Elbow", "Wrist", "Hand", "HandTip", "Thumb")]
    for side in ("a", "b"):
        stored[f"states_{side}"][60:72, arm] = 0
    stored["states_b"][20:50:3] = 0
    right = truth.a_from_b
    angle = np.radians(3.0)
    R = np.array(((np.cos(angle), 0, np.sin(angle)), (0, 1, 0), (-np.sin(angle), 0, np.cos(angle))))
    wrong = RigidTransform(R @ right.rotation, right.translation + np.array((0.04, 0.0, -0.03)))
    stored["rotations"] = np.array((wrong.rotation, right.rotation))
    stored["translations"] = np.array((wrong.translation, right.translation))
    return stored


def _bones_of(truth, pairs):
    lengths = np.median(bone_lengths_of(BODY, truth.positions_at([p.time_ns for p in pairs])), axis=0)
    lengths[BODY.root] = 0.0
    return lengths


def main():
    """Makes the golden session again."""
    stored = load() if FILE.exists() else simulated_inputs()
    revision, runs = REVISIONS["duplex"], runs_of(stored)
    if "revision" in stored:
        same = all(runs[name].digest == run.digest for name, run in expected_runs(stored).items())
        if not same and int(stored["revision"]) == revision:
            sys.exit(
                f"S* has changed: raise the revision of duplex in fusion.setup.REVISIONS, now {revision}."
            )
    stored["revision"] = np.array(revision)
    for name, run in runs.items():
        stored[f"{name}/digest"] = np.array(run.digest)
        stored.update({f"{name}/{figure}": values for figure, values in run.figures.items()})
    np.savez_compressed(FILE, **stored)
    print(f"{FILE.name}: revision {revision}, {FILE.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
