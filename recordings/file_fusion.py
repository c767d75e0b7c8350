"""Fuses two recorded files, or arrays, into a session in memory, as ``duplex fuse`` does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from devices.depth.image_thinning import Depth
from devices.pairing import pair_views
from devices.people.recorded_people import Follow
from devices.recorded.two_recordings import RecordingChoice
from devices.sensor import DeviceError
from devices.skeletons.stated_format import Texts, Units, stated_of_both
from devices.tracker_choice import WantedTracker, choose_tracker
from fusion.body import BODIES, Body
from fusion.calibration.calibration import Calibration
from fusion.pair_arrays import View
from fusion.setup import FuserSettings, Hindsight
from fusion.skeleton import checked_joints, impossible
from recordings.errors import RecordingError, UnknownNameError
from recordings.fusing.files import fuse_read, read_for
from recordings.fusing.two_views import MOSTLY, clock_of, fuse_views
from recordings.session import Session


def fuse(
    a: str | Path,
    b: str | Path,
    *,
    calibration: Calibration | None = None,
    settings: FuserSettings | None = None,
    person_a: str | None = None,
    person_b: str | None = None,
    skeletons_a: str | Path | None = None,
    skeletons_b: str | Path | None = None,
    unit: Units = "auto",
    axes: Texts = "",
    names: Texts = "",
    body: str = "",
    tracker: WantedTracker = "auto",
    depth: Depth = "full",
    hindsight: Hindsight = "labels",
    refine: bool = True,
    offset_ms: float | None = None,
    follow: Follow = "longest",
    force: bool = False,
) -> Session:
    """Fuses two recordings of one capture.

    >>> from recordings import fuse
    >>> session = fuse("a.csv", "b.csv")
    >>> session.fused.shape
    (120, 20, 3)

    This function writes no file. :meth:`recordings.session.Session.save` writes what ``duplex fuse --save``
    writes, except the advice of the set-up coach.

    Args:
        a, b: Recordings of the principal sensor K_A, in whose frame S* is, and of the secondary one K_B:
            ``.csv``, ``.json``, ``.skeleton``, ``.mkv`` of an Azure Kinect, ``.bag`` of Orbbec's SDK v2,
            ``.db3`` or ``.bag`` of a RealSense.
        calibration: An earlier calibration. None: calibrate on the start-up pose of the recordings, or on
            their calmest window if there is no such pose.
        settings: Settings of the method, except ``hindsight``.
        person_a, person_b: Ids of the person: whoever has them most of the time, even if at times under other
            ids. None: chosen by ``follow``.
        skeletons_a, skeletons_b: For recordings of images: saved skeletons, used instead of the body tracker.
        unit: Unit of the positions: ``m``, ``cm``, ``mm``, ``ft``, ``in``; ``auto``: found from the size of
            the person. This, axes and names may be pairs, A's and B's.
        axes: Axes of the positions of ``.csv`` files: ``kinect``, ``unity``, ``opengl``, ``ros``, or the axes
            of the file that are x (right), y (down) and z (forward), such as ``x,-y,z``.
        names: A table of the names of the joints in ``.csv`` files: a TOML file, or ``mixamo``,
            ``plug-in-gait`` or ``gait2392``.
        body: Family of the body tracker that made ``.csv`` or ``.json`` files: ``kinect_v1``, ``kinect_v2``,
            ``azure_kinect`` or ``blazepose``. Empty: found from the joint names of both.
        tracker: The body tracker for images: ``k4abt``, Microsoft's; ``blazepose``, the program's own, whose
            networks ``duplex tracker fetch`` has fetched; ``auto``: k4abt if it works, else blazepose.
        depth: How much of the depth images of recordings the session contains.
        hindsight: How later frames are used; see :class:`fusion.setup.FuserSettings`.
        refine: Whether a calibration found here is refined over the whole recording.
        offset_ms: Added to the times of ``b``. None: found from the motion, for the method ``duplex``.
        follow: Which of several people to follow, if no id is given: the one seen longest by both sensors or,
            with ``middle``, the one nearest the middle of the views among those seen a third as long.
        force: Whether to fuse recordings that cannot be of one capture; see
            :func:`recordings.fusing.two_views.fuse_views`.

    Raises:
        DeviceError: A recording cannot be read or tracked, the bodies differ, or they never overlap in time.
        FusionError: The views cannot be calibrated, or cannot be of one capture.
    """
    if body and body not in BODIES:
        raise DeviceError(f"body is {', '.join(BODIES)}; got {body!r}.")
    of_a, of_b = stated_of_both(unit, axes, names)
    choices = (
        RecordingChoice(Path(a), _path(skeletons_a), person_a, of_a, "skeletons_a", "person_a", body),
        RecordingChoice(Path(b), _path(skeletons_b), person_b, of_b, "skeletons_b", "person_b", body),
    )
    settings = replace(settings or FuserSettings(), hindsight=hindsight)
    read = read_for(settings, choices, choose_tracker(tracker), offset_ms, follow=follow)
    refine = refine and calibration is None
    return Session.of(*fuse_read(read, (str(a), str(b)), settings, calibration, refine, depth, force))


def _path(given: str | Path | None) -> Path | None:
    return None if given is None else Path(given)


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
        if stated.any() and impossible(at)[stated].mean() > MOSTLY:
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
