"""Options of the commands on saved sessions: replay, info, trim, compare, review, export."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from viewer_app.options.shared import LiveOutputOptions, OutputOptions, SummaryOptions


@dataclass(frozen=True)
class ReplayOptions(LiveOutputOptions, SummaryOptions, OutputOptions):
    """Fuse a session's two skeletons again, with its own settings or with others.

    With the session's own settings S* is identical bit for bit; --verify checks this.
    """

    session: Annotated[Positional[Path], arg(metavar="SESSION")] = field(kw_only=True)
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
    pace: Literal["fast", "live"] = "fast"
    """fast: as fast as possible. live: at the recorded times, for --vmc and other outputs."""
    listen: str | None = None
    """With --websocket or --lsl: the address of this machine to listen on, also for other machines."""


@dataclass(frozen=True)
class InfoOptions:
    """Show the contents of a session: body, frames, length, settings, calibration, size, and whether it is
    whole."""

    session: Annotated[Positional[Path], arg(metavar="SESSION")]
    """The .rrd to read."""


@dataclass(frozen=True)
class TrimOptions:
    """Save a time range of a session as a new session. Frames are copied; nothing is fused again."""

    session: Annotated[Positional[Path], arg(metavar="SESSION")]
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
class CompareOptions(SummaryOptions):
    """Compare two fusions of the same capture, joint by joint and bone by bone."""

    first: Annotated[Positional[Path], arg(metavar="FIRST")] = field(kw_only=True)
    """A session."""
    second: Annotated[Positional[Path], arg(metavar="SECOND")] = field(kw_only=True)
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
class ReviewOptions(SummaryOptions):
    """Show a saved session: a summary, its events, the viewer at one of them, and an HTML page."""

    session: Annotated[Positional[Path], arg(metavar="SESSION")] = field(kw_only=True)
    """The .rrd to show."""
    event: int | None = None
    """Open the viewer at the event of this number. If neither this nor --at is given: at the first warning
    after the calibration, else where a view first had left and right exchanged, else at the beginning."""
    at: float | None = None
    """Open the viewer at this time, in seconds since the first pair."""
    html: Path | None = None
    """Write a self-contained page: bone lengths, jitter, trust, disagreement, calibration, timing."""
    no_viewer: bool = False
    """Do not open the viewer."""
    force: bool = False
    """Overwrite a file that exists."""


@dataclass(frozen=True)
class ExportOptions:
    """Write S* for another program: .bvh, .c3d, .csv, .npz, .parquet or .trc, by the file's ending."""

    session: Annotated[Positional[Path], arg(metavar="SESSION")]
    """The .rrd to export."""
    to: Path
    """The file to write."""
    table: Literal["long", "wide"] = "long"
    """Layout of a .csv: one row per joint and skeleton, or one row per frame with S* only."""
    force: bool = False
    """Overwrite a file that exists."""
