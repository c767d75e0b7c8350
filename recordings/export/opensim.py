"""Export of S* as an OpenSim motion, .mot: degrees and metres over seconds.

The columns are coordinates of the full-body model of Rajagopal et al. (2016), so that OpenSim shows the
motion on it. Hip angles are against the trunk, so the trunk is the model's pelvis, and its lumbar joint
stays straight. The pelvis turns about z, x and y (tilt, list, rotation). It is where the middle of the
model's hips is that of the hips of S*. Thighs and upper arms turn in it by the rotations of
:mod:`fusion.movement.joint_rotations`, so hip_rotation and arm_rot are those that a bent knee or elbow shows.
"""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fusion.body import Body
from fusion.movement.angles import ANGLES, joint_angles
from fusion.movement.joint_rotations import STRAIGHT, JointRotations
from fusion.support.types import Array
from recordings.appearance.floor import floor_under
from recordings.errors import RecordingError
from recordings.export.even_frames import EvenPositions
from recordings.export.markers import forward_up_right
from recordings.gait import SIDES
from recordings.session_series import SessionSeries

_HIPS = np.array([-0.056276, -0.07849, 0.0])  # metres, in the pelvis of the model as published
_AXES = Rotation.from_matrix([[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])
"""The model's axes (forward, up, to the right) of a person at rest to and from K_A's."""
_LIMBS = (
    ("knee", "knee_angle", "hip", ("hip_flexion", "hip_adduction", "hip_rotation"), 0.0),
    ("elbow", "elbow_flex", "shoulder", ("arm_flex", "arm_add", "arm_rot"), 5.0),
)
"""Last: degrees by which the model's forearm is less bent than elbow_flex, and aside of the plane of flexion:
its elbow has an inclined axis."""


def write_mot(session: SessionSeries, path: Path, rate: float | None = None) -> str:
    """Writes S* at an even rate, that of the recording if None, without rows in gaps of more than 0.25 s.

    OpenSim's ``Storage`` reads a file up to its first nan. Coordinates that need a joint that was never seen
    have no column.

    Raises:
        RecordingError: No frame has an S*.
    """
    body, even, pose = session.body, EvenPositions(session, rate), JointRotations(session.body)
    a_from_model = Rotation.from_matrix(floor_under(session.rows).rotation) * _AXES
    found, straight = [], []
    for part, positions, known in even.parts():
        places, times = positions[known], even.time_ns[part][known]
        # a joint that was never seen gives no angle, so its position does not matter
        each = zip(np.nan_to_num(places), times.tolist(), strict=True)
        turned = np.array([pose.update(*frame) for frame in each]).reshape(-1, len(body), 4)
        angles = dict(zip(ANGLES, joint_angles(body, places, session.up).T, strict=True))
        of_pelvis, pelvis_turned = pelvis(body, forward_up_right(session.rows, places))
        of_limbs = limbs(body, a_from_model * pelvis_turned, turned, angles)
        found.append({"time": 1e-9 * times} | of_pelvis | of_limbs)
        straight.append(
            [angles[f"{hinge}_flexion_{side}"] < STRAIGHT for hinge, *_ in _LIMBS for side in SIDES]
        )
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
    legs, arms = np.concatenate(straight, axis=1).reshape(2, -1).mean(axis=1)
    return (
        f"{even.in_words('are left out')}; hip_rotation and arm_rot are held where a limb bends by less than "
        f"{STRAIGHT:.0f}°: legs {legs:.0%}, arms {arms:.0%} of the time"
    )


def _without_gaps(values: Array) -> Array:
    """(N,) with interpolated values where none is finite, as an angle of a limb without length."""
    known = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(len(values)), known, values[known])


def pelvis(body: Body, positions: Array) -> tuple[dict[str, Array], Rotation]:
    """(T,) degrees and metres of the pelvis, by the coordinates' names, and its rotations.

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
    unknown = ~np.isfinite(axes).all(axis=(1, 2))
    axes[unknown] = np.eye(3)
    turned = Rotation.from_matrix(axes)
    degrees, place = turned.as_euler("ZXY", degrees=True), middle - turned.apply(_HIPS)
    degrees[unknown] = place[unknown] = np.nan
    names = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")
    return dict(zip(names, (*degrees.T, *place.T), strict=True)), turned


def limbs(body: Body, trunk: Rotation, rotations: Array, angles: dict[str, Array]) -> dict[str, Array]:
    """(T,) degrees of the coordinates of limbs, by their names; NaN where an angle that they need is.

    Args:
        trunk: (T,) K_A ← the model's pelvis.
        rotations: (T, J, 4) of bones, from rest, in K_A's frame.
        angles: (T,) degrees, of :data:`fusion.movement.angles.ANGLES`.
    """
    found: dict[str, Array] = {}
    for side, outwards in zip(SIDES, (-1.0, 1.0), strict=True):
        for hinge, flexion, above, names, inclined in _LIMBS:
            turned = trunk.inv() * Rotation.from_quat(rotations[:, body.joint(f"{hinge} {side}")]) * _AXES
            euler = turned.as_euler("ZXY", degrees=True, suppress_warnings=True) * [1.0, outwards, outwards]
            bent, known = angles[f"{hinge}_flexion_{side}"], 0.0 * angles[f"{above}_flexion_{side}"]
            euler += np.stack([known, known, known + 0.0 * bent - inclined], axis=1)
            columns = dict(zip(names, euler.T, strict=True)) | {flexion: bent + inclined}
            found |= {f"{name}_{side[0]}": values for name, values in columns.items()}
    return found
