"""Exports S* for other programs: chosen by the file's suffix."""

from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, get_args

from recordings.errors import RecordingError, UnknownNameError
from recordings.session_series import SessionSeries

Table = Literal["long", "wide"]
"""One row per joint, skeleton and frame, or one per frame."""
Names = Literal["body", "humanoid", "mixamo", "ue5", "rigify"]
Feet = Literal["planted", "free"]
"""Kept on the floor, see :mod:`recordings.planted_feet`, or as in S*."""
Writer = Callable[..., str]
"""Writes a session to the files of :func:`files_of`, and returns a description of what was written."""
FILES = "fused.trc", "fused.mot", "markers.xml", "scale.xml", "inverse_kinematics.xml"
"""Of a folder for OpenSim."""
_FOLDER = "a folder"

_MODULES = {  # with ``write_…``; imported when one is asked for
    ".bvh": "bvh",
    ".c3d": "markers",
    ".csv": "tables",
    ".glb": "glb",
    ".mcap": "ros",
    ".mot": "opensim",
    ".npz": "tables",
    ".parquet": "tables",
    ".trc": "markers",
    _FOLDER: "opensim_setup",
}
_PACKAGES = {
    ".c3d": (("ezc3d",), "export"),
    ".glb": (("pygltflib",), "export"),
    ".mcap": (("rosbags.typesys", "mcap.writer"), "ros"),
}
"""What some formats need, and the extra that has it."""
_AS_RECORDED = ".csv", ".mcap", ".npz", ".parquet"
"""Formats with the bones of each frame; others have one skeleton."""
_OPTIONS = {
    "rate": (None, (".bvh", ".c3d", ".glb", ".mot", ".trc", _FOLDER), "keeps the recorded times"),
    "names": ("body", (".bvh", ".glb"), "has the names of the joints"),
    "feet": ("planted", (".bvh", ".glb"), "has those of S*"),
    "table": ("long", (".csv", ".parquet"), "has one layout"),
    "sigma": (False, (".csv", ".parquet"), "has no such columns"),
}
"""Of some writers: the default, the formats that have it, and why others do not."""


def writer_for(
    path: Path,
    table: Table = "long",
    rate: float | None = None,
    names: Names = "body",
    feet: Feet = "planted",
    sigma: bool = False,
) -> Writer:
    """Returns the writer for the suffix of a file, or for a folder, whose name has none.

    Args:
        table: Layout of a ``.csv`` or ``.parquet``: one row per joint (``long``) or per frame (``wide``).
        rate: Frames per second. None: that of the recording.
        names: Names of the bones of a ``.bvh`` or ``.glb``: the body's, or those of Unity's humanoid,
            Mixamo, Unreal (``ue5``) or Blender's Rigify.
        feet: Of a ``.bvh`` or ``.glb``: ``planted`` where they stand, or as in S* (``free``).
        sigma: Whether a ``.csv`` or ``.parquet`` has one standard deviation of each value of S*.

    Raises:
        RecordingError: No format has this suffix, it needs a package that is not installed, or an option is
            given for one that has no use for it.
    """
    suffix = path.suffix.lower() or _FOLDER
    if suffix not in _MODULES:
        raise RecordingError(
            f"{path}: {path.suffix} is no format to export to. Known: {', '.join(_MODULES)} (for OpenSim)."
        )
    options: dict[str, Any] = {}
    for name, given in zip(_OPTIONS, (rate, names, feet, table, sigma), strict=True):
        default, formats, otherwise = _OPTIONS[name]
        if given != default:
            if suffix not in formats:
                known = f"{', '.join(formats[:-1])} and {formats[-1]}"
                raise RecordingError(f"`{name}` is for {known}; {path.suffix or _FOLDER} {otherwise}.")
            options[name] = given
    if not 1.0 <= options.get("rate", 1.0) <= 1000.0:
        raise RecordingError(f"`rate` is {rate:g}; a rate is 1 to 1000 frames per second.")
    if names not in get_args(Names):
        raise UnknownNameError("convention of names", names, get_args(Names))
    if feet not in get_args(Feet):
        raise UnknownNameError("way of feet", feet, get_args(Feet))
    check_packages(suffix)
    name = f"write_{suffix.split()[-1].strip('.')}"
    writer = getattr(import_module(f"recordings.export.{_MODULES[suffix]}"), name)
    from recordings.export.bones import written

    return partial(written, partial(writer, **options), suffix not in _AS_RECORDED)


def files_of(path: Path) -> list[Path]:
    """The files that an export to a path writes: this one, or those in a folder."""
    return [path] if path.suffix else [path / name for name in FILES]


def export(session: SessionSeries, path: Path, write: Writer, overwrite: bool) -> str:
    """Writes the files of :func:`files_of`, none if the writer fails, and returns its description.

    Raises:
        OutputError: They could not be written, or one exists and `overwrite` is not set.
    """
    from devices.output_file import whole_file

    files = files_of(path)
    if path not in files:
        with suppress(OSError):  # whole_file says why there is no folder
            path.mkdir()
    with ExitStack() as whole:
        return write(session, *[whole.enter_context(whole_file(file, overwrite=overwrite)) for file in files])


def check_packages(suffix: str) -> None:
    """Imports what a format needs, before hours of work after which its absence would be of no use."""
    packages, extra = _PACKAGES.get(suffix, ((), ""))
    for package in packages:
        try:
            import_module(package)
        except ImportError as fault:
            from devices.check import extra_command

            name = package.partition(".")[0]
            raise RecordingError(
                f"Writing {suffix} needs the package {name}: {extra_command(extra)}."
            ) from fault
