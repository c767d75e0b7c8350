"""The figures of one session in the summary. None of them needs a known truth."""

from __future__ import annotations

import numpy as np

from recordings.session import Session
from viewer_app.report.figures import Figures


def session_figures(session: Session, figures: Figures) -> Figures:
    """The figures in SI units, by name; None where there is no such figure.

    Args:
        session: The session.
        figures: Its report, with ``without_truth`` of :func:`viewer_app.report.figures.truth_free_figures`.
    """
    rows, registration = session.rows, session.calibration.registration
    error, apart = figures["bone_error_mm"]["fused"]["max"], figures["views_agree_mm"]["median"]
    return {
        "frames": len(session),
        "seconds": figures["seconds"],
        "body": session.body.name,
        **{
            f"{name}_{side}": figures[name][side]
            for name in ("frames", "dropped", "alone", "stale", "without_person")
            for side in "ab"
        },
        "without_fused": int(np.isnan(rows.fused).all(axis=(1, 2)).sum()),
        "calibration": session.calibration.how,
        "calibrations": len(session.calibrations),
        "verdict": figures["verdict"]["word"],
        "views_agree": None if apart is None else apart * 1e-3,
        "rotation_sd": None if registration is None else registration.rotation_sd,
        "axes_angle": session.calibration.axes_angle,
        "bone_error": None if error is None else error * 1e-3,
        "fuse_seconds": float(rows.fuse_ms.sum()) * 1e-3,
        **figures["without_truth"],
    }
