"""The table of rules: what is judged, its limits, and the words.

Fields in braces: ``value``, ``signed``, the limits ``low`` and ``high`` of what is good, ``by`` (how far the
figure is beyond them, in half units), the sensor ``who``, ``you_are`` or the person is, and what the caller
names.
"""

from dataclasses import dataclass
from math import inf
from typing import Literal, NamedTuple

from fusion.calibration.calibration import GOOD_TURN_DEG, USABLE_TURN_DEG
from fusion.intrinsics import Intrinsics

TALL = 2.0
"""Metres that must fit into the image: a tall adult, and some room."""
_FARTHEST = {"kinect_v1": 4.0, "kinect_v2": 4.5, "azure_kinect": 3.9, "blazepose": 3.9}
"""Specified depth range in metres, by body (Azure: NFOV, not binned; BlazePose: as on an Azure Kinect)."""
_WIDE, _FARTHEST_WIDE = 1.5, 2.9
"""Width of the image over the focal length from which an Azure Kinect is in a wide mode (WFOV: 2.0,
NFOV: 1.3); its range then, binned, metres."""
_VIEWS_MM = {"kinect_v1": 100.0, "kinect_v2": 100.0, "azure_kinect": 60.0, "blazepose": 90.0}
_ERROR_MM = {"kinect_v1": 80.0, "kinect_v2": 80.0, "azure_kinect": 60.0, "blazepose": 90.0}
WALK, RING = "walk a few steps back and forth", "stand in the ring"
AIM = "aim A and B at one place, 2.5 m from each, 90° apart"
_USABLE = 1.5
_OUT_OF_RANGE = 0.25


class Limits(NamedTuple):
    """Inclusive ranges of a figure that is good, and of one that is usable."""

    good: tuple[float, float]
    usable: tuple[float, float]


@dataclass(frozen=True)
class Rule:
    """What one figure says of a session.

    Attributes:
        figure: What is judged, as the documents name it.
        unit: Its unit, as the documents write it after a number.
        limits: What is good and usable; outside of both the word is `beyond`.
        what: What is wrong, in a few words; a headline begins with it.
        limit: What is good, or why it matters.
        live: What to do while the sensors run; a pair where it differs below and above the good range.
        files: What to do about recordings, likewise.
        told_by: The rules that this is a consequence of: it is not said beside them.
        is_event: Whether its beginning and end are events of a session.
        lost: Whether a view shows no one.
        first: Whether it is told though the last step is not done.
        by_place: Whether the person is asked into the ring first, if they stand elsewhere.
    """

    figure: str
    unit: str
    limits: Limits
    what: str
    limit: str = ""
    live: str | tuple[str, str] = ""
    files: str | tuple[str, str] = ""
    digits: int = 0
    beyond: Literal["usable", "unknown", "poor"] = "poor"
    told_by: frozenset[str] = frozenset()
    is_event: bool = True
    lost: bool = False
    first: bool = False
    by_place: bool = False


def below(good: float, usable: float) -> Limits:
    """Of a figure that is the better the smaller it is."""
    return Limits((-inf, good), (-inf, usable))


def of_views(body: str) -> Limits:
    """Of the distance between the views, millimetres, by the body that the trackers report."""
    return below(_VIEWS_MM[body], _USABLE * _VIEWS_MM[body])


def of_error(body: str) -> Limits:
    """Of the expected error of S*, millimetres."""
    return below(_ERROR_MM[body], _USABLE * _ERROR_MM[body])


def nearest(camera: Intrinsics) -> float:
    """The smallest distance in metres at which a tall person fits into the image."""
    return TALL * camera.fy / camera.height


def farthest(body: str, camera: Intrinsics) -> float:
    """The largest distance in metres that the sensor measures well."""
    wide = body == "azure_kinect" and camera.width > _WIDE * camera.fx
    return _FARTHEST_WIDE if wide else _FARTHEST[body]


