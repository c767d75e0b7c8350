"""S* on recordings of two real sensors, without ground truth: ``python -m tests.benchmarks.real FOLDER…``.

Each folder has the recordings ``a.csv`` and ``b.csv``. The figures are written to ``results/real.json``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from devices.files import RecordingChoice, read_two
from devices.pairing import FramePair
from fusion.body import Body
from fusion.plan import plan_recording
from fusion.setup import FuserSettings
from fusion.skeleton import Skeleton, SkeletonPair, TrackingState
from fusion.without_truth import FusedPair, figures_without_truth, judge_registration
from recordings.fusing.pairs import fuse_segments, setups_of
from tests.benchmarks import results
from tests.benchmarks.faults import FAULTS, Fault, share_of_fault, with_fault

FAULTY_FRAMES = 20
FAULTY_PLACES = (0.4, 0.6, 0.8)
"""Start of each fault as a share of the recording's length; the start-up pose comes before them."""


def measure(body: Body, skeletons: Sequence[SkeletonPair], *, faults: bool) -> dict[str, float]:
    """Computes all figures of one recording, by name, in SI.

    Raises:
        FusionError: The recording is too short, or cannot be calibrated.
    """
    pair = fuse_pair(body, skeletons)
    figures = figures_without_truth(pair)
    half = len(skeletons) // 2
    learned = fuse_pair(body, skeletons[:half]).a_from_b[-1]
    held_out = judge_registration(learned, pair.a[half:], pair.b[half:])
    row = {name: float(value) for name, value in asdict(figures).items()}
    row["roughness_ratio"] = figures.roughness_ratio
    row |= {f"held_out_{name}": float(value) for name, value in asdict(held_out).items()}
    if faults:
        for fault in FAULTS:
            for side in ("a", "b"):
                row[f"{fault}_{side}"] = fault_share(pair, skeletons, fault, side)
    return row


def fuse_pair(body: Body, skeletons: Sequence[SkeletonPair]) -> FusedPair:
    """Fuses a recording as the program does with its default settings."""
    settings = FuserSettings(hindsight="labels")
    plan = plan_recording(body, skeletons, settings)
    pairs = [FramePair(None, None, pair) for pair in skeletons]
    segments = setups_of(plan, settings, (None, None))
    frames = [frame.fused for frame in fuse_segments(segments, pairs, plan.codes)]
    nowhere = np.full((len(body), 3), np.nan)

    def positions(side: str) -> NDArray[np.float64]:
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


def fault_share(pair: FusedPair, skeletons: Sequence[SkeletonPair], fault: Fault, side: str) -> float:
    """Computes the share of a fault in one view that reaches S*, averaged over FAULTY_PLACES."""
    view = getattr(pair, side)
    shares = []
    for place in FAULTY_PLACES:
        first = int(place * len(view))
        frames = range(first, first + FAULTY_FRAMES)
        faulty = with_fault(pair.body, view, fault, frames)
        other = fuse_pair(pair.body, _with_view(skeletons, side, faulty, frames))
        shares.append(share_of_fault(view, getattr(other, side), pair.fused, other.fused))
    known = [share for share in shares if np.isfinite(share)]
    return float(np.mean(known)) if known else np.nan


def _with_view(
    skeletons: Sequence[SkeletonPair], side: str, positions: NDArray[np.float64], frames: range
) -> list[SkeletonPair]:
    """Replaces the joints of one view in some frames.

    A joint without a position becomes tracked if it gets one.
    """
    changed = list(skeletons)
    for k in frames:
        skeleton: Skeleton | None = getattr(skeletons[k], side)
        if skeleton is None:
            continue
        states = np.where(skeleton.has_position, skeleton.states, np.uint8(TrackingState.TRACKED))
        moved = Skeleton.of(skeleton.body, positions[k], states, skeleton.time_ns)
        changed[k] = replace(skeletons[k], a=moved) if side == "a" else replace(skeletons[k], b=moved)
    return changed


def mean_of(rows: dict[str, dict[str, float]]) -> dict[str, float]:
    """Computes the mean of each figure over the recordings that have it."""
    names = dict.fromkeys(name for row in rows.values() for name in row)
    known = {name: [row[name] for row in rows.values() if np.isfinite(row[name])] for name in names}
    return {name: float(np.mean(values)) if values else np.nan for name, values in known.items()}


def main(arguments: Sequence[str] | None = None) -> None:
    """Judges each recording."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--no-faults", action="store_true", help="leave out the artificial faults")
    options = parser.parse_args(arguments)
    rows = {}
    for folder in options.folders:
        read = read_two(*(RecordingChoice(folder / f"{side}.csv") for side in "ab"))
        skeletons = [pair.skeletons for pair in read.pairing.pairs]
        row = rows[folder.name] = measure(read.body, skeletons, faults=not options.no_faults)
        print(f"{folder.name}: roughness {row['roughness_ratio']:.2f} of the views'", file=sys.stderr)
    # the folders may lie anywhere: the written command names them without their path
    sys.argv[1:] = [Path(argument).name for argument in sys.argv[1:]]
    results.write("real", {"pairs": rows, "mean": mean_of(rows)})


if __name__ == "__main__":
    main()
