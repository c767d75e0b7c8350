"""S* for other programs: one module a format, chosen by the file's ending."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from recordings.errors import RecordingError
from recordings.export.bvh import write_bvh
from recordings.export.c3d import write_c3d
from recordings.export.tables import write_long_csv, write_npz, write_parquet, write_wide_csv
from recordings.export.trc import write_trc
from recordings.session import Session

Table = Literal["long", "wide"]

Writer = Callable[[Session, Path], str]
"""Writes a session into a file and returns in words what it wrote."""

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
    """What writes a session into a file of this ending.

    Args:
        path: The file.
        table: Of a ``.csv``: a row a joint, or a row a frame.

    Raises:
        RecordingError: No format has this ending.
    """
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise RecordingError(
            f"{path}: {path.suffix or 'no ending'} is no format to export to. Known: {', '.join(_WRITERS)}."
        )
    return write_wide_csv if writer is write_long_csv and table == "wide" else writer
