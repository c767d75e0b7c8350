"""Exports S* for other programs: chosen by the file's suffix."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Literal

from recordings.errors import RecordingError
from recordings.export.animation import Names
from recordings.export.bvh import write_bvh
from recordings.export.glb import write_glb
from recordings.export.markers import write_c3d, write_trc
from recordings.export.opensim import write_mot
from recordings.export.tables import (
    write_long_csv,
    write_npz,
    write_parquet,
    write_wide_csv,
    write_wide_parquet,
)
from recordings.session import Session

Table = Literal["long", "wide"]

Writer = Callable[[Session, Path], str]
"""Writes a session to a file and returns a description of what was written."""

_WRITERS: dict[str, Writer] = {
    ".bvh": write_bvh,
    ".c3d": write_c3d,
    ".csv": write_long_csv,
    ".glb": write_glb,
    ".mot": write_mot,
    ".npz": write_npz,
    ".parquet": write_parquet,
    ".trc": write_trc,
}
_WIDE_WRITERS: dict[str, Writer] = {".csv": write_wide_csv, ".parquet": write_wide_parquet}


def writer_for(path: Path, table: Table = "long", rate: float | None = None, names: Names = "body") -> Writer:
    """Returns the writer for the suffix of a file.

    Args:
        table: Layout of a ``.csv`` or ``.parquet``: one row per joint (``long``) or per frame (``wide``).
        rate: Frames per second of a ``.bvh``, ``.c3d`` or ``.glb``; that of the recording where None.
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
        if writer not in (write_bvh, write_c3d, write_glb):
            raise RecordingError(
                f"--rate is for .bvh, .c3d and .glb; {path.suffix} keeps the recorded times."
            )
        if not 1.0 <= rate <= 1000.0:
            raise RecordingError(f"--rate {rate:g}: a rate is 1 to 1000 frames per second.")
        options["rate"] = rate
    if names != "body":
        if writer not in (write_bvh, write_glb):
            raise RecordingError(f"--names is for .bvh and .glb; {path.suffix} has the names of the joints.")
        options["names"] = names
    if table != "long":
        if path.suffix.lower() not in _WIDE_WRITERS:
            raise RecordingError(f"--table is for .csv and .parquet; {path.suffix} has one layout.")
        writer = _WIDE_WRITERS[path.suffix.lower()]
    return partial(writer, **options) if options else writer
