"""Options of the commands on saved sessions: replay, info, trim, compare, review, export."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Group, Parameter

from viewer_app.options.shared import (
    ARGUMENT,
    EXPERTS,
    METHOD,
    OUTPUTS,
    VIEWER,
    WHOLE_NUMBER,
    GoodOptions,
    LiveOutputOptions,
    OutputOptions,
    OwnFileOptions,
    SummaryOptions,
    WebOptions,
)

MOTION_CAPTURE = Parameter(group=Group("Motion capture", sort_key=2))


@dataclass(frozen=True, kw_only=True)
class ReplayOptions(LiveOutputOptions, SummaryOptions, OutputOptions):
    """Fuse a session's two skeletons again, with its own settings or with others.

    With the session's own settings and the revision of the method that it records, S* is identical bit for
    bit; --verify checks this.
    """

    session: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """The .rrd to replay."""
    h: Annotated[float | None, EXPERTS] = None
    """How much more a tracked joint counts than an inferred one. If not given, as recorded."""
    method: Annotated[Literal["duplex", "paper", "published"] | None, METHOD] = None
    """duplex: an estimator in time. paper: eqs. (10)-(13), exact bones. published: eqs. (3)-(9) as well. As
    recorded if not given."""
    smoothing: Annotated[float | None, METHOD] = None
    """Smoothing of S*, from 0 (each frame on its own) to 1 (strongest). If not given, as recorded."""
    weights: Annotated[Literal["paper", "equal"] | None, EXPERTS] = None
    """paper: trust a joint, eqs. (10), (11). equal: both views alike. As recorded if not given."""
    verify: bool = False
    """Compare S* with the recorded S*. If a bit differs, print the first difference and exit with code 1."""
    no_viewer: Annotated[bool, VIEWER] = False
    """Do not open the viewer."""
    save: Annotated[Path | None, OUTPUTS] = None
    """Keep the new session, its depth images included, as an .rrd file."""
    pace: Annotated[Literal["fast", "live"], OUTPUTS] = "fast"
    """fast: as fast as possible. live: at the recorded times, for --vmc and other outputs."""
    listen: Annotated[str | None, OUTPUTS] = None
    """With --websocket or --lsl: the address of this machine to listen on, also for other machines."""


@dataclass(frozen=True, kw_only=True)
class InfoOptions(OwnFileOptions):
    """Show what is in a file.

    Of a session: body, frames, settings, calibration, and whether it is whole. Of a recording or of motion
    capture: format, joints, people, rate, gaps, unit, what is ignored, and the command that reads it.
    """

    file: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """The file to read: .rrd, .csv, .json, .skeleton, .mkv, .bag, .db3, .c3d or .trc."""


@dataclass(frozen=True, kw_only=True)
class TrimOptions(GoodOptions):
    """Save a time range or the good seconds of a session as a new session. Frames are copied and
    not fused again."""

    session: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """The .rrd to cut."""
    save: Path
    """The .rrd to write."""
    start: Annotated[float, Parameter(name="--from")] = 0.0
    """First moment to keep, in seconds since the first pair."""
    end: Annotated[float | None, Parameter(name="--to")] = None
    """Last moment to keep. If not given, the end."""
    force: bool = False
    """Overwrite a file that exists."""


@dataclass(frozen=True, kw_only=True)
class CompareOptions(SummaryOptions):
    """Compare a session with motion capture, or with another fusion of the same capture."""

    first: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """A session."""
    second: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """Motion capture of the same movement, .c3d, .trc or .csv; or another session of the same capture: a
    replay with other settings, say."""
    names: Annotated[Path | None, MOTION_CAPTURE] = None
    """Which points of the file are joints: a TOML table, or plug-in-gait, gait2392, mixamo or bodies. The
    one of these that finds most joints if not given."""
    offset: Annotated[float | None, MOTION_CAPTURE] = None
    """Seconds to add to the file's times. If not given, found from the motion."""
    html: Annotated[Path | None, OUTPUTS] = None
    """Write a self-contained page: distances and how they change; of motion capture also angles, of two
    sessions also how good both are."""
    report: Annotated[Path | None, MOTION_CAPTURE] = None
    """Write all figures as JSON."""
    save: Annotated[Path | None, OUTPUTS] = None
    """Keep the skeletons and their difference as an .rrd file."""
    any_capture: bool = False
    """Also compare sessions of different captures: each frame with the nearest in time since the first."""
    worst: Annotated[int | None, WHOLE_NUMBER] = None
    """Of two sessions: how many of the moments at which they differ most to list. If not given, 5."""
    no_viewer: Annotated[bool, VIEWER] = False
    """Do not open the viewer."""
    force: Annotated[bool, OUTPUTS] = False
    """Overwrite a file that exists."""


@dataclass(frozen=True, kw_only=True)
class ReviewOptions(WebOptions, SummaryOptions):
    """Show a saved session: a summary, its events, the viewer at one of them, and an HTML page."""

    session: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """The .rrd to show."""
    event: Annotated[int | None, VIEWER, WHOLE_NUMBER] = None
    """Open the viewer at the event of this number. If neither this nor --at is given: at the first warning
    after the calibration, else where a view first had left and right exchanged, else at the beginning."""
    at: Annotated[float | None, VIEWER] = None
    """Open the viewer at this time, in seconds since the first pair."""
    layout: Annotated[Literal["setup", "inspect", "report", "angles"] | None, VIEWER] = None
    """Which of the viewer's tabs is open at first. If not given, that with which the session was written."""
    html: Annotated[Path | None, OUTPUTS] = None
    """Write a self-contained page: bone lengths, jitter, trust, disagreement, calibration, timing."""
    force: Annotated[bool, OUTPUTS] = False
    """Overwrite a file that exists."""


@dataclass(frozen=True, kw_only=True)
class ExportOptions(GoodOptions):
    """Write S* for another program: .bvh, .c3d, .csv, .glb, .mcap (ROS 2), .mot, .npz, .parquet or .trc, by
    the file's ending."""

    session: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """The .rrd to export."""
    to: Path
    """The file to write."""
    table: Literal["long", "wide"] = "long"
    """Layout of a .csv or .parquet: one row per joint and skeleton, or one row per frame with S* and its
    angles."""
    rate: float | None = None
    """Frames per second of a .bvh, .c3d, .glb, .mot or .trc. If not given, that of the recording."""
    names: Literal["body", "humanoid", "mixamo"] = "body"
    """Names of bones in a .bvh or .glb: those of the joints, of Unity's humanoid, or of Mixamo."""
    feet: Literal["planted", "free"] = "planted"
    """Feet in a .bvh or .glb: planted where they stand, so that they neither slide nor sink, or as in S*."""
    force: bool = False
    """Overwrite a file that exists."""
