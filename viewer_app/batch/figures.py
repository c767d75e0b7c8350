"""The figures of one session in the summary. None of them needs a known truth."""

from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np

from fusion.errors import FusionError
from fusion.evaluation.without_truth import FiguresWithoutTruth, FusedPair, figures_without_truth
from fusion.rigid import RigidTransform
from recordings.session import Session
from viewer_app.report.figures import FusionResult

Figures = dict[str, float | int | str | None]


def session_figures(session: Session, result: FusionResult) -> Figures:
    """Computes the figures in SI units, by name; None where there is no such figure.

    Contains pairing and drops, the last calibration, bone errors, and the figures without truth
    that need one fusion (:class:`fusion.evaluation.without_truth.FiguresWithoutTruth`).
    """
    rows, pairing, calibration = session.rows, result.pairing, result.calibration
    registration = calibration.registration
    figures: Figures = {
        "frames": len(session),
        "seconds": float(rows.time_ns[-1] - rows.time_ns[0]) * 1e-9,
        "body": session.body.name,
        "frames_a": pairing.frames_a,
        "frames_b": pairing.frames_b,
        "dropped_a": pairing.dropped_a,
        "dropped_b": pairing.dropped_b,
        "alone_a": pairing.alone_a,
        "alone_b": pairing.alone_b,
        "stale_a": int(rows.stale_a.sum()),
        "stale_b": int(rows.stale_b.sum()),
        "without_person_a": int((rows.states_a == 0).all(axis=1).sum()),
        "without_person_b": int((rows.states_b == 0).all(axis=1).sum()),
        "without_fused": int(np.isnan(rows.fused).all(axis=(1, 2)).sum()),
        "calibration": calibration.how,
        "calibrations": len(session.calibrations),
        "residual_median": None if registration is None else _finite(registration.residual_median),
        "residual_rms": None if registration is None else _finite(registration.residual_rms),
        "rotation_sd": None if registration is None else _finite(registration.rotation_sd),
        "axes_angle": _finite(calibration.axes_angle),
        "bone_error": _largest(rows.bone_error),
        "fuse_seconds": float(rows.fuse_ms.sum()) * 1e-3,
    }
    return figures | _without_truth(session)


def _without_truth(session: Session) -> Figures:
    names = [*FiguresWithoutTruth.__dataclass_fields__, "roughness_ratio"]
    rows = session.rows
    pair = FusedPair(
        session.body,
        rows.time_ns,
        rows.positions_a.astype(np.float64),
        rows.positions_b.astype(np.float64),
        rows.fused,
        tuple(RigidTransform(R, t) for R, t in zip(rows.rotation, rows.translation, strict=True)),
    )
    try:
        found = figures_without_truth(pair)
    except FusionError:  # too short, or the views share hardly any joint
        return {name: None for name in names if name != "frames"}
    values = asdict(found) | {"roughness_ratio": found.roughness_ratio}
    return {name: _finite(float(values[name])) for name in names if name != "frames"}


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _largest(values: np.ndarray) -> float | None:
    finite = values[np.isfinite(values)]
    return float(finite.max()) if finite.size else None