def within(near: float, far: float) -> Limits:
    """What is good and usable of a distance from a sensor that measures from `near` to `far`."""
    return Limits((near, far), ((1.0 - _OUT_OF_RANGE) * near, (1.0 + _OUT_OF_RANGE) * far))


_VIEWS = frozenset({"mirrored", "two_people", "unseen_together", "moved"})
_SLOW = frozenset({"slow"})
_DOUBTFUL = below(10.0, 50.0)
_FEW = below(10.0, 30.0)

# fmt: off
RULES: dict[str, Rule] = {
    "no_frames": Rule(
        "time since a sensor's last frame", "s", below(0.3, 0.3), what="no frames from {who}",
        live="wait for {who}", told_by=_SLOW, is_event=False, lost=True, first=True),
    "unseen": Rule(
        "time without a person in a view, now", "s", below(1.0, 1.0), what="{who} sees no one",
        live="stand 2.5 m in front of it", told_by=frozenset({"no_frames", "unseen_together"}), lost=True,
        first=True),
    "others": Rule(
        "time with somebody else in view before the calibration, now", "%", below(50.0, 50.0),
        what="someone else is in view of {who}", live="ask them to step aside", first=True),
    "mirrored": Rule(
        "frames that show the mirror image of a person", "%", below(50.0, 50.0),
        what="{who} is the mirror image of a person", live="turn off mirroring in the driver of {who}",
        files="change the sign of x in the file of {who}", first=True),
    "slow": Rule(
        "frames that this machine was too slow for", "%", _FEW,
        what="this machine is too slow for {value} % of the frames of {who}",
        live="close other programs, or use `depth=none`"),
    "clock": Rule(
        "clock offset, less two standard deviations", "ms", below(17.0, 50.0),
        what="B captures {offset} ± {sd} ms off its time stamps",
        files="compare with `offset_ms={offset}`, which corrects it"),
    "upside_down": Rule(
        "frames with the head below the feet", "%", below(90.0, 100.0), what="{who} is upside down",
        live="turn the sensor round", files="state its `axes`, or its `orientation`"),
    "lacking": Rule(
        "joints in no frame of either view", "", below(0.0, inf), what="no view has {which} in any frame",
        limit="S* predicts what is not measured"),
    "unseen_together": Rule(
        "frames with a joint in both views", "", Limits((1.0, inf), (1.0, inf)),
        what="no joint was seen by both sensors", live=AIM,
        files="check that both see the person", beyond="unknown"),
    "two_people": Rule(
        "distance between the views, for 5 % of the time", "mm", below(500.0, 500.0),
        what="a twentieth of the time the views differ by more than {value} mm, as those of two people do",
        live="be the only person in view",
        files="check that both recordings show one person at the same time", told_by=frozenset({"mirrored"})),
    "hidden": Rule(
        "time in which a view shows people, but not the person, now", "s", below(1.0, inf),
        what="{who} shows somebody else, or was moved", live="walk a few steps where both see you",
        is_event=False),
    "moved": Rule(
        "the views' own placement of B, from the calibration's", "", below(1.0, 2.0),
        what="B is {off} off its calibration", limit="good is below {most}", live="{again}",
        files="calibrate on this recording", told_by=frozenset({"mirrored", "two_people"})),
    "unconfirmed": Rule(
        "the views' own placement of B beside a loaded calibration, one standard deviation", "°",
        below(2.0, inf), what="the loaded calibration is not confirmed",
        live=WALK, files="record with the person walking about",
        told_by=frozenset({"mirrored", "two_people"}), is_event=False),
    "distance": Rule(
        "distance of the person from a sensor", "m", Limits((0.0, inf), (0.0, inf)),
        what="{you_are} {value} m from {who}", limit="good is {low} to {high} m",
        live=("step back {by} m from {who}", "come {by} m closer to {who}"),
        files=("record with the person further away", "record with the person nearer"), digits=1,
        told_by=frozenset({"overlap"}), by_place=True),
    "feet": Rule(
        "frames with a foot out of view, now", "%", below(50.0, 50.0), what="feet out of view of {who}",
        live="tilt {who} down by {turn}°, or step back from it", told_by=frozenset({"distance"}),
        by_place=True),
    "whole": Rule(
        "frames with a part of the person out of view, now", "%", below(50.0, inf),
        what="a part of you is out of view of {who}", live="{aim}",
        told_by=frozenset({"distance", "feet"}), is_event=False, by_place=True),
    "overlap": Rule(
        "what the best place lacks of room for a person, before both sensors", "m", below(0.0, 0.0),
        what="A and B have no place to stand in common", limit="the best one lacks {value} m",
        live=AIM, digits=1,
        told_by=frozenset({"mirrored", "moved", "hidden"})),
    "angle": Rule(
        "angle between the sensors, about the vertical, less two standard deviations", "°",
        Limits((60.0, 120.0), (40.0, 140.0)), what="A and B look {value}° apart",
        limit="good is {low}° to {high}°",
        live=("move B away from A, round you, to 90°", "move B towards A, round you, to 90°"),
        files=("record with them further apart", "record with them closer together"),
        told_by=frozenset({"mirrored", "moved", "hidden"})),
    "uncalibrated": Rule(
        "frames of the calibration", "", Limits((15.0, inf), (15.0, inf)), what="{calibrated}",
        live=RING + ", arms and legs apart, 3 s, then walk", files="{calibrate}", beyond="unknown",
        told_by=frozenset({"distance", "feet", "angle"}), is_event=False),
    "precision": Rule(
        "rotation of B, one standard deviation", "°", below(GOOD_TURN_DEG, USABLE_TURN_DEG),
        what="B's rotation is certain to {value}° only", limit="good is {high}°",
        live=WALK, files="record with the person walking about", digits=1,
        told_by=frozenset({"mirrored", "moved", "unconfirmed", "uncalibrated"}), is_event=False),
    "error": Rule(
        "expected error of S*: its median standard deviation", "mm", below(60.0, 90.0),
        what="S* is expected to be off by {value} mm", limit="good is below {high}",
        live=AIM, files="record with both sensors nearer, and 90° apart",
        told_by=_VIEWS | {"distance", "angle", "precision"}, by_place=True),
    "views": Rule(
        "distance between the views, median", "mm", below(60.0, 90.0),
        what="the views differ by {value} mm", limit="good is below {high}",
        live=AIM, files="check that both show one moment, or {calibrate}",
        told_by=_VIEWS | {"hidden", "precision"}, by_place=True),
    "nobody": Rule(
        "time with nobody in view, or without a frame", "%", _DOUBTFUL,
        what="nobody is in view for {lasts}", live="stay in view", files="leave that out with `good`"),
    "doubtful": Rule(
        "time in which S* or a limb is uncertain, or one view is alone", "%", _DOUBTFUL,
        what="{doubt} for {lasts}", live="stay where both sensors see all of you",
        files="leave that out with `good`, or record where both see all of the person", told_by=_SLOW),
    "rate": Rule(
        "frames per second of a sensor, now", "1/s", Limits((24.0, inf), (-inf, inf)),
        what="{who} gives {value} frames per second", limit="below {low} movements are missed",
        live="{cause}", told_by=_SLOW),
    "lost": Rule(
        "frames of a sensor lost on USB", "%", _FEW,
        what="{value} % of the frames of {who} are lost on USB",
        live="give {who} a USB controller of its own"),
    "unpaired": Rule(
        "frames without a partner", "%", _FEW, what="{value} % of the frames have no partner",
        live="check the frame rates of both sensors and trackers",
        files="check that both were recorded at one time, and their frame rates", told_by=_SLOW | {"lost"}),
}
"""By name, causes before their consequences: in this order they are followed."""
# fmt: on
