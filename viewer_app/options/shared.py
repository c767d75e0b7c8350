"""Options that several commands share.

A class's own options come after those of its bases, and those of its last base come first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import CoercionError, Group, Parameter, Token

from devices.sensor import ORIENTATIONS, Orientation
from devices.skeletons.stated_format import StatedFormat, Unit
from fusion.setup import PAPER_H
from viewer_app.errors import UsageError

ARGUMENT = Parameter(group="Arguments")
NAMES = "names", "names_a", "names_b"
"""Options that may be a file of names."""
SENSORS = Parameter(group=Group("Sensors", sort_key=1))
TRACKER = Parameter(group=Group("Body tracker", sort_key=2))
METHOD = Parameter(group=Group("Method", sort_key=3))
VIEWER = Parameter(group=Group("Viewer", sort_key=4))
OUTPUTS = Parameter(group=Group("Outputs", sort_key=5))
EXPERTS = Parameter(group=Group("For experts", sort_key=6))
_OfUnit = Annotated[Unit, SENSORS]
_OfAxes = Annotated[str, SENSORS, Parameter(allow_leading_hyphen=True)]


def _whole(kind: type, tokens: Sequence[Token]) -> int:
    """A whole number; the parser itself would round 1.5."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise CoercionError(token=tokens[0], target_type=kind) from None


WHOLE_NUMBER = Parameter(converter=_whole)


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """The files that a command writes."""

    save: Annotated[Path | None, OUTPUTS] = None
    """Save the session as an .rrd file."""
    report: Annotated[Path | None, OUTPUTS] = None
    """Write all figures of the summary as JSON."""
    force: Annotated[bool, OUTPUTS] = False
    """Overwrite existing files. For fuse: also accept recordings that cannot be from one capture."""


@dataclass(frozen=True, kw_only=True)
class WebOptions:
    """Whether a session is shown in a window or in a browser."""

    no_viewer: Annotated[bool, VIEWER] = False
    """Do not open the viewer."""
    web: Annotated[bool, VIEWER] = False
    """Show the session in a browser instead of a window: a page on port 9090 and its data on port 9876, or on
    the next free ports."""
    listen: Annotated[str | None, VIEWER] = None
    """With --web, --websocket or --lsl: the address of this machine on which to accept connections from other
    machines. If not given, only this machine can connect."""


@dataclass(frozen=True, kw_only=True)
class ViewerOptions(WebOptions):
    """How a running session is shown."""

    layout: Annotated[Literal["setup", "inspect", "report", "angles"], VIEWER] = "inspect"
    """The viewer tab that is open at first."""


@dataclass(frozen=True, kw_only=True)
class GoodOptions:
    """Option of the commands that write a part of a session."""

    good: bool = False
    """Write only the good seconds, as listed by duplex review. This leaves gaps in the times."""


@dataclass(frozen=True, kw_only=True)
class SummaryOptions:
    """How much the summary in the terminal says."""

    verbose: Annotated[bool, OUTPUTS] = False
    """Print all figures and every bone after the summary, and keep every status line of a live session."""


@dataclass(frozen=True, kw_only=True)
class TerminalOptions(SummaryOptions):
    """Terminal output of a running loop."""

    quiet: Annotated[bool, OUTPUTS] = False
    """Print only failures: no status lines and no set-up advice."""
    sound: Annotated[bool, OUTPUTS] = False
    """Play set-up tones: one low (not yet), three rising (ready), three low (out of view)."""


@dataclass(frozen=True, kw_only=True)
class FusionOptions:
    """Settings of the method, without its calibration."""

    h: Annotated[float, EXPERTS] = PAPER_H
    """How much more a tracked joint counts than an inferred one, between 0.5 and 1."""
    method: Annotated[Literal["duplex", "paper", "published"], METHOD] = "duplex"
    """duplex: an estimator over time. paper: eqs. (10)-(13), exact bones. published: also eqs. (3)-(9)."""
    smoothing: Annotated[float, METHOD] = 0.5
    """Smoothing of S*, from 0 (each frame on its own) to 1 (strongest). Only for method duplex."""
    weights: Annotated[Literal["paper", "equal"], EXPERTS] = "paper"
    """paper: weight joints by trust, eqs. (10) and (11). equal: weight both views equally."""


@dataclass(frozen=True, kw_only=True)
class MethodOptions(FusionOptions):
    """Settings of the method."""

    calibrate: Annotated[str, METHOD] = "auto"
    """auto: calibrate on the start-up pose, or on a walk if nobody holds the pose. Or a file from
    --save-calibration."""
    save_calibration: Annotated[Path | None, METHOD] = None
    """Save the sensors' placement and the bone lengths to a file."""


