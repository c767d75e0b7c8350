"""Options of the commands that fuse what sensors report, or prepare it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from fusion.setup import FuserSettings, Hindsight
from viewer_app.options.shared import (
    ARGUMENT,
    OUTPUTS,
    SENSORS,
    TRACKER,
    VIEWER,
    WHOLE_NUMBER,
    FollowOptions,
    FusionOptions,
    GoodOptions,
    LiveOutputOptions,
    MethodOptions,
    OrientationOptions,
    OutputOptions,
    OwnFileOptions,
    RecordingOptions,
    SensorOptions,
    SummaryOptions,
    TerminalOptions,
    TrackerOptions,
    ViewerOptions,
    ZenohOptions,
)


@dataclass(frozen=True, kw_only=True)
class FuseOptions(
    FollowOptions,
    OrientationOptions,
    RecordingOptions,
    TrackerOptions,
    MethodOptions,
    ViewerOptions,
    SummaryOptions,
    OutputOptions,
    GoodOptions,
):
    """Fuse two recorded skeleton streams into one skeleton with bones of constant length.

    Recordings are skeletons, in .csv (time_us,body,joint,x,y,z[,state]), .json (Microsoft's
    offline_processor) or .skeleton (NTU RGB+D) files; or images, on which a body tracker runs: .mkv from an
    Azure Kinect, .bag from Orbbec's SDK v2, .db3 or .bag from a RealSense.
    """

    a: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """Recording of the principal sensor K_A. S* is in its frame."""
    b: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """Recording of the secondary sensor K_B."""
    person_a: Annotated[str | None, SENSORS] = None
    """Id of the person in A, who is then followed even if it changes. If not given, --follow
    chooses."""
    person_b: Annotated[str | None, SENSORS] = None
    """Id of the person in B, who is then followed even if it changes. If not given, --follow
    chooses."""
    skeletons_a: Annotated[Path | None, SENSORS] = None
    """For a recording of images: saved skeletons of A, used instead of the body tracker."""
    skeletons_b: Annotated[Path | None, SENSORS] = None
    """For a recording of images: saved skeletons of B, used instead of the body tracker."""
    to: Annotated[Path | None, OUTPUTS] = None
    """Also write S* for another program, like duplex export. The file's ending chooses the format."""
    offset: Annotated[float | None, SENSORS] = None
    """Milliseconds to add to B's times. If not given, found from the motion (only with --method duplex)."""


@dataclass(frozen=True, kw_only=True)
class CaptureOptions:
    """How sensors on this PC run."""

    seconds: float | None = None
    """Stop after this many seconds. If not given, stop with Ctrl-C."""
    depth_mode: Annotated[Literal["NFOV_UNBINNED", "WFOV_2X2BINNED"], SENSORS] = "NFOV_UNBINNED"
    """Field of view and range: narrow and far, or wide and near."""
    fps: Annotated[Literal[5, 15, 30], SENSORS] = 30
    """Frames per second."""


@dataclass(frozen=True, kw_only=True)
class ImageFilesOptions:
    """Whether the images of both sensors are recorded beside S*."""

    record: Annotated[Path | None, OUTPUTS] = None
    """Record the images from both sensors to this folder, like duplex record."""
    compress: Annotated[bool, OUTPUTS] = False
    """With --record: compress the images without loss. Microsoft's tools cannot read compressed
    recordings."""


