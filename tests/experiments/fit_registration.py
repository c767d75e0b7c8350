"""Where the registration's numbers come from: ``python -m tests.experiments.fit_registration WHAT``.

``fit`` prints, for each tempering, bias and inflation, the error of R and t over whole recordings and how
often it lies within one and two stated standard deviations: about 68 % and 95 % are wanted. ``gain`` does
so for the gain that a refinement needs. ``knock`` prints, for each threshold, in how many recordings a knock
of B is noticed within two seconds, and in how many without a knock one is reported. ``clock`` prints the
error of the clock offset. All use simulated recordings; the seeds 3000–3003 are for development.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from devices.pairing import pair_recordings
from devices.simulated.kinect import PERSON, simulated_pair
from fusion.body import BODIES, Body
from fusion.calibration.calibration import Calibration
from fusion.calibration.offline import learn_from_recording
from fusion.calibration.online import CalibrationLearner, LearnerSettings
from fusion.errors import CalibrationError
from fusion.plan import start_up_calibration
from fusion.registration.clock_offset import clock_offset_of
from fusion.registration.knocked import KnockSettings
from fusion.registration.refinement import RefinementSettings
from fusion.registration.robust_fit import RobustFitSettings
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair

MOTIONS = ("walk", "arms", "badminton", "basketball", "squat", "sit", "boxing")
TEMPERINGS, INFLATIONS, BIASES = (3.0, 10.0, 30.0), (1.0, 2.5, 6.0), (0.02, 0.03, 0.045)
GAINS = (0.0, 3.0, 6.0)
SMALLEST, DEVIATIONS = (0.03, 0.045, 0.06), (4.0, 5.0, 6.0)
KNOCK = RigidTransform.of(Rotation.from_euler("yx", [-5, 1], degrees=True).as_matrix(), [0.0, 0.02, -0.1])
KNOCK_AFTER = 0.5  # of the recording
_MOVES_NS = 200_000_000  # duration of the knock
_NOTICED_NS = 2_000_000_000
_LATE = 0.012  # s: the delay of B's captures that ``clock`` hides in the time stamps


@dataclass(frozen=True, eq=False)
class Recording:
    """Pairs, and the true transform."""

    name: str
    body: Body
    pairs: list[SkeletonPair]
    truth: RigidTransform
    start: Calibration


def recordings(
    body: Body, seeds: Iterable[int], seconds: float, angles: Sequence[float]
) -> Iterator[Recording]:
    """Simulated recordings of every movement; those without a usable start-up pose are left out."""
    for seed in seeds:
        for motion in MOTIONS:
            for angle in angles:
                a, b, truth = simulated_pair(
                    motion=motion, seed=seed, body=body, angle_deg=angle, seconds=seconds
                )
                frames = pair_recordings(list(a.frames()), list(b.frames()), PERSON, PERSON).pairs
                pairs = [frame.skeletons for frame in frames]
                try:
                    start = start_up_calibration(body, pairs)
                except CalibrationError:
                    continue
                yield Recording(f"{motion} {angle:g}° {seed}", body, pairs, truth.a_from_b, start)


def errors_of(recording: Recording, found: Calibration) -> tuple[float, float, float]:
    """(error of R in degrees, of t in millimetres, error of R over its stated standard deviation)."""
    turn = found.a_from_b.rotation @ recording.truth.rotation.T
    off = float(np.linalg.norm(Rotation.from_matrix(turn).as_rotvec()))
    shift = float(np.linalg.norm(found.a_from_b.translation - recording.truth.translation))
    sd = np.nan if found.registration is None else found.registration.rotation_sd
    return float(np.degrees(off)), 1e3 * shift, off / sd


def fitted(recording: Recording, refinement: RefinementSettings) -> Calibration:
    """The calibration of the whole recording, of its first span if a knock is reported."""
    settings = LearnerSettings(refinement=refinement, clock=False, bones=False)
    learned = learn_from_recording(recording.body, recording.pairs, None, recording.start, settings)
    return learned.spans[0].calibration


def print_fits(known: list[Recording], tried: dict[str, RefinementSettings]) -> None:
    """One line per choice: mean and largest errors, and the coverage of the stated deviation of R."""
    start = np.array([errors_of(one, one.start) for one in known])
    print(f"{'start-up pose':24} R {start[:, 0].mean():.2f}°, t {start[:, 1].mean():.0f} mm")
    for name, refinement in tried.items():
        found = np.array([errors_of(one, fitted(one, refinement)) for one in known])
        worse = float((found[:, 0] - start[:, 0]).max())
        print(
            f"{name:24} R {found[:, 0].mean():.2f}° (at most {worse:+.2f}° against the start), "
            f"t {found[:, 1].mean():.0f} mm, within 1 and 2 sd "
            f"{(found[:, 2] < 1).mean():.0%} and {(found[:, 2] < 2).mean():.0%}",
            flush=True,
        )


def knocked(recording: Recording) -> tuple[list[SkeletonPair], int]:
    """The recording with B knocked within 0.2 s, and when."""
    first, last = recording.pairs[0].time_ns, recording.pairs[-1].time_ns
    at_ns = first + round(KNOCK_AFTER * (last - first))
    turn = Rotation.from_matrix(KNOCK.rotation).as_rotvec()
    pairs = []
    for pair in recording.pairs:
        share = min(max((pair.time_ns - at_ns) / _MOVES_NS, 0.0), 1.0)
        if pair.b is not None and share > 0.0:
            now = RigidTransform.of(Rotation.from_rotvec(share * turn).as_matrix(), share * KNOCK.translation)
            b = Skeleton.of(pair.b.body, now.inverse().apply(pair.b.positions), pair.b.states, pair.b.time_ns)
            pair = replace(pair, b=b)
        pairs.append(pair)
    return pairs, at_ns


def knocks_of(recording: Recording, pairs: Sequence[SkeletonPair], knock: KnockSettings) -> list[int]:
    """Times at which a live session reports a knock."""
    learner = CalibrationLearner(
        recording.body, recording.start, LearnerSettings(knock=knock, bones=False, clock=False)
    )
    reported, before = [], SkeletonPair(None, None, -1)
    for pair in pairs:
        stale = (
            pair.a is not None and pair.a.repeats(before.a),
            pair.b is not None and pair.b.repeats(before.b),
        )
        changes = learner.observe(pair, (0, 0), stale, pair.skew_ns)
        reported += [change.time_ns for change in changes if change.kind == "knocked"]
        before = pair
    return reported


def print_knocks(known: list[Recording]) -> None:
    """One line per pair of thresholds."""
    for smallest in SMALLEST:
        for deviations in DEVIATIONS:
            settings = replace(KnockSettings(), smallest=smallest, deviations=deviations)
            noticed = false = 0
            for one in known:
                pairs, at_ns = knocked(one)
                noticed += any(0 <= t - at_ns <= _NOTICED_NS for t in knocks_of(one, pairs, settings))
                false += bool(knocks_of(one, one.pairs, settings))
            print(
                f"smallest {smallest * 1e3:.0f} mm, {deviations:g} deviations: noticed within 2 s in "
                f"{noticed} of {len(known)}, false alarms in {false}",
                flush=True,
            )


def print_clock(known: list[Recording]) -> None:
    """The error of the offset where B's time stamps are wrong by 12 ms, in stated deviations too."""
    errors, ratios = [], []
    for one in known:
        late = [
            pair if pair.b is None else replace(pair, skew_ns=pair.skew_ns - round(_LATE * 1e9))
            for pair in one.pairs
        ]
        both = [pair for pair in late if pair.a is not None and pair.b is not None]
        found = clock_offset_of(one.body, both, one.truth, [pair.skew_ns for pair in both])
        if found is not None:
            error = found.offset_ns * 1e-9 - _LATE
            errors.append(1e3 * error)
            ratios.append(abs(error) / (found.sd_ns * 1e-9))
    if not errors:
        print("no recording has enough motion")
        return
    print(
        f"{len(errors)} of {len(known)} recordings have enough motion: error {np.mean(errors):+.1f} ms, "
        f"RMS {np.sqrt(np.mean(np.square(errors))):.1f} ms; within 1 and 2 sd "
        f"{np.mean(np.array(ratios) < 1):.0%} and {np.mean(np.array(ratios) < 2):.0%}"
    )


