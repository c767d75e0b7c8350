"""Fuses the skeletons of two sensors that are arrays already into a session in memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from devices.pairing import pair_views
from fusion.body import BODIES, Body
from fusion.calibration.calibration import Calibration
from fusion.pair_arrays import View
from fusion.setup import FuserSettings
from fusion.skeleton import checked_joints, impossible
from recordings.errors import RecordingError, UnknownNameError
from recordings.fusing.two_views import clock_of, fuse_views
from recordings.session import Session

_MOSTLY = 0.5


def fuse_arrays(
    body: Body | str,
    time: ArrayLike,
    positions_a: ArrayLike,
    positions_b: ArrayLike,
    *,
    states_a: ArrayLike | None = None,
    states_b: ArrayLike | None = None,
    calibration: Calibration | None = None,
    settings: FuserSettings | None = None,
    sources: tuple[str, str] = ("a", "b"),
) -> Session:
    """Fuses the skeletons of two sensors, as :func:`recordings.fuse` does with recordings.

    Args:
        body: The body tracker's family, or its name: ``kinect_v1``, ``kinect_v2``, ``azure_kinect`` or
            ``blazepose``.
        time: (T,) seconds of both sensors, increasing.
        positions_a, positions_b: (T, J, 3) metres, each in its sensor's frame: x right, y down, z forward.
            NaN marks a joint that was not seen.
        states_a, states_b: (T, J) 0 not tracked, 1 inferred, 2 tracked; None: every joint that has a
            position is tracked.
        calibration: An earlier calibration; None: found from the skeletons.
        settings: Settings of the method; None: the default, with ``hindsight="labels"``.
        sources: Names of the sensors, K_A first.

    Raises:
        RecordingError: There is no such body, or an array has another shape, unit or order.
        FusionError: The views cannot be calibrated, or cannot be of one person at one time.
    """
    if isinstance(body, str):
        if body not in BODIES:
            raise UnknownNameError("body", body, tuple(BODIES))
        body = BODIES[body]
    seconds = np.asarray(time, dtype=np.float64)
    time_ns = np.rint(1e9 * (seconds - seconds[:1])).astype(np.int64) if seconds.ndim == 1 else None
    if time_ns is None or not len(time_ns) or not np.isfinite(seconds).all() or (np.diff(time_ns) <= 0).any():
        raise RecordingError(
            f"`time` is (T,) seconds that increase, of at least one frame; got {seconds.shape} values."
        )
    read = []
    for side, positions, states in (("a", positions_a, states_a), ("b", positions_b, states_b)):
        at = np.array(positions, dtype=np.float64)
        if at.shape != (len(time_ns), len(body), 3):
            raise RecordingError(
                f"`positions_{side}` has the shape {at.shape}; {len(time_ns)} frames of {body.name} need "
                f"{(len(time_ns), len(body), 3)}."
            )
        stated = np.isfinite(at).all(axis=2)
        if stated.any() and impossible(at)[stated].mean() > _MOSTLY:
            raise RecordingError(
                f"`positions_{side}`: most joints are where no sensor sees. Positions are metres in the "
                "sensor's frame: x right, y down, z forward."
            )
        read.append(View(time_ns, *checked_joints(body, at, states, (len(time_ns),))))
    settings = settings or FuserSettings(hindsight="labels")
    pairing = pair_views(body, read[0], read[1], every_frame=settings.method == "duplex")
    about = {"dropped_a": pairing.dropped_a, "dropped_b": pairing.dropped_b}
    refine = calibration is None
    plan, frames, events = fuse_views(body, pairing, sources, settings, calibration, refine=refine)
    return Session.of(frames, sources, events, about=about | clock_of(plan))