@dataclass(frozen=True, kw_only=True)
class DemoOptions(ImageFilesOptions, LiveOutputOptions, TerminalOptions, ViewerOptions, OutputOptions):
    """Run the whole program without a sensor: two simulated Kinects watch one person.

    At times, one sensor misplaces an arm or exchanges left and right. The terminal says when. The person's
    true joints are logged as a fourth skeleton, which is hidden at first.
    """

    motion: str = "badminton"
    """A movement from the library (duplex demo --motion list prints their names), or a BVH file."""
    seconds: float = 30.0
    """Length of the demonstration, in seconds."""
    seed: Annotated[int, SENSORS, WHOLE_NUMBER] = 0
    """Seed of the simulated sensors' errors. The same seed gives the same skeletons."""
    angle: Annotated[float, SENSORS] = 90.0
    """Degrees between the two sensors."""
    bad_setup: Annotated[bool, SENSORS] = False
    """Place the sensors badly, to see what the program advises."""
    people: Annotated[Literal[1, 2], SENSORS] = 1
    """Number of people. With 2, the trackers exchange their ids."""
    other: Annotated[Literal["walks", "sits"], SENSORS] = "walks"
    """What the other person does: walk about behind the first one, or sit down in front of them in A's
    view."""
    body: Annotated[Literal["kinect_v1", "kinect_v2", "azure_kinect", "blazepose"], SENSORS] = "azure_kinect"
    """Body tracker to simulate."""
    tracker: Annotated[Literal["simulated", "blazepose"], TRACKER] = "simulated"
    """simulated: a tracker with the errors of --body. blazepose: the program's own tracker runs on simulated
    infrared and depth images."""
    tracker_model: Annotated[Path | None, TRACKER] = None
    """Folder with blazepose's networks. If not given, the user's cache folder."""
    tracker_network: Annotated[Literal["full", "lite"], TRACKER] = "full"
    """Network for blazepose. lite is faster and less accurate. If full is too slow, lite replaces it if it
    was fetched (duplex tracker fetch --network lite)."""
    depth: Annotated[Literal["none", "half", "full"], SENSORS] = "half"
    """Depth images: none, half the sensor's resolution, or full. If the machine is too slow, as most are for
    full, images are dropped, but never skeletons."""
    save: Annotated[Path | None, OUTPUTS] = None
    """Save the session as an .rrd file. If not given and there is no display, demo.rrd."""


@dataclass(frozen=True, kw_only=True)
class LiveOptions(
    CaptureOptions,
    ImageFilesOptions,
    FollowOptions,
    OrientationOptions,
    LiveOutputOptions,
    TrackerOptions,
    MethodOptions,
    TerminalOptions,
    ViewerOptions,
    OutputOptions,
    SensorOptions,
):
    """Fuse two sensors live: Azure Kinect, Orbbec, RealSense, Kinect v1 or v2.

    Ctrl-C stops the command and saves everything. duplex doctor shows what this machine lacks. Instead of
    sensors, two recordings of images can be played as if they were live.
    """

    a: Annotated[Path | None, ARGUMENT] = field(default=None, kw_only=False)
    """Play this recording (.mkv, .db3 or .bag) instead of sensor K_A."""
    b: Annotated[Path | None, ARGUMENT] = field(default=None, kw_only=False)
    """Play this recording instead of sensor K_B."""
    layout: Annotated[Literal["setup", "inspect", "report", "angles"], VIEWER] = "setup"
    """The viewer tab that is open at first."""
    depth: Annotated[Literal["none", "half", "full"], SENSORS] = "half"
    """Depth images shown and saved: none, every second pixel in both directions, or all."""
    color: Annotated[Literal["off", "720P", "1080P", "1440P", "1536P", "2160P", "3072P"], SENSORS] = "off"
    """Resolution of the colour images. off: no colour images."""


@dataclass(frozen=True, kw_only=True)
class RecordOptions(CaptureOptions, SensorOptions):
    """Record depth and infrared from two sensors without loss, as FOLDER/a.mkv and FOLDER/b.mkv.

    To fuse them later, use duplex fuse FOLDER/a.mkv FOLDER/b.mkv, or duplex live with both files. After a
    crash, or if the disk is full, everything recorded so far can be read.
    """

    folder: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """Folder to record to. It is created if it does not exist."""
    compress: Annotated[bool, OUTPUTS] = False
    """Compress depth and infrared without loss, to about 40 % of the size. Microsoft's tools cannot read
    compressed recordings."""
    color: Annotated[Literal["off", "720P", "1080P", "1440P", "1536P", "2160P", "3072P"], SENSORS] = "off"
    """Also record colour images, at this resolution."""
    force: Annotated[bool, OUTPUTS] = False
    """Overwrite existing recordings."""
    quiet: bool = False
    """Print only warnings."""


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(TrackerOptions, SensorOptions):
    """Check live capture on this machine, and show how to fix what does not work.

    The exit code is 0 if duplex live can start, and 1 if not.
    """

    bundle: Annotated[Path | None, OUTPUTS] = None
    """Write a .zip with all results, versions and logs, to send to the maintainers. User and machine names,
    paths and serial numbers are replaced."""
    recording: Annotated[bool | None, OUTPUTS, Parameter(negative="--no-recording")] = None
    """With --bundle: add, or leave out, ten seconds of depth and infrared, in which you and the room can be
    seen. If not given, the command asks."""
    force: Annotated[bool, OUTPUTS] = False
    """Overwrite an existing .zip."""


