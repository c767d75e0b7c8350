"""Time per frame of the method, and of the commands around it: ``python -m tests.benchmarks.speed``.

The figures are written to ``results/speed.json``. Times of the method are processor time of one thread, in
which other processes do not count. With ``--start``, only what commands cost whose kernels are on disk is
measured, on any machine, and is written to ``results/start.json``.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from devices.simulated.kinect import simulated_pair
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.calibration.calibration import calibrate
from fusion.calibration.start_up_pose import find_start_up_pose
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup
from recordings.session import Session
from tests.benchmarks import results
from tests.helpers.frame_pairs import paired
from tests.helpers.recorded_pairs import write_view

FRAME_NS = 33_333_333
FRAMES_PER_MINUTE = 1800
SHORT, LONG = 600, 6600
"""Pairs of two recordings whose difference is the cost of their pairs without the start-up."""
IMPORTS = "import numpy, scipy.linalg, numba, rerun"


def simulated_walk(body, seconds=20.0):
    """Returns the pairs of a walk in front of two simulated sensors."""
    a, b, _ = simulated_pair(motion="walk", seed=0, body=body, angle_deg=90.0, seconds=seconds, depth="none")
    pairs = paired(a.frames(), b.frames()).pairs
    return [pair.skeletons for pair in pairs]


def repeated(pairs, count):
    """Repeats a recording forwards and backwards in turn, so that it has no jumps."""
    there_and_back = [*pairs, *pairs[::-1]]
    return [
        replace(there_and_back[k % len(there_and_back)], time_ns=k * FRAME_NS) for k in range(count)
    ]  # fmt: skip


def time_update(pairs, body, method):
    """Times ``Fuser.update`` pair by pair, and ``fuse_sequence`` over many pairs."""
    setup = FusionSetup(calibrate(body, *find_start_up_pose(body, pairs)), FuserSettings(method=method))
    fuser = Fuser(setup)
    fuser.warm_up()
    took = []
    for pair in pairs:
        before = time.thread_time_ns()
        fuser.update(pair)
        took.append((time.thread_time_ns() - before) * 1e-3)
    many = repeated(pairs, 6000)
    before = time.thread_time_ns()
    Fuser(setup).fuse_sequence(many)
    per_second = len(many) / (time.thread_time_ns() - before) * 1e9
    median, p99 = np.percentile(took, [50, 99])
    return {"median_us": float(median), "p99_us": float(p99), "batch_per_s": per_second}


def time_commands(body, pairs):
    """Times ``duplex fuse --save`` and ``duplex replay --verify`` on a short and on a long recording."""
    # noise, so that repeated frames do not compress better than a real recording
    rng = np.random.default_rng(0)
    known = [pair for pair in pairs if pair.a is not None and pair.b is not None]
    many = repeated(known, LONG)
    fusing, replaying = [], []
    with tempfile.TemporaryDirectory(prefix="duplex-benchmark-") as name:
        folder = Path(name)
        session = folder / "session.rrd"
        for count in (10, SHORT, LONG):  # the first fills the caches
            files = _written(folder, body, many[:count], rng)
            fusing.append(
                _seconds_of(["fuse", *files, "--save", str(session), "--no-viewer", "--force",
                             "--calibrate", "seconds:3"])
            )  # fmt: skip
            replaying.append(_seconds_of(["replay", str(session), "--verify"]))
        before = time.perf_counter()
        Session.open(session)
        opening = time.perf_counter() - before
    pair_s = (fusing[2] - fusing[1]) / (LONG - SHORT)
    return {
        "fuse_pairs_per_s": 1.0 / pair_s,
        "fuse_start_up_s": fusing[1] - SHORT * pair_s,
        "replay_pairs_per_s": (LONG - SHORT) / (replaying[2] - replaying[1]),
        "open_hour_s": opening / LONG * FRAMES_PER_MINUTE * 60,
    }


def _written(folder, body, pairs, rng):
    """Writes both views of a recording, with 1 mm of noise; returns their names."""
    files = []
    for side in "ab":
        positions = np.array([getattr(pair, side).positions for pair in pairs], np.float64)
        positions += rng.normal(0.0, 1e-3, positions.shape)
        files.append(str(write_view(folder / f"{side}.csv", body, positions)))
    return files


def cost_of_commands(body, rounds=5):
    """Processor seconds of whole commands on 28 s, and over those of importing what fusion needs, in turn."""
    known = [pair for pair in simulated_walk(body, 28.0) if pair.a is not None and pair.b is not None]
    with tempfile.TemporaryDirectory(prefix="duplex-benchmark-") as name:
        folder = Path(name)
        session = str(folder / "session.rrd")
        fuse = ["fuse", *_written(folder, body, known, np.random.default_rng(0)), "--no-viewer", "--force"]
        commands = {
            IMPORTS: ["-c", IMPORTS],
            "fuse --save": [*fuse, "--save", session],
            "export .csv": ["export", session, "--to", str(folder / "s.csv"), "--force"],
            "export .bvh": ["export", session, "--to", str(folder / "s.bvh"), "--force"],
            "trim": ["trim", session, "--to", "20", "--save", str(folder / "part.rrd"), "--force"],
            "review --html": ["review", session, "--html", str(folder / "s.html"), "--force", "--no-viewer"],
            "info": ["info", session],
            "--help": ["--help"],
        }
        took = {name: [] for name in commands}
        for _ in range(1 + rounds):  # the first fills the caches
            for name, arguments in commands.items():
                before = os.times()
                program = [] if name == IMPORTS else ["-m", "viewer_app.cli"]
                subprocess.run([sys.executable, *program, *arguments], check=True, capture_output=True)
                after = os.times()
                took[name].append(sum(after[2:4]) - sum(before[2:4]))
    median = {name: float(np.median(each[1:])) for name, each in took.items()}
    return {name: {"cpu_s": cpu_s, "of_imports": cpu_s / median[IMPORTS]} for name, cpu_s in median.items()}


def _seconds_of(arguments):
    before = time.perf_counter()
    subprocess.run([sys.executable, "-m", "viewer_app.cli", *arguments], check=True, capture_output=True)
    return time.perf_counter() - before


def main(arguments=None):
    """Times the method and the commands."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--start", action="store_true", help="only the processor time of commands")
    if parser.parse_args(arguments).start:
        results.write("start", cost_of_commands(KINECT_V2))
        return
    figures = {"update": {}}
    for body, methods in ((KINECT_V2, ("duplex", "paper")), (AZURE_KINECT, ("duplex",))):
        walk = simulated_walk(body)
        figures["update"][body.name] = {method: time_update(walk, body, method) for method in methods}
    figures["commands"] = time_commands(KINECT_V2, simulated_walk(KINECT_V2))
    results.write("speed", figures)


if __name__ == "__main__":
    main()
