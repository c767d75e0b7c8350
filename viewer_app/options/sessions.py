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

    With the session's own settings and the same revision of the method, S* is identical bit for bit. --verify
    checks this.
    """

    session: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """The .rrd to replay."""
    h: Annotated[float | None, EXPERTS] = None
    """How much more a tracked joint counts than an inferred one. If not given, as recorded."""
    method: Annotated[Literal["duplex", "paper", "published"] | None, METHOD] = None
    """duplex: an estimator over time. paper: eqs. (10)-(13) with exact bones. published: also eqs. (3)-(9).
    If not given, as recorded."""
    smoothing: Annotated[float | None, METHOD] = None
    """Smoothing of S*, from 0 (each frame on its own) to 1 (strongest). If not given, as recorded."""
    weights: Annotated[Literal["paper", "equal"] | None, EXPERTS] = None
    """paper: weight joints by trust, eqs. (10) and (11). equal: weight both views equally. If not given, as
    recorded."""
    verify: bool = False
    """Compare S* with the recorded S*. If a bit differs, print the first difference and exit with code 1."""
    no_viewer: Annotated[bool, VIEWER] = False
    """Do not open the viewer."""
    save: Annotated[Path | None, OUTPUTS] = None
    """Save the new session as an .rrd file, including its depth images."""
    pace: Annotated[Literal["fast", "live"], OUTPUTS] = "fast"
    """fast: as fast as possible. live: at the recorded times, for --vmc and other outputs."""
    listen: Annotated[str | None, OUTPUTS] = None
    """With --websocket or --lsl: the address of this machine on which to accept connections from other
    machines."""


@dataclass(frozen=True, kw_only=True)
class InfoOptions(OwnFileOptions):
    """Show what is in a file.

    For a session: body, frames, settings, calibration, and whether it is whole. For a recording or motion
    capture: format, joints, people, rate, gaps, unit, what is ignored, and the command that reads it.
    """

    file: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """The file to read: .rrd, .csv, .json, .skeleton, .mkv, .bag, .db3, .c3d, .trc or .tsv."""


@dataclass(frozen=True, kw_only=True)
class TrimOptions(GoodOptions):
    """Save a time range or the good seconds of a session as a new session. Frames are copied, not fused
    again."""

    session: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """The .rrd to cut."""
    save: Path
    """The .rrd to write."""
    start: Annotated[float, Parameter(name="--from")] = 0.0
    """First moment to keep, in seconds since the first pair."""
    end: Annotated[float | None, Parameter(name="--to")] = None
    """Last moment to keep. If not given, the end."""
    force: bool = False
    """Overwrite an existing file."""


@dataclass(frozen=True, kw_only=True)
class CompareOptions(SummaryOptions):
    """Compare a session with motion capture, or with another fusion of the same capture."""

    first: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """A session."""
    second: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """Motion capture of the same movement (.c3d, .trc, .csv or .tsv), or another session of the same capture,
    such as a replay with other settings."""
    names: Annotated[Path | None, MOTION_CAPTURE] = None
    """Which points in the file are joints: a TOML table, or plug-in-gait, gait2392, mixamo or bodies. If not
    given, the one of these that finds the most joints."""
    offset: Annotated[float | None, MOTION_CAPTURE] = None
    """Seconds to add to the file's times. If not given, found from the motion."""
    html: Annotated[Path | None, OUTPUTS] = None
    """Write a self-contained page with the distances over time. For motion capture, it also shows angles; for
    two sessions, the quality of both."""
    report: Annotated[Path | None, MOTION_CAPTURE] = None
    """Write all figures as JSON."""
    save: Annotated[Path | None, OUTPUTS] = None
    """Save the skeletons and their differences as an .rrd file."""
    any_capture: bool = False
    """Also compare sessions of different captures, by the time since their first frames."""
    worst: Annotated[int | None, WHOLE_NUMBER] = None
    """For two sessions: how many moments of largest difference to list. If not given, 5."""
    no_viewer: Annotated[bool, VIEWER] = False
    """Do not open the viewer."""
    force: Annotated[bool, OUTPUTS] = False
    """Overwrite an existing file."""


@dataclass(frozen=True, kw_only=True)
class ReviewOptions(WebOptions, SummaryOptions):
    """Show a saved session: print its summary and events, open the viewer, or write an HTML page."""

    session: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """The .rrd to show."""
    event: Annotated[int | None, VIEWER, WHOLE_NUMBER] = None
    """Open the viewer at the event with this number. If neither this nor --at is given, it opens at the first
    warning after the calibration, otherwise at the first exchange of left and right in a view, otherwise at
    the beginning."""
    at: Annotated[float | None, VIEWER] = None
    """Open the viewer at this time, in seconds since the first pair."""
    layout: Annotated[Literal["setup", "inspect", "report", "angles"] | None, VIEWER] = None
    """The viewer tab that is open at first. If not given, the tab with which the session was written."""
    html: Annotated[Path | None, OUTPUTS] = None
    """Write a self-contained page with bone lengths, jitter, trust, disagreement, calibration and timing."""
    force: Annotated[bool, OUTPUTS] = False
    """Overwrite an existing file."""


@dataclass(frozen=True, kw_only=True)
class ExportOptions(GoodOptions):
    """Write S* for another program. The file's ending chooses the format: .bvh, .c3d, .csv, .glb, .mcap (ROS
    2), .mot, .npz, .parquet or .trc. A name without one is a folder for OpenSim, with set-ups."""

    session: Annotated[Path, ARGUMENT] = field(kw_only=False)
    """The .rrd to export."""
    to: Path
    """The file to write, or the folder."""
    table: Literal["long", "wide"] = "long"
    """Layout of a .csv or .parquet: one row per joint and skeleton, or one row per frame with S* and its
    angles."""
    sigma: bool = False
    """Add one standard deviation of each value of S* to a .csv or .parquet."""
    rate: float | None = None
    """Frames per second of a .bvh, .c3d, .glb, .mot, .trc or folder. If not given, that of the recording."""
    names: Literal["body", "humanoid", "mixamo", "ue5", "rigify"] = "body"
    """Bone names in a .bvh or .glb: those of the joints, of Unity's humanoid, of Mixamo, of Unreal Engine 5
    and MetaHumans, or of Blender's Rigify."""
    feet: Literal["planted", "free"] = "planted"
    """Feet in a .bvh or .glb: planted, so that they hardly slide where they stand, or as in S*."""
    force: bool = False
    """Overwrite an existing file."""
