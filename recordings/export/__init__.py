"""Exports S* for other programs: chosen by the file's suffix."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal

from recordings.errors import RecordingError
from recordings.export.bvh import write_bvh
from recordings.export.markers import write_c3d, write_trc
from recordings.export.tables import write_long_csv, write_npz, write_parquet, write_wide_csv
from recordings.session import Session

Table = Literal["long", "wide"]

Writer = Callable[[Session, Path], str]
"""Writes a session to a file and returns a description of what was written."""

_WRITERS: dict[str, Writer] = {
    ".bvh": write_bvh,
    ".c3d": write_c3d,
    ".csv": write_long_csv,
    ".npz": write_npz,
    ".parquet": write_parquet,
    ".trc": write_trc,
}


def writer_for(path: Path, table: Table = "long", rate: float | None = None) -> Writer:
    """Returns the writer for the suffix of a file.

    Args:
        table: Layout of a ``.csv``: one row per joint (``long``) or one row per frame (``wide``).
        rate: Frames per second of a ``.bvh`` or ``.c3d``; that of the recording where None.

    Raises:
        RecordingError: No format has this suffix, or a rate is given for one that keeps the recorded times.
    """
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise RecordingError(
            f"{path}: {path.suffix or 'no ending'} is no format to export to. Known: {', '.join(_WRITERS)}."
        )
    if rate is not None:
        if writer not in (write_bvh, write_c3d):
            raise RecordingError(f"--rate is for .bvh and .c3d; {path.suffix} keeps the recorded times.")
        if not 1.0 <= rate <= 1000.0:
            raise RecordingError(f"--rate {rate:g}: a rate is 1 to 1000 frames per second.")
        return partial(writer, rate=rate)
    return write_wide_csv if writer is write_long_csv and table == "wide" else writer
