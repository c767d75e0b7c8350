"""What each step of the estimator is worth: ``python -m tests.benchmarks.ablation FOLDER…``.

Simulated recordings, and real pairs (``a.csv`` and ``b.csv`` of each folder), are fused as a whole and with
one step made ineffective by its constants. Differences are paired over recordings. The figures are written to
``results/ablation.json``.
"""

import argparse
import sys
from itertools import product
from pathlib import Path

import numpy as np

from devices.recorded.two_recordings import RecordingChoice, read_two
from fusion.estimator.constants import Constants
from fusion.facing.labels import Labels
from fusion.fuser import Fuser
from fusion.pair_arrays import Pairs
from fusion.plan import plan_recording
from fusion.setup import FuserSettings, FusionSetup
from recordings.quality.without_truth import FusedPair, figures_without_truth
from tests.benchmarks import results
from tests.benchmarks.accuracy import interval
from tests.benchmarks.trials import Simulation, Trial, record

_NEVER = 1e-12  # a probability, of which the filter takes the logarithm
STEPS = {
    "": {},
    "exact bones": {"bones": False},
    "scale of a view": {"scale_sd": _NEVER},
    "outliers": {"outlier": _NEVER, "inferred_outlier": _NEVER, "outlier_lasts": _NEVER, "surprise": _NEVER},
    "surprise": {"surprise": _NEVER},
    "covering joints": {"near_limit": 1.0},
    "lengths as evidence": {"length_limit": 0.0},
    "joints on the other limb": {"other_limb_limit": 0.0},
    "heading of the girdles": {"heading": False},
    "size of slow errors": {"freedom": 1.0 / _NEVER},
    "fast errors by speed": {"fast_by_speed": 0.0},
}
"""For each ablated step, constants with which it has no effect; none for the whole method."""
MOTIONS, ANGLES, SEED = ("walk", "badminton", "squat", "arms"), (60.0, 120.0), 7302


def without(body, skeletons, measure):
    """Returns the figures of one recording for each ablated step."""
    settings = FuserSettings(hindsight="labels")
    plan = plan_recording(body, skeletons, settings)
    pairs, found = Pairs.of(body, skeletons), {}
    for name, constants in STEPS.items():
        setups = [FusionSetup(calibration, settings) for calibration, _ in plan.segments]
        fuser, positions, places = Fuser(setups[0], Constants.of(body)._replace(**constants)), [], []
        for setup, (calibration, part) in zip(setups, plan.segments, strict=True):
            if positions:
                fuser.recalibrate(setup)
            frames = fuser.fuse_sequence(pairs[part], Labels(*(of[part] for of in plan.labels)))
            positions += [frame.positions for frame in frames]
            places += [calibration.a_from_b] * len(frames)
        found[name] = measure(np.array(positions), tuple(places))
    return found


def simulated(body, trial):
    """Returns the mean joint error of a simulated recording, in metres."""
    recording, first = record(trial, Simulation(body), 12.0)

    def error(fused, _):
        return {"error": float(np.nanmean(np.linalg.norm(fused - recording.truth, axis=2)[first:]))}

    return without(recording.body, [pair.skeletons for pair in recording.pairs], error)


def real(folder):
    """Returns the figures of a real recording, which need no ground truth."""
    read = read_two(*(RecordingChoice(folder / f"{side}.csv") for side in "ab"))
    skeletons = [pair.skeletons for pair in read.pairing.pairs]
    views = Pairs.of(read.body, skeletons).arrays()
    a, b = (
        np.where(states[..., None] > 0, at, np.nan).astype(np.float64)
        for at, states in ((views.a, views.states_a), (views.b, views.states_b))
    )

    def figures(fused, places):
        of = figures_without_truth(FusedPair(read.body, views.time_ns, a, b, fused, places))
        return {
            "roughness": of.roughness_ratio,
            "hands_together": of.hands_together,
            "heading": of.heading_fused,
        }

    return without(read.body, skeletons, figures)


def differences(recordings):
    """Returns the mean of each figure, and for each ablated step its mean difference and 95 % interval."""
    rows = {}
    for name, figure in product(STEPS, recordings[0][""]):
        values = np.array([[of[name][figure], of[""][figure]] for of in recordings])
        values = values[np.isfinite(values).all(axis=1)]
        change = values[:, 0] - (values[:, 1] if name else 0.0)
        if len(change):
            rows.setdefault(name, {})[figure] = [float(change.mean()), *interval(change)]
    return rows


def main(arguments=None):
    """Measures each step."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path)
    options = parser.parse_args(arguments)
    trials = [Trial(motion, angle, SEED) for motion in MOTIONS for angle in ANGLES]
    figures = {}
    for body in ("azure_kinect", "kinect_v2", "blazepose"):
        figures[body] = differences([simulated(body, trial) for trial in trials])
        print(body, figures[body], file=sys.stderr)
    if options.folders:
        figures["real"] = differences([real(folder) for folder in options.folders])
    # the folders may lie anywhere: the written command names them without their path
    sys.argv[1:] = [Path(argument).name for argument in sys.argv[1:]]
    results.write("ablation", {"recordings": len(trials), "pairs": len(options.folders), "steps": figures})


if __name__ == "__main__":
    main()
