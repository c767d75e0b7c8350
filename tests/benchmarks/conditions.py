"""S* under conditions of real set-ups, on simulated Azure Kinects: ``python -m tests.benchmarks.conditions``.

The recordings are spoilt, written to .csv files and fused as ``duplex fuse`` does. The figures are written to
``results/conditions.json``.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv
from numpy.typing import NDArray

from devices.simulated.demonstration import demonstrated, demonstration
from devices.simulated.kinect import Scene, simulated_pair
from fusion.body import AZURE_KINECT
from fusion.pair_arrays import View, view_of
from recordings import fuse
from tests.benchmarks import results

_STATES = np.array(["not_tracked", "inferred", "tracked"])
_WARM_UP_NS = 4_000_000_000  # the start-up pose, which every method knows best
Spoil = Callable[[View, View, np.random.Generator], tuple[View, View]]


class Recorded(NamedTuple):
    """Both views of a simulated person, and the truth (T, J, 3) at times of A's clock in nanoseconds."""

    a: View
    b: View
    truth_at: Callable[[NDArray[np.int64]], NDArray[np.float64]]


def _later(view, ms, ppm=0.0):
    return view._replace(time_ns=np.rint(view.time_ns * (1.0 + 1e-6 * ppm)).astype(np.int64) + int(ms * 1e6))


def _kept(view, kept):
    return view.chosen(np.flatnonzero(kept))


def _seconds(view):
    return (view.time_ns - view.time_ns[0]) * 1e-9


CONDITIONS: dict[str, Spoil] = {
    "as it is": lambda a, b, random: (a, b),
    "B 33 ms off": lambda a, b, random: (a, _later(b, 33)),
    "B 100 ms off": lambda a, b, random: (a, _later(b, 100)),
    "B 300 ms off": lambda a, b, random: (a, _later(b, 300)),
    "B 2 s off": lambda a, b, random: (a, _later(b, 2000)),
    "B 7 s off": lambda a, b, random: (a, _later(b, -7000)),
    "B's clock 200 ppm fast": lambda a, b, random: (a, _later(b, 0, 200.0)),
    "B at 15 fps": lambda a, b, random: (a, _kept(b, np.arange(len(b.time_ns)) % 2 == 0)),
    "a fifth of all frames lost": lambda a, b, random: (
        _kept(a, random.random(len(a.time_ns)) > 0.2),
        _kept(b, random.random(len(b.time_ns)) > 0.2),
    ),
    "B gone for 5 s": lambda a, b, random: (a, _kept(b, (_seconds(b) < 5.0) | (_seconds(b) > 10.0))),
}


def recorded(motion, seed):
    """A movement before well placed sensors 90° apart, for 20 seconds."""
    a, b, truth = simulated_pair(motion=motion, seed=seed, body=AZURE_KINECT, angle_deg=90.0, seconds=20.0)
    return Recorded(_view(a), _view(b), truth.positions_at)


def badly_placed(seed):
    """``duplex demo --bad-setup``: the sensors too close, too high to see the feet, and side by side."""
    shown = demonstration(
        Scene(demonstrated("badminton"), AZURE_KINECT, seconds=14.0, seed=seed), bad_setup=True
    )
    return Recorded(_view(shown.a), _view(shown.b), shown.truth.positions_at)


def _view(sensor):
    return view_of(AZURE_KINECT, (person for frame in sensor.frames() for person in frame.people.values()))


def write_csv(path, view):
    """Writes a view as ``.csv``; joints that are not tracked have no row."""
    frame, joint = np.nonzero(np.isfinite(view.positions[..., 0]))
    x, y, z = view.positions[frame, joint].T
    columns = {"time_us": view.time_ns[frame] // 1000, "body": np.zeros(len(frame), np.int64)}
    columns |= {"joint": np.array(AZURE_KINECT.joints)[joint], "x": x, "y": y, "z": z}
    columns |= {"state": _STATES[view.states[frame, joint]]}
    pyarrow.csv.write_csv(pa.table(columns), path)


def fused(a, b):
    """The session of two views that were written to files."""
    with tempfile.TemporaryDirectory() as folder:
        paths = Path(folder) / "a.csv", Path(folder) / "b.csv"
        for path, view in zip(paths, (a, b), strict=True):
            write_csv(path, view)
        return fuse(*paths, force=True)


def errors(session, recording):
    """(T, J) metres from S_A, S_B and S* to the truth after the start-up pose, S_B under the registration."""
    rows = session.rows
    own = rows.clock_a[rows.clock_a > 0]
    times = rows.time_ns + int(own[0] - rows.time_ns[rows.clock_a > 0][0])
    truth, late = recording.truth_at(times), rows.time_ns > _WARM_UP_NS
    for positions in (rows.positions_a, rows.b_in_a, rows.fused):
        yield np.linalg.norm(positions - truth, axis=2)[late]


def of_condition(spoil, recordings, seed):
    """Mean error of S*, metres."""
    means = []
    for recording in recordings:
        a, b = spoil(recording.a, recording.b, np.random.default_rng(seed))
        session = fused(a, b)
        means.append(float(np.nanmean(list(errors(session, recording))[2])))
    return {"mpjpe": float(np.mean(means))}


def of_bad_setup(seed):
    """Mean errors in metres: of each view, and of S* on the joints that this view reports."""
    recording = badly_placed(seed)
    a, b, fused_at = errors(fused(recording.a, recording.b), recording)
    row = {}
    for name, view in (("a", a), ("b", b)):
        seen = np.isfinite(view) & np.isfinite(fused_at)
        row |= {name: float(view[seen].mean()), f"fused_where_{name}": float(fused_at[seen].mean())}
    return row


def main():
    """Runs all conditions and writes their figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motions", nargs="+", default=["walk", "arms", "squat"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[7800, 7801])
    parser.add_argument("--bad-setups", nargs="*", type=int, default=list(range(7810, 7820)))
    options = parser.parse_args()
    recordings = [recorded(motion, seed) for motion in options.motions for seed in options.seeds]
    rows = {}
    for name, spoil in CONDITIONS.items():
        row = rows[name] = of_condition(spoil, recordings, options.seeds[0])
        clean = rows["as it is"]["mpjpe"]
        print(
            f"{name:28s} {row['mpjpe'] * 1e3:6.1f} mm, {row['mpjpe'] / clean:.2f} of the clean one",
            flush=True,
        )
    bad = {}
    for seed in options.bad_setups:
        bad[str(seed)] = of_bad_setup(seed)
        print(f"bad set-up {seed}:", *(f"{name} {1e3 * v:.0f}" for name, v in bad[str(seed)].items()))
    results.write("conditions", {"conditions": rows, "bad_setups": bad})


if __name__ == "__main__":
    main()