@dataclass(frozen=True, kw_only=True)
class OwnFileOptions:
    """How the .csv files of other programs are read."""

    unit: _OfUnit = "auto"
    """Unit of the positions in .csv, .json and .skeleton files. auto: found from the person's size."""
    axes: _OfAxes = ""
    """Axes of .csv files: kinect, unity, opengl, ros, or those pointing right, down and forward: x,-y,z."""
    names: Annotated[str, SENSORS] = ""
    """Joint names in .csv files: a .toml table, or one such as nuitrack or mixamo."""

    @property
    def stated(self) -> StatedFormat:
        """What is stated about the files."""
        return StatedFormat(self.unit, self.axes, self.names)


@dataclass(frozen=True, kw_only=True)
class FollowOptions:
    """Which of several people is followed."""

    follow: Annotated[Literal["middle", "longest"] | None, SENSORS] = None
    """Which of several people to follow: the one nearest the middle (default for live sensors), or the one
    seen longest (default for recordings)."""


@dataclass(frozen=True, kw_only=True)
class RecordingOptions(OwnFileOptions):
    """How recordings are fused."""

    unit_a: _OfUnit = "auto"
    """Unit of A's file alone, likewise --unit-b, --axes-a, --axes-b, --names-a and --names-b."""
    unit_b: _OfUnit = "auto"
    """Unit of B's file alone."""
    axes_a: _OfAxes = ""
    """Axes of A's file alone."""
    axes_b: _OfAxes = ""
    """Axes of B's file alone."""
    names_a: Annotated[str, SENSORS] = ""
    """Joint names in A's file alone."""
    names_b: Annotated[str, SENSORS] = ""
    """Joint names in B's file alone."""
    body: Annotated[Literal["auto", "kinect_v1", "kinect_v2", "azure_kinect", "blazepose"], SENSORS] = "auto"
    """Body tracker that made the .csv or .json files. auto: found from the joint names in both files."""
    calibrate: Annotated[str, METHOD] = "auto"
    """auto: on the start-up pose. seconds:N: on the first N seconds. Or a file from --save-calibration."""
    no_refine: Annotated[bool, EXPERTS] = False
    """Keep the first calibration instead of refining it over the recording. Only for method duplex."""
    smooth: Annotated[Literal["off", "whole"], METHOD] = "off"
    """whole: smooth over the whole recording, using later frames too, for less jitter and no lag. Only for
    method duplex."""
    depth: Annotated[Literal["none", "half", "full"], SENSORS] = "full"
    """Depth images to keep in the session: none, every second pixel in both directions, or all."""

    def stated_of(self, side: Literal["a", "b"]) -> StatedFormat:
        """What is stated about one of the files: for it alone, else for both."""
        own = {name: getattr(self, f"{name}_{side}") for name in ("unit", "axes", "names")}
        return replace(self.stated, **{name: of for name, of in own.items() if of not in ("", "auto")})


@dataclass(frozen=True, kw_only=True)
class TrackerOptions:
    """Options of the body tracker."""

    tracker: Annotated[Literal["auto", "blazepose", "k4abt"], TRACKER] = "auto"
    """Body tracker for images. k4abt: Microsoft's, which needs its library and a GPU. blazepose: the
    program's own, which runs on any CPU. auto: k4abt if it works, otherwise blazepose."""
    tracker_model: Annotated[Path | None, TRACKER] = None
    """Folder with blazepose's networks. If not given, the user's cache folder, to which they are fetched
    once."""
    tracker_network: Annotated[Literal["full", "lite"], TRACKER] = "full"
    """Network for blazepose. lite is faster and less accurate."""
    person: Annotated[Literal["middle", "nearest", "left", "right"], TRACKER] = "middle"
    """Which of several people blazepose follows: by position in each sensor's image, or the nearest one."""
    k4abt: Annotated[Path | None, EXPERTS] = None
    """Path of Microsoft's body tracker library, libk4abt. If not given, the system's library."""
    processing: Annotated[Literal["gpu", "cpu", "cuda", "tensorrt", "directml"], EXPERTS] = "gpu"
    """Where k4abt runs. On a CPU it tracks about one frame per second."""


@dataclass(frozen=True, kw_only=True)
class SensorOptions:
    """Choice of the two sensors."""

    kinect_a: Annotated[str | None, SENSORS] = None
    """Serial number of the principal sensor K_A. S* is in its frame. Or zenoh:KEY, for a sensor that duplex
    sensor runs on another PC."""
    kinect_b: Annotated[str | None, SENSORS] = None
    """Serial number of the secondary sensor K_B, or zenoh:KEY."""
    principal: Annotated[str | None, SENSORS] = None
    """Serial number of the sensor to use as K_A, if two are connected. If not given, duplex live asks."""
    sync_master: Annotated[str | None, SENSORS] = None
    """Serial number of the master on the sync cable. Needed for Orbbec and RealSense sensors; Azure Kinects
    detect the cable."""


