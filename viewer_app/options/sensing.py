"""Options of the commands that fuse what sensors report: demo, fuse, live, doctor."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from viewer_app.options.shared import (
    LiveOutputOptions,
    MethodOptions,
    OutputOptions,
    RecordingOptions,
    SensorOptions,
    SummaryOptions,
    TerminalOptions,
    TrackerOptions,
    ViewerOptions,
    ZenohOptions,
)


@dataclass(frozen=True)
class FuseOptions(
    RecordingOptions, TrackerOptions, MethodOptions, ViewerOptions, SummaryOptions, OutputOptions
):
    """Fuse two recorded skeleton streams into one skeleton with bones of constant length.

    Recordings are .csv (time_us,body,joint,x,y,z[,state]), .json (Microsoft's offline_processor),
    .skeleton (NTU RGB+D); or images, on which a body tracker is run: .mkv of an Azure Kinect, .bag of
    Orbbec's SDK v2.
    """

    a: Annotated[Positional[Path], arg(metavar="A")] = field(kw_only=True)
    """Recording of the principal sensor K_A; S* is in its frame."""
    b: Annotated[Positional[Path], arg(metavar="B")] = field(kw_only=True)
    """Recording of the secondary sensor K_B."""
    person_a: str | None = None
    """Id of the person in A; the one seen longest if not given."""
    person_b: str | None = None
    """Id of the person in B; the one seen longest if not given."""
    skeletons_a: Path | None = None
    """For an .mkv: a file of saved skeletons of A, instead of the body tracker."""
    skeletons_b: Path | None = None
    """For an .mkv: a file of saved skeletons of B, instead of the body tracker."""


@dataclass(frozen=True)
class DemoOptions(LiveOutputOptions, TerminalOptions, ViewerOptions):
    """Run the whole program without a sensor: two simulated Kinects watch one person.

    At some seconds one sensor loses an arm or exchanges left and right; the terminal says when. The person's
    true joints are logged too, as a fourth skeleton (hidden at first).
    """

    motion: str = "badminton"
    """A movement of the library (duplex demo --motion list names them), or a BVH file."""
    seconds: float = 30.0
    """How long."""
    seed: int = 0
    """Seed of the simulated sensors' errors; the same seed gives the same skeletons."""
    angle: float = 90.0
    """Degrees between the two sensors."""
    bad_setup: bool = False
    """Place the sensors badly, and see what the program advises."""
    body: Literal["kinect_v1", "kinect_v2", "azure_kinect", "blazepose"] = "azure_kinect"
    """Whose body tracker is simulated."""
    tracker: Literal["simulated", "blazepose"] = "simulated"
    """simulated: a tracker with the errors of --body. blazepose: the program's own tracker runs on simulated
    infrared and depth images."""
    tracker_model: Path | None = None
    """Folder of blazepose's networks; if not given, the user's cache folder, into which they are fetched
    once."""
    tracker_network: Literal["full", "lite"] = "full"
    """Network of blazepose; lite is faster and less accurate. full gives way to lite where it is
    too slow, if the network lite was fetched (duplex tracker fetch --network lite)."""
    depth: Literal["none", "half", "full"] = "half"
    """Depth images: none, half the sensor's resolution, or full. If the machine is too slow, as most are for
    full, images are dropped, skeletons never."""
    save: Path | None = None
    """Keep the session as an .rrd file; without a display demo.rrd if not given."""
    report: Path | None = None
    """Write the figures of the session to this .json file."""
    force: bool = False
    """Overwrite files that exist."""


@dataclass(frozen=True)
class LiveOptions(
    LiveOutputOptions,
    TrackerOptions,
    MethodOptions,
    TerminalOptions,
    ViewerOptions,
    OutputOptions,
    SensorOptions,
):
    """Fuse two sensors live: Azure Kinect, Orbbec Femto Bolt, Femto Mega, Gemini 2 and their kin.

    Ctrl-C ends the command and saves everything. duplex doctor shows what this machine lacks.
    """

    layout: Literal["setup", "inspect", "report"] = "setup"
    """Which of the viewer's tabs is open at first."""
    seconds: float | None = None
    """End after this many seconds; if not given, end with Ctrl-C."""
    depth: Literal["none", "half", "full"] = "half"
    """Depth images shown and saved: none, every second pixel in both directions, or all."""
    depth_mode: Literal["NFOV_UNBINNED", "WFOV_2X2BINNED"] = "NFOV_UNBINNED"
    """Narrow and far, or wide and near."""
    fps: Literal[5, 15, 30] = 30
    """Frames per second."""
    color: Literal["off", "720P", "1080P", "1440P", "1536P", "2160P", "3072P"] = "off"
    """Colour images, and at which resolution."""
    tracker_smoothing: float = 0.0
    """Temporal smoothing of the body tracker, 0 to 1; fusion needs 0."""


@dataclass(frozen=True)
class DoctorOptions(TrackerOptions, SensorOptions):
    """Check live capture on this machine, and show how to fix what does not work.

    The exit code is 0 if duplex live could start, 1 if not.
    """


@dataclass(frozen=True)
class PublishOptions(ZenohOptions, TrackerOptions):
    """Run one sensor and its body tracker on this PC, and publish its skeletons for duplex live on another.

    There: duplex live --zenoh-listen tcp/0.0.0.0:7447 --kinect-a zenoh:KEY_A --kinect-b zenoh:KEY_B.
    Nothing is encrypted: use it in a network that you trust.
    """

    publish: str = field(kw_only=True)
    """The key to publish under, such as lab/a."""
    kinect: str | None = None
    """Serial number of the sensor; the only one connected if not given."""
    recording: Path | None = None
    """Play a recording in real time instead of a sensor: .csv, .json, .skeleton or .mkv."""
    simulate: Literal["a", "b"] | None = None
    """Simulate sensor a or b instead; two programs see the same person, by the clocks of their PCs."""
    motion: str = "walk"
    """With --simulate: a movement of the library (duplex demo --motion list), or a BVH file."""
    body: Literal["kinect_v1", "kinect_v2", "azure_kinect"] = "azure_kinect"
    """With --simulate: whose body tracker."""
    depth: bool = False
    """Publish the depth images, too, without loss: about 5 MB per second."""
    depth_mode: Literal["NFOV_UNBINNED", "WFOV_2X2BINNED"] = "NFOV_UNBINNED"
    """Narrow and far, or wide and near."""
    fps: Literal[5, 15, 30] = 30
    """Frames per second."""
    seconds: float | None = None
    """End after this many seconds; if not given, end with Ctrl-C."""
    quiet: bool = False
    """Print only warnings."""
