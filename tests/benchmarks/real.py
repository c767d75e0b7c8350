"""S* on recordings of two real sensors, without ground truth: ``python -m tests.benchmarks.real FOLDER…``.

Each folder has the recordings ``a.csv`` and ``b.csv``. The figures are written to ``results/real.json``.
"""

import argparse
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from devices.frame_pairs import RecordedPairs
from devices.recorded.two_recordings import RecordingChoice, read_two
from fusion.pair_arrays import Pairs
from fusion.plan import plan_recording
from fusion.setup import FuserSettings
from recordings.fusing.pairs import fuse_segments, setups_of
from recordings.quality.without_truth import FusedPair, figures_without_truth
from tests.benchmarks import results

_FAULT_FRAMES = 20
_FAULT_SHIFT = np.array([0.25, 0.0, 0.0], dtype=np.float32)  # metres
_TOLD = 0.08  # metres: a fault that moves a joint less is none
_ARM = ("ElbowRight", "WristRight", "HandRight", "HandTipRight", "ThumbRight")


def measure(body, skeletons):
    """Computes all figures of one recording, by name, in SI.

    ``live_…`` are those without later frames, ``fault_…`` the shares of faults in one view that reach S*, and
    ``floor_…`` those where the faulty joints are deleted instead, which no detection of faults can better.

    Raises:
        FusionError: The recording is too short, or cannot be calibrated.
    """
    pair = fuse_pair(body, skeletons)
    figures = figures_without_truth(pair)
    live = figures_without_truth(fuse_pair(body, skeletons, "none"))
    row = {name: float(value) for name, value in asdict(figures).items()}
    row["roughness_ratio"] = figures.roughness_ratio
    row |= {f"live_{name}": float(getattr(live, name)) for name in ("heading_fused", "astray_fused")}
    for kind in FAULTS:
        row[f"fault_{kind}"], row[f"floor_{kind}"] = fault_shares(body, skeletons, pair, kind)
    return row


def _snapped(body, _, view):
    """The right arm in front of the trunk."""
    joints = view.positions.copy()
    trunk = joints[body.joint("SpineMid" if body.find("SpineMid") is not None else "SpineNavel")]
    for k, name in enumerate(_ARM):
        joints[body.joint(name)] = trunk + (0.12, 0.02 * k, 0.0)
    return replace(view, positions=joints, states=view.states * np.isfinite(joints).all(axis=1))


def _swapped(body, _, view):
    return replace(view, positions=view.positions[body.mirror], states=view.states[body.mirror])


FAULTS = {
    "snap": _snapped,
    "swap": _swapped,
    "freeze": lambda _, before, view: replace(view, positions=before.positions, states=before.states),
    "shift": lambda _, __, view: replace(view, positions=view.positions + _FAULT_SHIFT),
}
"""The view with a fault, from that before it and that of the frame."""


def fault_shares(body, skeletons, clean, kind):
    """How far S* moves per metre by which 20 faulty frames of one view move a joint; NaN without them.

    Returns:
        The share with the faulty joints, and without these joints.
    """
    moved, faulty = np.zeros(2), 0.0
    early, late = len(skeletons) // 3, len(skeletons) - 2 * _FAULT_FRAMES
    for seed in range(2 if early < late else 0):
        random = np.random.default_rng(seed)
        side = "ab"[seed % 2]
        first = int(random.integers(early, late))
        before = getattr(skeletons[first - 1], side)
        if before is None:
            continue
        fault = np.zeros(getattr(clean, side).shape[:2])
        spoilt, deleted = list(skeletons), list(skeletons)
        for k in range(first, first + _FAULT_FRAMES):
            view = getattr(skeletons[k], side)
            if view is not None:
                wrong = FAULTS[kind](body, before, view)
                fault[k] = np.nan_to_num(np.linalg.norm(wrong.positions - view.positions, axis=1))
                kept = replace(view, states=view.states * (fault[k] == 0.0))
                spoilt[k], deleted[k] = (
                    replace(skeletons[k], **{side: changed}) for changed in (wrong, kept)
                )
        hit = fault > _TOLD
        faulty += float(fault[hit].sum())
        for n, pairs in enumerate((spoilt, deleted)):
            apart = np.linalg.norm(fuse_pair(body, pairs).fused - clean.fused, axis=2)
            moved[n] += float(np.nansum(apart[hit]))
    return (moved / faulty if faulty else np.full(2, np.nan)).tolist()


def fuse_pair(body, skeletons, hindsight="labels"):
    """Fuses a recording; without another hindsight as the program does with its default settings."""
    settings = FuserSettings(hindsight=hindsight)
    plan = plan_recording(body, skeletons, settings)
    pairs = RecordedPairs(Pairs.of(body, skeletons))
    segments = setups_of(plan, settings, (None, None))
    frames = [fused for block in fuse_segments(segments, pairs, plan.labels) for fused in block.fused]
    nowhere = np.full((len(body), 3), np.nan)

    def positions(side):
        view = [getattr(pair, side) for pair in skeletons]
        return np.array([nowhere if s is None else s.positions for s in view], dtype=np.float64)

    return FusedPair(
        body,
        np.array([pair.time_ns for pair in skeletons]),
        positions("a"),
        positions("b"),
        np.array([frame.positions for frame in frames]),
        tuple(frame.a_from_b for frame in frames),
    )


def main(arguments=None):
    """Judges each recording."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    options = parser.parse_args(arguments)
    rows = {}
    for folder in options.folders:
        read = read_two(*(RecordingChoice(folder / f"{side}.csv") for side in "ab"))
        skeletons = [pair.skeletons for pair in read.pairing.pairs]
        row = rows[folder.name] = measure(read.body, skeletons)
        print(f"{folder.name}: roughness {row['roughness_ratio']:.2f} of the views'", file=sys.stderr)
    # the folders may lie anywhere: the written command names them without their path
    sys.argv[1:] = [Path(argument).name for argument in sys.argv[1:]]
    results.write("real", {"pairs": rows})


if __name__ == "__main__":
    main()
