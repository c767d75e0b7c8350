"""Reads a manifest: a CSV table of pairs of recordings."""

import csv
import re
from pathlib import Path

from devices.input_file import input_text, reading
from viewer_app.batch.finding import Pair, is_summary
from viewer_app.errors import UsageError

_NEEDED = ("name", "a", "b")
_OPTIONAL = ("skeletons_a", "skeletons_b", "person_a", "person_b")
_BAD_NAME = re.compile(r'^[. ]|[<>:"/\\|?*\x00-\x1f]|[. ]$')
"""Matches names that Windows, Linux or macOS do not allow for a folder, and names of hidden folders."""


def read_manifest(path: Path) -> list[Pair]:
    """Reads the pairs; relative paths start at the manifest's folder.

    Raises:
        UsageError: The file cannot be read, a column is missing or unknown, or a row is wrong: an empty or
            repeated name, the summary's name, or a file that does not exist. The message names the line.
    """
    try:
        with reading(path, UsageError, UsageError, "manifest"):
            text = input_text(path, "utf-8-sig")
        rows = csv.reader(text.splitlines(), strict=True)
        head = [cell.strip() for cell in next(rows, [])]
        _check_head(path, head)
        pairs: dict[str, Pair] = {}
        for row in rows:
            where = f"{path}, line {rows.line_num}"
            cells = [cell.strip() for cell in row]
            if not any(cells):
                continue
            if len(cells) != len(head):
                raise UsageError(f"{where}: {len(head)} columns are needed; got {len(cells)}.")
            pair = _pair(where, path.absolute().parent, dict(zip(head, cells, strict=True)))
            if pair.name.casefold() in pairs:
                raise UsageError(f"{where}: the name {pair.name} occurs twice.")
            pairs[pair.name.casefold()] = pair
    except (UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{path} is not a manifest: {error}.") from None
    if not pairs:
        raise UsageError(f"The manifest {path} names no pair.")
    return list(pairs.values())


def _check_head(path: Path, head: list[str]) -> None:
    missing = [name for name in _NEEDED if name not in head]
    unknown = [name for name in head if name not in (*_NEEDED, *_OPTIONAL)]
    if missing or unknown or len(set(head)) != len(head):
        raise UsageError(
            f"{path} is not a manifest: its first line must be {','.join(_NEEDED)}[,{','.join(_OPTIONAL)}]; "
            f"got {','.join(head)[:80] or 'nothing'}."
        )


def _pair(where: str, folder: Path, cells: dict[str, str]) -> Pair:
    name = cells["name"]
    if not name or _BAD_NAME.search(name):
        raise UsageError(f"{where}: {name!r} is not a name for a folder.")
    if is_summary(name):
        raise UsageError(f"{where}: {name} is the name of the summary; choose another.")

    def file(column: str) -> Path | None:
        given = cells.get(column, "")
        if not given:
            if column in _NEEDED:
                raise UsageError(f"{where}: {column} is empty.")
            return None
        path = folder / given
        if not path.is_file():
            raise UsageError(f"{where}: no file {path}.")
        return path

    a, b = file("a"), file("b")
    assert a is not None
    assert b is not None
    if a.samefile(b):
        raise UsageError(f"{where}: a and b are the same file.")
    persons = cells.get("person_a") or None, cells.get("person_b") or None
    return Pair(name, a, b, file("skeletons_a"), file("skeletons_b"), *persons)
