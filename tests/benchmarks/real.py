"""S* on recordings of two real sensors, without ground truth: ``python -m tests.benchmarks.real FOLDER…``.

Each folder has the recordings ``a.csv`` and ``b.csv``. The figures are written to ``results/real.json``.
"""

import argparse
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np

from devices.files import RecordingChoice, read_two
from devices.pairing import RecordedPairs
from fusion.pair_arrays import Pairs
from fusion.plan import plan_recording
from fusion.setup import FuserSettings
from fusion.without_truth import FusedPair, figures_without_truth, judge_registration
from recordings.fusing.pairs import fuse_segments, setups_of
from tests.benchmarks import results


def measure(body, skeletons):
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
    return row


def fuse_pair(body, skeletons):
    """Fuses a recording as the program does with its default settings."""
    settings = FuserSettings(hindsight="labels")
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


def mean_of(rows):
    """Computes the mean of each figure over the recordings that have it."""
    names = dict.fromkeys(name for row in rows.values() for name in row)
    known = {name: [row[name] for row in rows.values() if np.isfinite(row[name])] for name in names}
    return {name: float(np.mean(values)) if values else np.nan for name, values in known.items()}


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
    results.write("real", {"pairs": rows, "mean": mean_of(rows)})


if __name__ == "__main__":
    main()
