"""Export of S* as an OpenSim motion, .mot: degrees and metres over seconds.

The columns are coordinates of the full-body model of Rajagopal et al. (2016), so that OpenSim shows the
motion on it. Hip angles are against the trunk, so the trunk is the model's pelvis, and its lumbar joint
stays straight. The pelvis turns about z, x and y (tilt, list, rotation). It is where the middle of the
model's hips is that of the hips of S*.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fusion.body import Body
from fusion.movement.angles import ANGLES, joint_angles
from fusion.support.types import Array
from recordings.errors import RecordingError
from recordings.export.even_frames import EvenPositions
from recordings.export.markers import forward_up_right
from recordings.gait import SIDES
from recordings.session_series import SessionSeries

_HIPS = np.array([-0.056276, -0.07849, 0.0])  # metres, in the pelvis of the model as published


def write_mot(session: SessionSeries, path: Path, rate: float | None = None) -> str:
    """Writes S* at an even rate, that of the recording if None, without rows in gaps of more than 0.25 s.

    OpenSim's ``Storage`` reads a file up to its first nan. Coordinates that need a joint that was never seen
    have no column.

    Raises:
        RecordingError: No frame has an S*.
    """
    even, found = EvenPositions(session, rate), []
    for part, positions, known in even.parts():
        places, times = positions[known], even.time_ns[part][known]
        angles = joint_angles(session.body, places, session.up)
        of_pelvis = pelvis(session.body, forward_up_right(session.rows, places))
        of_limbs = coordinates(dict(zip(ANGLES, angles.T, strict=True)))
        found.append({"time": 1e-9 * times} | of_pelvis | of_limbs)
    columns = {name: np.concatenate([each[name] for each in found]) for name in found[0]}
    if not len(columns["time"]):
        raise RecordingError(f"{session} has no S* at an even rate; there is nothing to export.")
    for name in ("pelvis_tilt", "pelvis_list", "pelvis_rotation"):
        columns[name] = np.unwrap(columns[name], period=360.0)
    columns = {name: _without_gaps(values) for name, values in columns.items() if np.isfinite(values).any()}
    rows = np.stack(list(columns.values()), axis=1)
    header = [session.name.removesuffix(".rrd"), "version=1", f"nRows={len(rows)}"]
    header += [f"nColumns={len(columns)}", "inDegrees=yes", "endheader", "\t".join(columns)]
    lines = ("\t".join(f"{v:.6f}" for v in row) for row in rows.tolist())
    path.write_text("\n".join([*header, *lines]) + "\n", encoding="utf-8")
    return even.in_words("are left out")


def _without_gaps(values: Array) -> Array:
    """(N,) with interpolated values where none is finite, as an angle of a limb without length."""
    known = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(len(values)), known, values[known])


def pelvis(body: Body, positions: Array) -> dict[str, Array]:
    """(T,) degrees and metres of the pelvis, by the coordinates' names.

    Args:
        positions: (T, J, 3) metres; x forward, y up, z to the right of a person who faces +x.
    """
    hips, shoulders = (
        [positions[:, body.joint(f"{name} {side}")] for side in SIDES] for name in ("hip", "shoulder")
    )
    middle = 0.5 * (hips[0] + hips[1])
    up = 0.5 * (shoulders[0] + shoulders[1]) - middle
    forward = np.cross(up, hips[1] - hips[0] + shoulders[1] - shoulders[0])
    axes = np.stack([forward, up, np.cross(forward, up)], axis=2)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    degrees, place = np.full((2, *middle.shape), np.nan)
    if len(known := np.flatnonzero(np.isfinite(axes).all(axis=(1, 2)))):
        turned = Rotation.from_matrix(axes[known])
        degrees[known] = turned.as_euler("ZXY", degrees=True)
        place[known] = middle[known] - turned.apply(_HIPS)
    names = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")
    return dict(zip(names, (*degrees.T, *place.T), strict=True))


def coordinates(angles: Mapping[str, Array]) -> dict[str, Array]:
    """(T,) degrees of the coordinates of limbs, by their names."""
    found: dict[str, Array] = {}
    for side in SIDES:
        flexion, abduction = (np.radians(angles[f"shoulder_{of}_{side}"]) for of in ("flexion", "abduction"))
        elevation = np.hypot(flexion, abduction)
        share = np.sinc(elevation / np.pi)  # sine of the elevation over the elevation
        found |= {
            f"hip_flexion_{side[0]}": angles[f"hip_flexion_{side}"],
            f"hip_adduction_{side[0]}": -angles[f"hip_abduction_{side}"],
            f"knee_angle_{side[0]}": angles[f"knee_flexion_{side}"],
            f"arm_flex_{side[0]}": np.degrees(np.arctan2(share * flexion, np.cos(elevation))),
            f"arm_add_{side[0]}": -np.degrees(np.arcsin(np.clip(share * abduction, -1.0, 1.0))),
            f"elbow_flex_{side[0]}": angles[f"elbow_flexion_{side}"],
        }
    return found
