"""Finds the pairs of recordings in a folder."""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from devices.sensor import IMAGE_SUFFIXES, MKV
from devices.skeletons.file_sensor import READERS
from viewer_app.errors import UsageError, refuse_bytes

PAGE, TABLE = "summary.html", "summary.parquet"
"""The summary, which lies beside the sessions' folders; no session can have these names."""
SUFFIXES = (*IMAGE_SUFFIXES, *READERS)
"""Formats of recordings; if a pair exists in several, the first is taken."""


@dataclass(frozen=True)
class Pair:
    """Two recordings of one capture."""

    name: str  # name of the session; a valid and unique folder name
    a: Path  # absolute paths of the recordings
    b: Path
    skeletons_a: Path | None = None  # for an .mkv: saved skeletons; None: the body tracker
    skeletons_b: Path | None = None
    person_a: str | None = None  # ids of the person; None: the person seen longest
    person_b: str | None = None

    @property
    def files(self) -> tuple[Path, ...]:
        """The input files."""
        return tuple(filter(None, (self.a, self.b, self.skeletons_a, self.skeletons_b)))


def find_pairs(folder: Path, out: Path) -> tuple[list[Pair], list[str]]:
    """Finds the pairs in a folder and its subfolders.

    A pair is ``a.EXT`` and ``b.EXT``, named after their folder, or ``NAME_a.EXT`` and ``NAME_b.EXT``. The
    names of subfolders precede the name. For two ``.mkv`` the skeleton files of the same names are their
    skeletons. Hidden folders and the output folder are not searched.

    Returns:
        The pairs by name, and a line for each recording without a partner.

    Raises:
        UsageError: No pair is found, two pairs have the same name, or a pair has the name of the summary.
    """
    found: dict[str, Pair] = {}
    alone: list[str] = []
    known = {os.path.realpath(folder), os.path.realpath(out)}
    for at, folders, files in os.walk(folder, followlinks=True):
        here = Path(at)
        folders[:] = [name for name in sorted(folders) if _is_new(here / name, known)]
        for stem, suffixes in sorted(_sides(files).items()):
            pair, missing = _pair(folder, here, stem, suffixes)
            alone += missing
            if pair is None:
                continue
            for file in pair.files:
                refuse_bytes(str(file))
            if is_summary(pair.name):
                raise UsageError(f"{pair.a} would be session {pair.name}, which is the name of the summary.")
            other = found.get(pair.name.casefold())
            if other is not None:
                raise UsageError(
                    f"{other.a} and {pair.a} would both be session {pair.name}. Name them in a manifest."
                )
            found[pair.name.casefold()] = pair
    if not found:
        raise UsageError(
            f"{folder} has no pair of recordings: neither a.csv and b.csv, nor NAME_a.csv and NAME_b.csv "
            f"(or {', '.join(suffix for suffix in SUFFIXES if suffix != '.csv')}), also not in subfolders."
        )
    return sorted(found.values(), key=lambda pair: pair.name), alone


def is_summary(name: str) -> bool:
    """Whether a session's folder of this name would take the place of the summary."""
    return name.casefold() in (PAGE, TABLE)


def _is_new(folder: Path, known: set[str]) -> bool:
    """Whether a folder is to be searched: not hidden, and not searched before through another link."""
    real = os.path.realpath(folder)
    if folder.name.startswith(".") or real in known:
        return False
    known.add(real)
    return True


def _sides(files: Iterable[str]) -> dict[str, dict[str, dict[str, str]]]:
    """File names by stem without the side, by suffix, and by side."""
    sides: dict[str, dict[str, dict[str, str]]] = {}
    for file in sorted(files):
        if file.startswith("."):  # macOS keeps a file's attributes in ._NAME on the disks of others
            continue
        stem, suffix = Path(file).stem, Path(file).suffix
        rest, separator, side = stem.rpartition("_")
        if suffix.lower() in SUFFIXES and side.lower() in ("a", "b") and (rest or not separator):
            sides.setdefault(rest, {}).setdefault(suffix.lower(), {})[side.lower()] = file
    return sides


def _pair(
    folder: Path, here: Path, stem: str, suffixes: dict[str, dict[str, str]]
) -> tuple[Pair | None, list[str]]:
    """The pair of a stem, and a line for each file that is alone if there is no pair."""
    parts = [*here.relative_to(folder).parts, *filter(None, [stem])]
    whole = [suffix for suffix in SUFFIXES if len(suffixes.get(suffix, {})) == 2]
    if not whole:
        files = [file for of_suffix in suffixes.values() for file in of_suffix.values()]
        return None, [f"{here / file} has no partner and is skipped." for file in files]
    skeletons: dict[str, Path | None] = {"a": None, "b": None}
    if whole[0] == MKV:
        for side in skeletons:
            saved = [suffixes[s][side] for s in READERS if side in suffixes.get(s, {})]
            skeletons[side] = here / saved[0] if saved else None
    a, b = (here / suffixes[whole[0]][side] for side in "ab")
    return Pair("_".join(parts) or folder.name or "pair", a, b, skeletons["a"], skeletons["b"]), []
