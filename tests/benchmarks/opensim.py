"""Joint angles of S* and of the truth through OpenSim: ``python -m tests.benchmarks.opensim MODEL``.

S* and the truth of simulated recordings are exported for OpenSim, whose Scale and Inverse Kinematics fit the
full-body model of Pose2Sim to each. The figures are written to ``results/opensim.json``.
"""

import argparse
import shutil
from contextlib import chdir
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fusion.body import BODIES
from recordings.export.opensim_setup import MODEL
from tests.benchmarks import results
from tests.helpers.motion_capture import captured

MOTIONS = ("walk", "squat", "sit", "arms", "turn", "boxing", "badminton")
COORDINATES = ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "elbow_flex", "pelvis_tilt")
_BEGINS_S = 3.0  # with the start-up pose


def by_opensim(session, model, folder):
    """(T,) seconds, (T,) degrees by coordinate, and the median residual in metres."""
    import opensim

    opensim.Logger.setLevelString("Off")
    session.export(folder)
    shutil.copy(model, folder / MODEL)
    with chdir(folder):
        opensim.ScaleTool("scale.xml").run()
        opensim.InverseKinematicsTool("inverse_kinematics.xml").run()
        found, errors = map(opensim.TimeSeriesTable, ("inverse_kinematics.mot", "fused_ik_marker_errors.sto"))
    columns = {name: found.getDependentColumn(name).to_numpy() for name in found.getColumnLabels()}
    residual = np.median(errors.getDependentColumn("marker_error_RMS").to_numpy())
    return np.array(found.getIndependentColumn()), columns, float(residual)


def errors_of(body, motion, seed, seconds, model):
    """(N,) degrees of each coordinate of both sides off the truth, and the residual of S*."""
    with TemporaryDirectory() as folder:
        recorded = captured(Path(folder) / "s.rrd", body, motion, seconds, seed)
        session, at = recorded.session, recorded.positions_at(recorded.session.time)
        truth = replace(session, rows=replace(session.rows, fused=at.astype(session.fused.dtype)))
        times, found, residual = by_opensim(session, model, Path(folder) / "found")
        true_times, true, _ = by_opensim(truth, model, Path(folder) / "true")
    later = times > _BEGINS_S
    off = {}
    for coordinate in COORDINATES:
        names = [name for name in true if name in (coordinate, f"{coordinate}_l", f"{coordinate}_r")]
        each = [found[name] - np.interp(times, true_times, true[name]) for name in names]
        off[coordinate] = np.concatenate([(of[later] + 180.0) % 360.0 - 180.0 for of in each])
    return off, residual


def main():
    """Measures all movements and writes their figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path, help=f"{MODEL}, of the package pose2sim")
    parser.add_argument("--body", choices=BODIES, default="azure_kinect")
    parser.add_argument("--motions", nargs="+", choices=MOTIONS, default=MOTIONS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[7900, 7901])
    parser.add_argument("--seconds", type=float, default=16.0)
    options = parser.parse_args()
    model, figures = options.model.resolve(), {}
    for motion in options.motions:
        runs = [
            errors_of(BODIES[options.body], motion, seed, options.seconds, model) for seed in options.seeds
        ]
        rmse = {
            name: float(np.sqrt(np.mean([np.mean(off[name] ** 2) for off, _ in runs])))
            for name in COORDINATES
        }
        figures[motion] = {"rmse_deg": rmse, "residual_m": float(np.mean([each for _, each in runs]))}
        print(motion, {name: round(value, 1) for name, value in rmse.items()}, flush=True)
    results.write("opensim", figures)


if __name__ == "__main__":
    main()
