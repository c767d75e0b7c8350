"""Export to TRC, OpenSim's marker file: millimetres, y up, one time per frame, empty cells for gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recordings.export.even_frames import even_frames, y_up
from recordings.session import Session


def write_trc(session: Session, path: Path) -> str:
    """Writes S* as markers named after the joints. Times are as recorded; the header has the mean rate.

    Returns:
        A description of what was written.
    """
    rows = session.rows
    joints, rate = rows.body.joints, f"{even_frames(rows).rate:.6g}"
    T, J = len(rows), len(joints)
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{session.name.removesuffix('.rrd')}.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{T}\t{J}\tmm\t{rate}\t1\t{T}",
        "Frame#\tTime\t" + "\t\t\t".join(joints) + "\t\t",
        "\t\t" + "\t".join(f"X{j}\tY{j}\tZ{j}" for j in range(1, J + 1)),
        "",
    ]
    millimetres = y_up(rows.fused).reshape(T, -1) * 1e3
    for t, (time_ns, values) in enumerate(zip(rows.time_ns.tolist(), millimetres, strict=True)):
        cells = ("" if np.isnan(v) else f"{v:.4f}" for v in values)
        lines.append(f"{t + 1}\t{time_ns * 1e-9:.6f}\t" + "\t".join(cells))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return f"{T} frames at the times they were recorded, {rate} Hz on average"
