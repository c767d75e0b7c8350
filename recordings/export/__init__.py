"""Exports S* for other programs: chosen by the file's suffix."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from recordings.errors import RecordingError
from recordings.export.bvh import write_bvh
from recordings.export.markers import write_c3d, write_trc
from recordings.export.tables import write_long_csv, write_npz, write_parquet, write_wide_csv
from recordings.session import Session

Table = Literal["long", "wide"]

Writer = Callable[[Session, Path], str]
"""Writes a session to a file and returns a description of what was written."""

_WRITERS: MappingProxyType[str, Writer] = MappingProxyType(
    {
        ".bvh": write_bvh,
        ".c3d": write_c3d,
        ".csv": write_long_csv,
        ".npz": write_npz,
        ".parquet": write_parquet,
        ".trc": write_trc,
    }
)


def writer_for(path: Path, table: Table = "long") -> Writer:
    """Returns the writer for the suffix of a file.

    Args:
        path: The file.
        table: Layout of a ``.csv``: one row per joint (``long``) or one row per frame (``wide``).

    Raises:
        RecordingError: No format has this suffix.
    """
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise RecordingError(
            f"{path}: {path.suffix or 'no ending'} is no format to export to. Known: {', '.join(_WRITERS)}."
        )
    return write_wide_csv if writer is write_long_csv and table == "wide" else writer
