"""Fuses two recorded files into a session in memory, as ``duplex fuse`` does, without terminal output."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from devices.depth.image_thinning import Depth
from devices.people.recorded_people import Follow
from devices.recorded.two_recordings import RecordingChoice
from devices.sensor import DeviceError
from devices.skeletons.stated_format import Texts, Units, stated_of_both
from devices.tracker_choice import WantedTracker, choose_tracker
from fusion.body import BODIES
from fusion.calibration.calibration import Calibration
from fusion.setup import FuserSettings, Hindsight
from recordings.fusing.files import fuse_read, read_for
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
