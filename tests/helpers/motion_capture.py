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


def write_c3d_of(processor, scale, path, labels, times, points):
    """As :func:`write_c3d`, byte by byte: 84 Intel, 85 DEC, 86 MIPS; floats where the scale is negative."""
    order, (N, M) = ">" if processor == 86 else "<", points.shape[:2]

    def floats(values):
        raw = np.asarray(values, dtype="<f4" if processor == 85 else f"{order}f4")
        if processor != 85:
            return raw.tobytes()
        return (4 * raw).view("<u2").reshape(-1, 2)[:, ::-1].tobytes()

    def words(*values):
        return np.array(values, dtype=f"{order}i2").tobytes()

    width = max(map(len, labels))
    text = bytes([255, 2, width, M]) + b"".join(label.ljust(width).encode() for label in labels) + b"\0"
    records = b"\5\xffPOINT" + words(3) + b"\0" + b"\6\1LABELS" + words(2 + len(text)) + text + b"\0\0"
    blocks = -(-(4 + len(records)) // 512)
    head = b"\2\x50" + words(M, 0, 1, N, 0) + floats([scale]) + words(2 + blocks, 0)
    head += floats([1.0 / (times[1] - times[0])])
    parameters = bytes([1, 0x50, blocks, processor]) + records
    gap = np.isnan(points).any(axis=2, keepdims=True)
    at = np.concatenate([np.where(gap, 0.0, points), np.where(gap, -1.0, 0.0)], axis=2)
    if scale < 0.0:
        data = floats(at.ravel())
    else:
        at[..., :3] = np.rint(at[..., :3] / scale)
        data = words(*at.ravel())
    path.write_bytes(head.ljust(512, b"\0") + parameters.ljust(512 * blocks, b"\0") + data)
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


def write_motive(path, labels, times, points):
    """Of OptiTrack Motive: bones with rotations and (N, M, 3) positions, and markers."""
    count = len(labels)
    heads = [
        ["Format Version", "1.23", "Take Name", "walk", "Length Units", "Millimeters"],
        [],
        ["", "Type", *["Bone"] * 7 * count, *["Marker"] * 3],
        ["", "Name", *(name for label in labels for name in [label] * 7), *["Unlabeled"] * 3],
        ["", "ID", *["1"] * (7 * count + 3)],
        ["", "", *(["Rotation"] * 4 + ["Position"] * 3) * count, *["Position"] * 3],
        ["Frame", "Time (Seconds)", *"XYZWXYZ" * count, *"XYZ"],
    ]
    rows = [
        [k, f"{t:.6f}", *(cell for at in frame for cell in (*[0.5] * 4, *_cells(at))), 1, 2, 3]
        for k, (t, frame) in enumerate(zip(times, points, strict=True))
    ]
    return _write(path, ",", [*heads, *rows])


def write_nexus(path, labels, times, points):
    """Of Vicon Nexus: a section of devices, and one of (N, M, 3) trajectories."""
    rate = round(1.0 / (times[1] - times[0]))
    heads = [
        ["Devices"], [1000], ["", "", "Force"], ["Frame", "Sub Frame", "Fx"], ["", "", "N"], [1, 0, 5.0], [],
        ["Trajectories"], [rate], ["", "", *(cell for label in labels for cell in (label, "", ""))],
        ["Frame", "Sub Frame", *"XYZ" * len(labels)], ["", "", *["mm"] * 3 * len(labels)],
    ]  # fmt: skip
    rows = [[k + 40, 0, *(cell for at in frame for cell in _cells(at))] for k, frame in enumerate(points)]
    return _write(path, ",", [*heads, *rows])


def write_qualisys(path, labels, times, points):
    """Of Qualisys Track Manager: (N, M, 3) points after a head; missing ones are zeros."""
    heads = [
        ["NO_OF_FRAMES", len(times)], ["NO_OF_MARKERS", len(labels)],
        ["FREQUENCY", round(1.0 / (times[1] - times[0]))], ["DATA_INCLUDED", "3D"], ["MARKER_NAMES", *labels],
    ]  # fmt: skip
    rows = [[f"{value:.4f}" for value in np.nan_to_num(frame).ravel()] for frame in points]
    return _write(path, "\t", [*heads, *rows])


def _cells(at):
    return ["" if np.isnan(value) else f"{value:.4f}" for value in at]


def _write(path, separator, rows):
    path.write_text("\n".join(separator.join(map(str, row)) for row in rows) + "\n", encoding="utf-8")
    return path
