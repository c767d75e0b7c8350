"""Options of ``duplex batch``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from viewer_app.options.shared import FusionOptions, RecordingOptions, TrackerOptions


@dataclass(frozen=True)
class BatchOptions(TrackerOptions, RecordingOptions, FusionOptions):
    """Fuse many pairs of recordings, in parallel; a second call goes on where the first one stopped.

    In FOLDER and its subfolders, a pair is a.EXT and b.EXT, or NAME_a.EXT and NAME_b.EXT, where EXT is csv,
    json, skeleton or mkv. Saved skeletons beside an .mkv of the same name are used instead of the body
    tracker. Or a manifest: a .csv with the columns name,a,b[,skeletons_a,skeletons_b,person_a,person_b].

    The exit code is 1 if a pair could not be fused.
    """

    source: Annotated[Positional[Path], arg(metavar="SOURCE")] = field(kw_only=True)
    """A folder of recordings, or a manifest (.csv) with paths relative to its own folder."""
    out: Path = field(kw_only=True)
    """Folder for the sessions, one subfolder each, and the summary (summary.html, summary.parquet)."""
    processes: int = 0
    """How many recordings are fused at the same time on this machine; 0: one per processor."""
    scheduler: str | None = None
    """Address of a Dask scheduler, tcp://HOST:PORT, whose workers fuse. They must see the same paths as this
    machine."""
    pages: bool = False
    """Write a page per session, as duplex review --html does; takes longer than fusion."""
    force: bool = False
    """Fuse again, and overwrite, sessions that were fused from other recordings, with other options or by
    another version."""
