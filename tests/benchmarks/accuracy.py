"""Accuracy of S* in millimetres, beside simpler methods: ``python -m tests.benchmarks.accuracy azure``.

Every method gets the same simulated recordings, whose truth is known: each movement at each angle between the
sensors, once per seed. The figures are written to ``results/accuracy_SET.json``.
"""

import argparse
import os
import sys
from itertools import product

import numpy as np

from tests.benchmarks import results
from tests.benchmarks.methods import METHODS, OURS, WITHOUT_DEPTH
from tests.benchmarks.trials import Simulation, Trial, run_trials

SETS = {
    "azure": Simulation("azure_kinect"),
    "kinect_v2": Simulation("kinect_v2"),
    "blazepose": Simulation("blazepose"),
    "larger_errors": Simulation("azure_kinect", errors=1.5),
    "heavy_tails": Simulation("azure_kinect", tracker_errors="heavy-tailed"),
    "depth": Simulation("azure_kinect", depth="half"),
}
"""By name. Nothing is fitted to the larger errors or to the heavy tails; S* uses the images of ``depth``."""

MOTIONS = ("walk", "arms", "badminton", "basketball", "squat", "sit", "boxing", "still")
ANGLES = (45.0, 90.0, 135.0)
SEEDS = (7300, 7301)
"""Nobody looked at these seeds during development."""

_KINDS = {method.name: method.kind for method in METHODS}


def summary(outcomes):
    """The figures of each method over all trials, and where another method is nearer to the truth.

    Returns:
        ``methods``: by name, the mean of each figure over the trials in which every method has it. Also
        ``interval`` of the mean error; ``less``, the interval of its difference from ours in the same trial;
        and ``nearer``, the share of trials in which ours has the smaller mean error.
        ``lost``: the movements and angles at which a baseline is nearer on average, and by how many metres.
    """
    methods = {}
    common = common_trials(outcomes, "mpjpe")
    errors = {
        name: np.array([o.figures["mpjpe"] for o in outcomes if o.method == name and o.trial in common])
        for name in dict.fromkeys(o.method for o in outcomes)
    }
    for name in errors:
        own = [o for o in outcomes if o.method == name]
        methods[name] = {
            **{figure: _mean(own, figure, common_trials(outcomes, figure)) for figure in own[0].figures},
            "interval": interval(errors[name]),
            "less": interval(errors[OURS] - errors[name]) if OURS in errors else None,
            "nearer": nearer(outcomes, name),
        }
    return {"recordings": len({o.trial for o in outcomes}), "methods": methods, "lost": lost(outcomes)}


def interval(values):
    """The 95 % bootstrap interval of a mean, over whole recordings: two numbers."""
    drawn = np.random.default_rng(0).integers(len(values), size=(10_000, len(values)))
    return np.quantile(values[drawn].mean(axis=1), (0.025, 0.975)).tolist()


def common_trials(outcomes, figure):
    """The trials in which every method has a figure. A method that never has the figure is ignored."""
    having = {o.method for o in outcomes if np.isfinite(o.figures[figure])}
    missing = {o.trial for o in outcomes if o.method in having and not np.isfinite(o.figures[figure])}
    return {o.trial for o in outcomes} - missing


def nearer(outcomes, method):
    """The share of trials in which ours is nearer to the truth than another method; NaN without ours."""
    ours = {o.trial: o.figures["mpjpe"] for o in outcomes if o.method == OURS}
    if not ours or method == OURS:
        return float("nan")
    return float(np.mean([ours[o.trial] < o.figures["mpjpe"] for o in outcomes if o.method == method]))


def lost(outcomes):
    """Each movement and angle at which a view or a baseline is nearer to the truth than ours on average."""
    found = []
    rivals = [n for n in dict.fromkeys(o.method for o in outcomes) if _KINDS[n] in ("view", "baseline")]
    for motion, angle in dict.fromkeys((o.trial.motion, o.trial.angle) for o in outcomes):
        here = [o for o in outcomes if (o.trial.motion, o.trial.angle) == (motion, angle)]
        ours = _mean([o for o in here if o.method == OURS], "mpjpe")
        for method in rivals:
            by = ours - _mean([o for o in here if o.method == method], "mpjpe")
            if by > 0.0:
                found.append({"motion": motion, "angle": angle, "method": method, "by": by})
    return found


def _mean(outcomes, figure, trials=None):
    values = [o.figures[figure] for o in outcomes if trials is None or o.trial in trials]
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else float("nan")


def main(arguments=None):
    """Measures one set of recordings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("set", choices=SETS, help="which trackers and errors are simulated")
    parser.add_argument("--motions", nargs="+", choices=MOTIONS, default=MOTIONS)
    parser.add_argument("--angles", nargs="+", type=float, default=ANGLES, help="degrees between the sensors")
    parser.add_argument("--seeds", nargs="+", type=int, default=SEEDS)
    parser.add_argument("--seconds", type=float, default=20.0, help="duration of each recording")
    parser.add_argument("--methods", nargs="+", choices=_KINDS, help="all if not given")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--print", action="store_true", help="print the figures instead of writing the file")
    options = parser.parse_args(arguments)
    simulation = SETS[options.set]
    names = options.methods or [
        method.name for method in METHODS if method.name != WITHOUT_DEPTH or simulation.depth != "none"
    ]
    trials = [Trial(*one) for one in product(options.motions, options.angles, options.seeds)]
    outcomes = []
    for of_trial in run_trials(trials, simulation, options.seconds, names, options.processes):
        outcomes += of_trial
        print(f"\r{len({o.trial for o in outcomes})} of {len(trials)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    figures = {"seeds": list(options.seeds), "seconds": options.seconds, **summary(outcomes)}
    for name, row in figures["methods"].items():
        print(f"{name:20} {1e3 * row['mpjpe']:6.1f} mm  95 %: {1e3 * row['p95']:.0f} mm")
    if not options.print:
        results.write(f"accuracy_{options.set}", figures)


if __name__ == "__main__":
    main()
