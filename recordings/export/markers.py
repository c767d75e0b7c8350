"""Export to marker files of biomechanics: C3D and OpenSim's TRC, in millimetres above the floor.

Both have an even rate. C3D has z up, and residual -1 for a gap. TRC has y up, and nan for gaps of more than
0.25 s: OpenSim refuses a row that ends in empty cells. As in its models, a person who faces the first sensor
faces +x. A joint that was never seen is a gap in both.
"""

import errno
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recordings.appearance.floor import floor_under
from recordings.data.interpolation import positions_at
from recordings.data.session_arrays import SessionArrays
from recordings.errors import RecordingError
from recordings.export.bones import lasting
from recordings.export.even_frames import EvenPositions, even_moments, with_fused
from recordings.session_series import SessionSeries

# Vendors count further in parameters of their own; ezc3d and all that is built on it read none of those
_MOST_FRAMES = 65_535


def write_c3d(session: SessionSeries, path: Path, rate: float | None = None) -> str:
    """Writes S* as points labelled with the joint names: x right, y forward, z up, as seen from K_A.

    The origin lies on the floor, below K_A. Strikes and toe-offs are events, seconds after the first frame.

    Raises:
        RecordingError: No frame has an S*, or the session is too long for the format.
        OSError: The file could not be written completely.
    """
    import ezc3d

    even = even_moments(with_fused(session), rate)
    if len(even.time_ns) > _MOST_FRAMES:
        raise RecordingError(
            f"A .c3d holds {_MOST_FRAMES} frames, {_MOST_FRAMES / even.rate / 60:.0f} min at "
            f"{even.rate:.6g} Hz; {session} has {len(even.time_ns)}. Export it in parts made with "
            "`duplex trim`, or as .trc."
        )
    floor_from_a = floor_under(session.rows).inverse()
    at = lasting(session)(positions_at(session.rows, even.time_ns))
    positions = floor_from_a.apply(at) * 1e3  # (N, J, 3)
    positions[:, session.rows.never_seen] = np.nan
    N, J = positions.shape[:2]
    points = np.full((4, J, N), np.nan)
    points[:3] = (positions[..., [0, 2, 1]] * [1.0, 1.0, -1.0]).transpose(2, 1, 0)
    gap = np.isnan(points[0])
    points[3] = 1.0
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["RATE"]["value"] = [even.rate]
    file["parameters"]["POINT"]["LABELS"]["value"] = list(session.body.joints)
    file.add_parameter("POINT", "X_SCREEN", ["+X"])
    file.add_parameter("POINT", "Y_SCREEN", ["+Z"])
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = np.where(gap, -1.0, 0.0)[None]
    file["data"]["meta_points"]["camera_masks"] = np.zeros((7, J, N), dtype=bool)
    file["data"]["analogs"] = np.zeros((1, 0, N))
    for seconds, name in session.gait.events:
        label, icon = ("Foot Strike", 1) if "strike" in name else ("Foot Off", 2)
        side = name.rpartition("_")[2].title()
        file.add_event((int(seconds // 60.0), seconds % 60.0), side, label, icon_id=icon)
    file.write(str(path))
    with path.open("rb") as written:  # ezc3d does not notice a full disk
        begin = 512 * (int.from_bytes(written.read(18)[16:], "little") - 1)
    if path.stat().st_size < begin + points.astype(np.float32).nbytes:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    return even.in_words


def write_trc(session: SessionSeries, path: Path, rate: float | None = None) -> str:
    """Writes S* as markers named after the joints, at an even rate, that of the recording if None.

    Raises:
        RecordingError: No frame has an S*.
    """
    even, joints = EvenPositions(session, rate), session.body.joints
    T, J, stated = len(even.time_ns), len(joints), f"{even.rate:.6g}"
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{session.name.removesuffix('.rrd')}.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{stated}\t{stated}\t{T}\t{J}\tmm\t{stated}\t1\t{T}",
        "Frame#\tTime\t" + "\t\t\t".join(joints) + "\t\t",
        "\t\t" + "\t".join(f"X{j}\tY{j}\tZ{j}" for j in range(1, J + 1)),
        "",
    ]
    with path.open("w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")
        for part, positions, _ in even.parts():
            millimetres = 1e3 * forward_up_right(session.rows, positions).reshape(len(positions), -1)
            rows = zip(even.time_ns[part].tolist(), millimetres.tolist(), strict=True)
            for number, (time_ns, values) in enumerate(rows, start=part.start + 1):
                cells = "\t".join(f"{v:.4f}" for v in values)
                file.write(f"{number}\t{time_ns * 1e-9:.6f}\t{cells}\n")
    return even.in_words("are nan")


def forward_up_right(rows: SessionArrays, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, 3) metres above the floor in OpenSim's axes from K_A's: x towards the first sensor, y up, z to the
    right of a person who faces it."""
    return np.asarray(-floor_under(rows).inverse().apply(positions)[..., [2, 1, 0]])
