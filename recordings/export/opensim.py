"""Export of the angles of S* as an OpenSim motion, .mot: degrees over seconds.

The columns are coordinates of the full-body model of Rajagopal et al. (2016), so that OpenSim shows the
motion on it. Hip angles are against the trunk, so the trunk's inclination is that of the model's pelvis, and
its lumbar joint stays straight.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recordings.gait import SIDES
from recordings.series import AngleSeries
from recordings.session_series import SessionSeries


def write_mot(session: SessionSeries, path: Path) -> str:
    """Writes one row per frame at the times they were recorded; nan where an angle is unknown.

    Angles that need a joint that was never seen have no column.
    """
    found = coordinates(session.angles)
    columns = {name: values for name, values in found.items() if np.isfinite(values).any()}
    header = [session.name.removesuffix(".rrd"), "version=1", f"nRows={len(session)}"]
    header += [f"nColumns={len(columns) + 1}", "inDegrees=yes", "endheader", "\t".join(["time", *columns])]
    rows = np.stack([session.time_ns * 1e-9, *columns.values()], axis=1)
    lines = ("\t".join([f"{row[0]:.6f}", *(f"{v:.4f}" for v in row[1:])]) for row in rows)
    path.write_text("\n".join([*header, *lines]) + "\n", encoding="utf-8")
    return f"{len(session)} frames at the times they were recorded"


def coordinates(angles: AngleSeries) -> dict[str, NDArray[np.float64]]:
    """(T,) degrees of each coordinate of the model, by its name."""
    found = {"pelvis_tilt": -angles["trunk_flexion"], "pelvis_list": angles["trunk_lean"]}
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
