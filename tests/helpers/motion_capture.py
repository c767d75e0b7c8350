"""Motion capture files by writers that are not this program's: ezc3d, and OpenSim's text format by hand."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from devices.simulated.kinect import simulated_pair
from fusion.calibration.calibration import calibrate
from fusion.calibration.start_up_pose import find_start_up_pose
from fusion.rigid import RigidTransform
from recordings.session import Session
from tests.helpers.frame_pairs import paired
from tests.helpers.fused_runs import record_fused

LAB_FROM_A = RigidTransform.of(
    Rotation.from_euler("xyz", [100.0, 20.0, 30.0], True).as_matrix(), [1, -2, 0.7]
)
"""A laboratory's frame, in metres."""


@dataclass(frozen=True)
class Captured:
    """A simulated session with the true positions of its joints at any time."""

    session: Session
    positions_at: object  # of (N,) seconds since the first pair: (N, J, 3) metres in K_A's frame

    def truth(self, offset_s, seconds, rate=100.0, missing=0.0, unit=1000.0):
        """(N,) times from 0 and (N, J, 3) points in the laboratory's frame; points are missing at random."""
        times = np.arange(int(seconds * rate)) / rate
        points = unit * LAB_FROM_A.apply(self.positions_at(times + offset_s))
        points[np.random.default_rng(1).random(points.shape[:2]) < missing] = np.nan
        return times, points


def true_positions(body, motion):
    """A function from (N,) seconds to (N, J, 3) joints of a simulated person, in K_A's frame."""
    truth = simulated_pair(motion=motion, body=body)[2]
    return lambda times: truth.positions_at(np.rint(1e9 * np.asarray(times)).astype(np.int64))


def captured(path, body, motion, seconds, seed):
    """Simulates and fuses a recording of two sensors at 90°."""
    a, b, truth = simulated_pair(motion=motion, angle_deg=90.0, seed=seed, seconds=seconds, body=body)
    pairs = paired(list(a.frames()), list(b.frames())).pairs
    calibration = calibrate(body, *find_start_up_pose(body, [pair.skeletons for pair in pairs]))
    start_ns = pairs[0].time_ns
    return Captured(
        record_fused(path, pairs, calibration),
        lambda times: truth.positions_at(start_ns + np.rint(1e9 * times).astype(np.int64)),
    )


def write_c3d(path, labels, times, points):
    """Writes (N, M, 3) points in millimetres at an even rate."""
    import ezc3d

    N, M = points.shape[:2]
    file = ezc3d.c3d()
    parameters = file["parameters"]["POINT"]
    parameters["UNITS"]["value"] = ["mm"]
    parameters["RATE"]["value"] = [1.0 / (times[1] - times[0])]
    parameters["LABELS"]["value"] = list(labels)
    file["data"]["points"] = np.concatenate([points.transpose(2, 1, 0), np.ones((1, M, N))])
    file["data"]["analogs"] = np.zeros((1, 0, N))
    file.write(str(path))
    return path


def write_trc(path, labels, times, points):
    """Writes (N, M, 3) points; a gap is three empty cells."""
    N, M = points.shape[:2]
    rate = f"{1.0 / (times[1] - times[0]):g}"
    names = "\t".join(f"{label}\t\t" for label in labels)
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{N}\t{M}\tm\t{rate}\t1\t{N}",
        f"Frame#\tTime\t{names}",
        "\t\t" + "\t".join(f"X{m}\tY{m}\tZ{m}" for m in range(1, M + 1)),
        "",
    ]
    for n, (time, row) in enumerate(zip(times, points.reshape(N, -1), strict=True), start=1):
        cells = ("" if np.isnan(value) else f"{value:.6f}" for value in row)
        lines.append(f"{n}\t{time:.5f}\t" + "\t".join(cells))
    path.write_text("\n".join(lines) + "\n")
    return path
