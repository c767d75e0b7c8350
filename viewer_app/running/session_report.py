"""The figures of a live session with real or simulated sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from devices.capture.sensor_pair import TwoSensors
from fusion.setup import FusionSetup
from recordings.session import Session
from recordings.session_arrays import SessionArrays, SessionFrame
from viewer_app.outputs.output import LiveOutput
from viewer_app.report.figures import Figures, fusion_figures, with_verdict


def rows_of(setup: FusionSetup, frames: Sequence[SessionFrame]) -> SessionArrays | None:
    """The frames, each with the bone lengths that it was fused with; None if there are none."""
    if not frames:
        return None
    fixed = setup.calibration.bone_lengths
    lengths = np.array([fixed if frame.bone_lengths is None else frame.bone_lengths for frame in frames])
    return SessionArrays.stack(setup.body, lengths, frames)


def session_report(
    setup: FusionSetup,
    frames: Sequence[SessionFrame],
    sensors: TwoSensors,
    outputs: Sequence[LiveOutput] = (),
    session: Session | None = None,
) -> Figures:
    """The report of a live session: the figures of ``duplex fuse --report`` and the stream counts.

    Frames are counted since the start. All other figures cover the whole session where it is given, as
    in ``duplex review``, else the frames; ``seconds`` is their length. Without a fused frame there are only
    counts.
    """
    figures = stream_figures(sensors)
    if outputs:
        figures["outputs"] = [output.figures() for output in outputs]
    figures["latency_ms"] = latency_figures(frames)
    rows = rows_of(setup, frames) if session is None else session.rows
    if rows is None:
        return figures
    setup = setup if session is None else session.last_setup
    return with_verdict(figures | fusion_figures(setup, rows))


def stream_figures(sensors: TwoSensors) -> Figures:
    """What became of the frames of both sensors, and the state of the links to other PCs."""
    counted, a, b = sensors.figures, sensors.a, sensors.b
    figures: Figures = {
        "frames": {"a": a.received, "b": b.received},
        "paired": counted.pairs,
        "alone": {"a": counted.alone_a, "b": counted.alone_b},
        "dropped": {"a": a.dropped, "b": b.dropped + counted.unmatched_b},
        "streams": {
            "too_slow_for": {"a": a.dropped, "b": b.dropped},
            "lost_on_usb": {"a": a.lost, "b": b.lost},
            "unmatched_b": counted.unmatched_b,
            "late": counted.late,
            "repeated": counted.repeated,
            "out_of_order": counted.reordered,
            "clock_resets": counted.resets,
            "lost_and_back": {"a": a.returns, "b": b.returns},
            "clock_offset_ms": None if counted.offset_ns is None else counted.offset_ns * 1e-6,
            "drift_ppm": counted.drift_ppm,
        },
    }
    links = {side: asdict(link) for side, link in zip("ab", sensors.links, strict=True) if link is not None}
    return figures | ({"network": links} if links else {})


def latency_figures(frames: Sequence[SessionFrame]) -> dict[str, float | None]:
    """Milliseconds from the arrival of a pair's first images to S*: median, 99th percentile and largest."""
    known = [frame.latency_ns * 1e-6 for frame in frames if frame.latency_ns is not None]
    if not known:
        return {"p50": None, "p99": None, "max": None}
    return {"p50": float(np.median(known)), "p99": float(np.percentile(known, 99)), "max": float(max(known))}