@dataclass(frozen=True, kw_only=True)
class OrientationOptions:
    """How the two sensors are mounted."""

    orientation: Annotated[str | None, SENSORS] = None
    """Degrees by which both sensors are turned clockwise, seen from behind: 0, 90, 180 or 270. 90,0: A is on
    its side and B is upright. Images and skeletons are turned upright. If not given, fuse finds it from the
    person in recordings."""

    @property
    def orientations(self) -> tuple[Orientation | None, Orientation | None]:
        """A's and B's; None where it is not stated.

        Raises:
            UsageError: Another angle.
        """
        if self.orientation is None:
            return None, None
        known = {str(one): one for one in ORIENTATIONS}
        given = [known.get(one.strip()) for one in self.orientation.split(",")]
        if None in given or len(given) > 2:
            raise UsageError(
                f"--orientation {self.orientation}: give 0, 90, 180 or 270 degrees, or two of them, "
                "such as 90,0."
            )
        return given[0], given[-1]


@dataclass(frozen=True, kw_only=True)
class ZenohOptions:
    """Where Zenoh meets other programs and machines; only addresses given here are used."""

    zenoh_listen: Annotated[tuple[str, ...], OUTPUTS] = ()
    """Listen for other machines on these addresses, such as tcp/0.0.0.0:7447 for all networks of this
    machine. If neither this nor --zenoh-connect is given, only this machine can connect."""
    zenoh_connect: Annotated[tuple[str, ...], OUTPUTS] = ()
    """Connect to other machines at these addresses, such as tcp/HOST:7447."""


@dataclass(frozen=True, kw_only=True)
class LiveOutputOptions(ZenohOptions):
    """Where S* is sent while the loop runs."""

    vmc: Annotated[str | None, OUTPUTS] = None
    """HOST:PORT of a VMC receiver: VSeeFace, Warudo, Unity, Unreal, Blender. The usual port is 39539."""
    avatar: Annotated[Path | None, OUTPUTS] = None
    """With --vmc: a .vrm avatar, whose proportions are sent instead of the person's."""
    vrchat: Annotated[str | None, OUTPUTS] = None
    """HOST:PORT of VRChat's OSC trackers. The usual port is 9000."""
    feet: Annotated[Literal["planted", "free"], OUTPUTS] = "planted"
    """Feet sent with --vmc or --vrchat: planted, so that they hardly slide where they stand, or as in S*."""
    lsl: Annotated[str | None, OUTPUTS] = None
    """Name of a Lab Streaming Layer stream. Needs the extra lsl."""
    websocket: Annotated[int | None, OUTPUTS, WHOLE_NUMBER] = None
    """Port of a WebSocket server, which sends JSON and serves a page that draws the skeleton."""
    zenoh: Annotated[str | None, OUTPUTS] = None
    """Zenoh key under which to publish JSON. Needs the extra zenoh."""
    save_mcap: Annotated[Path | None, OUTPUTS] = None
    """Record S* as ROS 2 messages in an .mcap file. Needs the extra ros."""
    rate: Annotated[float | None, OUTPUTS] = None
    """Send S* this many times per second, predicted from the newest frame. If not given, once per frame."""

    @property
    def listens(self) -> bool:
        """Whether one of them waits for receivers on an address of this machine."""
        return self.websocket is not None or self.lsl is not None


def check_seconds(seconds: float | None) -> None:
    """Rejects a duration that is not positive or not finite."""
    if seconds is not None and not 0.0 < seconds < float("inf"):
        raise UsageError(f"--seconds must be a positive number; got {seconds}.")


def calibration_is_file(wanted: str) -> bool:
    """Whether ``--calibrate`` names a file."""
    return wanted != "auto" and wanted.partition(":")[0] != "seconds"


def calibration_source(wanted: str) -> Path | float | None:
    """What ``--calibrate`` names for recordings: a file, seconds, or None for ``auto``."""
    if wanted == "auto":
        return None
    kind, _, argument = wanted.partition(":")
    if kind == "seconds":
        try:
            seconds = float(argument)
        except ValueError:
            seconds = -1.0
        if not 0.0 < seconds < float("inf"):
            raise UsageError(f"--calibrate {wanted}: seconds must be a positive number, such as seconds:3.")
        return seconds
    if not Path(wanted).is_file():
        raise UsageError(
            f"--calibrate {wanted}: neither auto, nor seconds:N, nor an existing file. Create one with "
            "--save-calibration."
        )
    return Path(wanted)