def main(arguments: Sequence[str]) -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=("fit", "gain", "knock", "clock"))
    parser.add_argument("--body", choices=list(BODIES), default="azure_kinect")
    parser.add_argument("--seeds", type=int, nargs="+", default=[3000, 3001, 3002, 3003])
    parser.add_argument("--angles", type=float, nargs="+", default=[45.0, 90.0, 135.0])
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args(arguments)
    known = list(recordings(BODIES[options.body], options.seeds, options.seconds, options.angles))
    now, fit = RefinementSettings(), RobustFitSettings()
    if options.what == "fit":
        tried = {"present": now}
        tried |= {f"tempering {v:g}": replace(now, fit=replace(fit, tempering=v)) for v in TEMPERINGS}
        tried |= {f"bias_sd {v * 1e3:g} mm": replace(now, fit=replace(fit, bias_sd=v)) for v in BIASES}
        tried |= {f"inflation {v:g}": replace(now, fit=replace(fit, inflation=v)) for v in INFLATIONS}
        print_fits(known, tried)
    elif options.what == "gain":
        print_fits(known, {f"gain {v:g}": replace(now, gain=v) for v in GAINS})
    elif options.what == "knock":
        print_knocks(known)
    else:
        print_clock(known)


if __name__ == "__main__":
    main(sys.argv[1:])
