"""The command line as values: a command is a frozen dataclass; its field docstrings are the help text.

The module imports nothing slow, so that ``duplex --help`` answers at once. It is long because it contains all
commands, which share options.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from fusion.paper_constants import PAPER_H

_BENCH_MOTIONS = ("walk", "arms", "badminton", "basketball", "squat", "sit", "boxing", "still")


# A class's own options come after those of its bases, and those of its last base come first.


@dataclass(frozen=True)
class OutputOptions:
    """The files that a command writes."""

    save: Path | None = None
    """Keep the session as an .rrd file."""
    report: Path | None = None
    """Write all figures of the summary as JSON."""
    force: bool = False
    """Overwrite files that exist."""


@dataclass(frozen=True)
class ViewerOptions:
    """How a running session is shown."""

    no_viewer: bool = False
    """Do not open the viewer."""
    web: bool = False
    """Show the session in a browser instead of a window."""
    listen: str | None = None
    """With --web: the address of this machine to listen on, also for other machines. Default: this machine
    only."""
    layout: Literal["setup", "inspect", "report"] = "inspect"
    """Which of the viewer's tabs is open at first."""


@dataclass(frozen=True)
class TerminalOptions:
    """Terminal output of a running loop."""

    quiet: bool = False
    """No status line and no advice, only warnings."""
    verbose: bool = False
    """Keep every status line."""


@dataclass(frozen=True)
class MethodOptions:
    """Settings of the method."""

    calibrate: str = "auto"
    """auto: calibrate on the start-up pose, once it is held. Or a file of --save-calibration."""
    save_calibration: Path | None = None
    """Save the sensors' placement and the bone lengths to a file."""
    h: float = PAPER_H
    """How much more a tracked joint counts than an inferred one, between 0.5 and 1."""
    method: Literal["duplex", "paper", "published"] = "duplex"
    """duplex: an estimator in time. paper: eqs. (10)-(13), exact bones. published: eqs. (3)-(9) as well."""
    smoothing: float = 0.5
    """How calm the joints are, from 0 (each frame by itself) to 1; of the method duplex."""
    weights: Literal["paper", "equal"] = "paper"
    """paper: trust a joint, eqs. (10), (11). equal: both views alike."""


@dataclass(frozen=True)
class TrackerOptions:
    """Options of the body tracker."""

    k4abt: Path | None = None
    """Library of Microsoft's body tracker, libk4abt; if not given, the system's."""
    processing: Literal["gpu", "cpu", "cuda", "tensorrt", "directml"] = "gpu"
    """Where the body tracker runs; a CPU tracks about one frame per second."""


@dataclass(frozen=True)
class SensorOptions:
    """Choice of the two sensors."""

    kinect_a: str | None = None
    """Serial number of the principal sensor K_A; S* is in its frame."""
    kinect_b: str | None = None
    """Serial number of the secondary sensor K_B."""
    principal: str | None = None
    """Serial number of the sensor that is K_A, if two are connected; if not given, duplex live asks."""
    sync_master: str | None = None
    """Serial number of the master on the sync cable; needed with Orbbec's wrapper, which cannot detect it."""


@dataclass(frozen=True)
class FuseOptions(TrackerOptions, MethodOptions, ViewerOptions, OutputOptions):
    """Fuse two recorded skeleton streams into one skeleton with bones of constant length.

    Recordings are .csv (time_us,body,joint,x,y,z[,state]; metres), .json (Microsoft's offline_processor),
    .skeleton (NTU RGB+D), or .mkv of an Azure Kinect, on which the body tracker is run.
    """

    a: Positional[Path] = field(kw_only=True)
    """Recording of the principal sensor K_A; S* is in its frame."""
    b: Positional[Path] = field(kw_only=True)
    """Recording of the secondary sensor K_B."""
    calibrate: str = "auto"
    """auto: on the start-up pose. seconds:N: on the first N seconds. Or a file of --save-calibration."""
    refine: bool = True
    """Refine the calibration, unless it is from a file, over the whole recording; of the method duplex."""
    smooth: Literal["off", "whole"] = "off"
    """whole: each frame counts what comes after it as well; no lag, and calmer. Of the method duplex."""
    person_a: str | None = None
    """Id of the person in A; the one seen longest if not given."""
    person_b: str | None = None
    """Id of the person in B; the one seen longest if not given."""
    skeletons_a: Path | None = None
    """For an .mkv: a file of saved skeletons of A, instead of the body tracker."""
    skeletons_b: Path | None = None
    """For an .mkv: a file of saved skeletons of B, instead of the body tracker."""
    depth: Literal["none", "half", "full"] = "full"
    """For an .mkv: its depth images in the session: none, every second pixel in both directions, or all."""


