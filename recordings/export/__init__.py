"""Exports S* for other programs: chosen by the file's suffix."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, get_args

from recordings.errors import RecordingError, UnknownNameError
from recordings.export.animation import Names as Names
from recordings.export.bvh import write_bvh
from recordings.export.glb import write_glb
from recordings.export.markers import write_c3d, write_trc
from recordings.export.opensim import write_mot
from recordings.export.tables import Table as Table
from recordings.export.tables import write_csv, write_npz, write_parquet
from recordings.session_series import SessionSeries

Writer = Callable[[SessionSeries, Path], str]
"""Writes a session to a file and returns a description of what was written."""

_WRITERS: dict[str, Writer] = {
    ".bvh": write_bvh,
    ".c3d": write_c3d,
    ".csv": write_csv,
    ".glb": write_glb,
    ".mot": write_mot,
    ".npz": write_npz,
    ".parquet": write_parquet,
    ".trc": write_trc,
}


def writer_for(path: Path, table: Table = "long", rate: float | None = None, names: Names = "body") -> Writer:
    """Returns the writer for the suffix of a file.

    Args:
        table: Layout of a ``.csv`` or ``.parquet``: one row per joint (``long``) or per frame (``wide``).
        rate: Frames per second. None: that of the recording.
        names: Names of the bones of a ``.bvh`` or ``.glb``: the body's, of Unity's humanoid, or Mixamo's.

    Raises:
        RecordingError: No format has this suffix, or an option is given for one that has no use for it.
    """
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise RecordingError(
            f"{path}: {path.suffix or 'no ending'} is no format to export to. Known: {', '.join(_WRITERS)}."
        )
    options: dict[str, Any] = {}
    if rate is not None:
        if writer not in (write_bvh, write_c3d, write_glb, write_mot, write_trc):
            raise RecordingError(
                f"`rate` is for .bvh, .c3d, .glb, .mot and .trc; {path.suffix} keeps the recorded times."
            )
        if not 1.0 <= rate <= 1000.0:
            raise RecordingError(f"`rate` is {rate:g}; a rate is 1 to 1000 frames per second.")
        options["rate"] = rate
    if names != "body":
        if writer not in (write_bvh, write_glb):
            raise RecordingError(f"`names` is for .bvh and .glb; {path.suffix} has the names of the joints.")
        if names not in get_args(Names):
            raise UnknownNameError("convention of names", names, get_args(Names))
        options["names"] = names
    if table != "long":
        if writer not in (write_csv, write_parquet):
            raise RecordingError(f"`table` is for .csv and .parquet; {path.suffix} has one layout.")
        options["layout"] = table
    return partial(writer, **options) if options else writer