@dataclass(frozen=True, kw_only=True)
class PublishOptions(CaptureOptions, ZenohOptions, TrackerOptions, OwnFileOptions):
    """Run one sensor and its body tracker on this PC, and publish its skeletons for duplex live on another.

    On the other PC, run duplex live --zenoh-listen tcp/0.0.0.0:7447 --kinect-a zenoh:KEY_A --kinect-b
    zenoh:KEY_B. Nothing is encrypted: use it only in a network that you trust.
    """

    publish: Annotated[str, OUTPUTS]
    """The key to publish under, such as lab/a."""
    kinect: Annotated[str | None, SENSORS] = None
    """Serial number of the sensor. If not given, the only sensor connected."""
    orientation: Annotated[Literal[0, 90, 180, 270], SENSORS] = 0
    """Degrees by which the sensor is turned clockwise, seen from behind."""
    recording: Annotated[Path | None, SENSORS] = None
    """Instead of running a sensor, play a recording in real time: .csv, .json, .skeleton, .mkv, .db3 or
    .bag."""
    simulate: Annotated[Literal["a", "b"] | None, SENSORS] = None
    """Instead of running a sensor, simulate sensor a or b. Two programs see the same person, synchronised by
    the clocks of their PCs."""
    motion: Annotated[str, SENSORS] = "walk"
    """With --simulate: a movement from the library (see duplex demo --motion list), or a BVH file."""
    body: Annotated[Literal["kinect_v1", "kinect_v2", "azure_kinect"], SENSORS] = "azure_kinect"
    """With --simulate: body tracker to simulate."""
    depth: Annotated[bool, OUTPUTS] = False
    """Also publish the depth images, without loss: about 5 MB per second."""
    quiet: bool = False
    """Print only warnings."""


@dataclass(frozen=True, kw_only=True)
class BatchOptions(TrackerOptions, RecordingOptions, FusionOptions):
    """Fuse many pairs of recordings in parallel. A second run continues where the first one stopped.

    In a folder and its subfolders, a pair is a.EXT and b.EXT, or NAME_a.EXT and NAME_b.EXT, where EXT is csv,
    json, skeleton, mkv, bag or db3. Saved skeletons with the same name as an .mkv are used instead of the
    body tracker. A manifest is a .csv with the columns name,a,b[,skeletons_a,skeletons_b,person_a,person_b].

    The exit code is 1 if a pair could not be fused.
    """

    source: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """A folder of recordings, or a manifest (.csv) with paths relative to its own folder."""
    out: Annotated[Path, OUTPUTS]
    """Folder for the sessions, one subfolder each, and the summary (summary.html, summary.parquet)."""
    processes: Annotated[int, WHOLE_NUMBER] = 0
    """Number of recordings to fuse at the same time on this machine. 0: one per processor."""
    scheduler: str | None = None
    """Dask scheduler, tcp://HOST:PORT, whose workers fuse the recordings. They must see the same paths as
    this machine."""
    pages: Annotated[bool, OUTPUTS] = False
    """Write a page for each session, like duplex review --html. This takes longer than the fusion."""
    force: Annotated[bool, OUTPUTS] = False
    """Fuse again and overwrite sessions that were fused from other recordings, with other options or by
    another version."""


def recording_settings(options: FuseOptions | BatchOptions) -> FuserSettings:
    """The settings of the method for recordings."""
    hindsight: Hindsight = "whole" if options.smooth == "whole" else "labels"
    if options.method != "duplex":
        hindsight = "none"
    return FuserSettings(options.method, options.h, options.weights, options.smoothing, hindsight)


@dataclass(frozen=True, kw_only=True)
class TrackerFetchOptions:
    """Fetch the networks of the body tracker BlazePose from the package that contains them.

    Other commands do this automatically when they need the networks. These are Google's, under the licence
    Apache-2.0.
    """

    network: Literal["full", "lite"] = "full"
    """Network to fetch. lite is faster and less accurate, and is fetched with npm."""
    tracker_model: Path | None = None
    """Folder for the files, for example to copy it to another machine. If not given, the user's cache
    folder."""