@dataclass(frozen=True)
class DemoOptions(TerminalOptions, ViewerOptions):
    """Run the whole program without a sensor: two simulated Kinects watch one person.

    The person's true joints are logged too, as a fourth skeleton (hidden at first).
    """

    motion: str = "badminton"
    """A movement of the library (duplex demo --motion list names them), or a BVH file."""
    seconds: float = 30.0
    """How long."""
    seed: int = 0
    """Seed of the simulated sensors' errors; the same seed gives the same skeletons."""
    angle: float = 90.0
    """Degrees between the two sensors."""
    body: Literal["kinect_v1", "kinect_v2", "azure_kinect"] = "azure_kinect"
    """Whose body tracker is simulated."""
    depth: Literal["none", "half", "full"] = "half"
    """Depth images: none, half the sensor's resolution, or full. If the machine is too slow, as most are for
    full, images are dropped, skeletons never."""
    save: Path | None = None
    """Keep the session as an .rrd file; without a display demo.rrd if not given."""
    force: bool = False
    """Overwrite files that exist."""


@dataclass(frozen=True)
class LiveOptions(
    TrackerOptions, MethodOptions, TerminalOptions, ViewerOptions, OutputOptions, SensorOptions
):
    """Fuse two Azure Kinects (or Orbbec Femto Bolt / Mega) live.

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
class BenchAccuracyOptions:
    """Measure the accuracy of S* in millimetres: methods side by side on simulated sensors with known
    truth."""

    set: Literal["simulated", "real"] = "simulated"
    """simulated: the methods against the truth. real: the simulator against figures of real sensors."""
    motions: tuple[str, ...] = _BENCH_MOTIONS
    """Movements of the library."""
    angles: tuple[float, ...] = (45.0, 90.0, 135.0)
    """Degrees between the sensors."""
    seeds: int = 10
    """How many recordings of each movement and angle, each with its own seed."""
    first_seed: int = 0
    """The first seed; the others follow it."""
    seconds: float = 20.0
    """Duration of each recording."""
    body: Literal["kinect_v1", "kinect_v2", "azure_kinect"] = "azure_kinect"
    """Whose body tracker is simulated."""
    errors: float = 1.0
    """Factor for all errors of the tracker."""
    tracker_errors: Literal["fitted", "heavy-tailed"] = "fitted"
    """fitted: fitted to real recordings. heavy-tailed: another error model, to which nothing is fitted."""
    methods: tuple[str, ...] = ()
    """Only these methods, by their names in the tables; all but the ablations if not given."""
    ablations: bool = False
    """Add our method with one part switched off at a time."""
    processes: int = 0
    """Number of recordings processed in parallel; 0: one per processor."""
    recordings: Path | None = None
    """With --set real: a folder of real pairs NAME/a.csv, NAME/b.csv to compare with, too."""
    json: Path | None = None
    """Write all figures as JSON."""
    picture: Path | None = None
    """Draw the comparison as a PNG."""
    force: bool = False
    """Overwrite files that exist."""


@dataclass(frozen=True)
class ReplayOptions(OutputOptions):
    """Fuse a session's two skeletons again, with its own settings or with others.

    With the session's own settings S* is identical bit for bit; --verify checks this.
    """

    session: Positional[Path] = field(kw_only=True)
    """The .rrd to replay."""
    h: float | None = None
    """How much more a tracked joint counts than an inferred one; as recorded if not given."""
    method: Literal["duplex", "paper", "published"] | None = None
    """duplex: an estimator in time. paper: eqs. (10)-(13), exact bones. published: eqs. (3)-(9) as well. As
    recorded if not given."""
    smoothing: float | None = None
    """How calm the joints are, from 0 (each frame by itself) to 1; as recorded if not given."""
    weights: Literal["paper", "equal"] | None = None
    """paper: trust a joint, eqs. (10), (11). equal: both views alike. As recorded if not given."""
    verify: bool = False
    """Compare S* with the recorded S*; if a bit differs, print the first difference and exit with code 1."""
    no_viewer: bool = False
    """Do not open the viewer."""
    save: Path | None = None
    """Keep the new session, its depth images included, as an .rrd file."""


@dataclass(frozen=True)
class InfoOptions:
    """Show the contents of a session: body, frames, length, settings, calibration, size, and whether it is
    whole."""

    session: Positional[Path]
    """The .rrd to read."""


@dataclass(frozen=True)
class TrimOptions:
    """Save a time range of a session as a new session. Frames are copied; nothing is fused again."""

    session: Positional[Path]
    """The .rrd to cut."""
    save: Path
    """The .rrd to write."""
    start: Annotated[float, arg(name="from")] = 0.0
    """First moment to keep, in seconds since the first pair."""
    end: Annotated[float | None, arg(name="to")] = None
    """Last moment to keep; the end if not given."""
    force: bool = False
    """Overwrite a file that exists."""


@dataclass(frozen=True)
class CompareOptions:
    """Compare two fusions of the same capture, joint by joint and bone by bone."""

    first: Positional[Path]
    """A session."""
    second: Positional[Path]
    """Another of the same capture: a replay with other settings, say."""
    save: Path | None = None
    """Keep both S* and their difference as an .rrd file."""
    worst: int = 5
    """How many of the moments in which they differ most to list."""
    no_viewer: bool = False
    """Do not open the viewer."""
    force: bool = False
    """Overwrite a file that exists."""


@dataclass(frozen=True)
class ReviewOptions:
    """Show a saved session: the viewer, the summary, and an HTML page."""

    session: Positional[Path]
    """The .rrd to show."""
    html: Path | None = None
    """Write a self-contained page: bone lengths, jitter, trust, disagreement, calibration, timing."""
    no_viewer: bool = False
    """Do not open the viewer."""
    force: bool = False
    """Overwrite a file that exists."""


@dataclass(frozen=True)
class ExportOptions:
    """Write S* for another program: .bvh, .c3d, .csv, .npz, .parquet or .trc, by the file's ending."""

    session: Positional[Path]
    """The .rrd to export."""
    to: Path
    """The file to write."""
    table: Literal["long", "wide"] = "long"
    """Layout of a .csv: one row per joint and skeleton, or one row per frame with S* only."""
    force: bool = False
    """Overwrite a file that exists."""


@dataclass(frozen=True)
class BenchRealOptions:
    """Judge S* on recordings of real sensors without ground truth: calm, jumps, facing, registration,
    faults."""

    paths: Positional[tuple[Path, ...]]
    """Folders, each with a.csv and b.csv, or two recordings."""
    no_faults: bool = False
    """Leave out the artificial faults, which take most of the time."""
    json: Path | None = None
    """Write all figures as JSON, in SI units."""
    force: bool = False
    """Overwrite files that exist."""


@dataclass(frozen=True)
class BenchSpeedOptions:
    """Measure the time per frame on this machine: solvers, update by stages, batch and writing."""

    json: Path | None = None
    """Write all figures as JSON."""
    recording: tuple[Path, Path] | None = None
    """Recordings A and B for measuring warm starts and the update; if not given, simulated sensors."""
    force: bool = False
    """Overwrite files that exist."""
