"""Output files that are either complete or absent."""

import json
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from devices.output_file import Hidden, real_path, whole_file
from devices.sensor import IMAGE_SUFFIXES
from viewer_app.errors import UsageError

SESSION = ".rrd"
"""Ending of a session's name; other endings do not open in a viewer."""
_made: list[Path] = []
_claimed: dict[Path, Hidden] = {}
_LITTLE_FREE = 500_000_000  # bytes; a session with depth images takes about 300 MB per minute


def check_writable(path: Path, force: bool) -> None:
    """Checks before the work that a file can be written.

    Raises:
        UsageError: The file exists and `force` is not set, or its folder is missing or read-only.
    """
    try:
        there = path.exists()
    except OSError as error:
        raise UsageError(f"{path} is not a valid file name: {error.strerror or error}.") from None
    if path.is_dir():
        raise UsageError(f"{path} is a folder; name a file.")
    if there and not path.is_file():
        raise UsageError(f"{path} is not a regular file; name another.")
    if there and not force:
        raise UsageError(f"{path} exists already. Choose another name, or overwrite it with --force.")
    if not path.parent.is_dir():
        raise UsageError(f"No folder {path.parent} to write {path.name} into.")
    if not os.access(path.parent, os.W_OK):
        raise UsageError(f"The folder {path.parent} is not writable.")


def check_page(path: Path | None) -> None:
    """Checks the ending of a page, which a browser opens by it.

    Raises:
        UsageError: Another ending, such as that of a PDF, which a browser prints from the page.
    """
    if path is not None and path.suffix.lower() not in (".html", ".htm"):
        page = path.with_suffix(".html").name
        raise UsageError(
            f"--html {path}: the name must end in .html, as in {page}. A browser prints it as a PDF."
        )


def warn_of_little_room(path: Path, console: Console, little: int = _LITTLE_FREE) -> None:
    """Warns if what is saved there, of unknown length, may fill the disk: if few bytes are free."""
    free = shutil.disk_usage(path.parent).free
    if free < little:
        console.print(
            f"[yellow]Only {free / 1e6:.0f} MB are free where {escape(str(path))} is saved.[/] When that is "
            "full, saving waits for room and everything else continues."
        )


def check_outputs(
    outputs: Iterable[Path | None], inputs: Iterable[Path], force: bool, session: Path | None = None
) -> None:
    """:func:`check_writable` for the session and all other files that a command will write.

    Raises:
        UsageError: As there; or two outputs are one file, or an output is an input, or the session's name
            does not end in ``.rrd``; or another process is writing one of them.
    """
    outputs = [session, *outputs]
    taken = {os.path.realpath(path): f"is also read, as {path}" for path in inputs}
    for path in filter(None, outputs):
        real = os.path.realpath(path)
        if real in taken:
            raise UsageError(f"{path} cannot be written: it {taken[real]}. Choose another name.")
        taken[real] = "is to be written twice"
        check_writable(path, force)
    if session is not None and session.suffix.lower() != SESSION:
        example = session.with_suffix(SESSION).name
        raise UsageError(f"--save {session}: a session's name must end in {SESSION}, as in {example}.")
    for path in filter(None, outputs):
        claim(path)


def export_files(path: Path) -> list[Path]:
    """The files that an export to a path writes, after :func:`make_folder` where they are in one."""
    from recordings.export import files_of

    files = files_of(path)
    if path not in files:
        make_folder(path)
    return files


@contextmanager
def outputs_of_one_run() -> Iterator[None]:
    """Within the block, :func:`check_outputs` keeps other processes from writing the same files.

    At the end it removes the folders of :func:`make_folder` that are empty.
    """
    before, made = set(_claimed), len(_made)
    try:
        yield
    finally:
        for path in _claimed.keys() - before:
            _claimed.pop(path).remove()
        while len(_made) > made:
            with suppress(OSError):
                _made.pop().rmdir()


def make_folder(folder: Path) -> None:
    """Makes a folder for files, with those above it.

    Raises:
        UsageError: It cannot be made, or is a file, or would be mistaken for one.
    """
    like_a_file = folder.suffix.lower() in (SESSION, *IMAGE_SUFFIXES)
    try:
        if folder.is_file() or (like_a_file and not folder.exists()):
            raise UsageError(f"{folder} is the name of a file; name a folder, for several files.")
        _made.extend(each for each in (*reversed(folder.parents), folder) if not each.exists())
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise UsageError(f"The folder {folder} cannot be created: {fault.strerror or fault}.") from None


def claim(path: Path) -> None:
    """Keeps other processes from writing a file until :func:`outputs_of_one_run` ends.

    Raises:
        UsageError: Another one is writing it.
    """
    try:
        path = real_path(path)
        if path not in _claimed:
            _claimed[path] = Hidden(path, shared=True)
    except BlockingIOError:
        raise UsageError(f"{path} is being written by another process. Choose another name.") from None
    except OSError as error:
        raise UsageError(f"{path} could not be written: {error.strerror or error}.") from None


def write_text(path: Path, text: str, force: bool) -> None:
    """Writes a text file that is either complete or absent."""
    with whole_file(path, overwrite=force) as hidden:
        hidden.write_text(text, encoding="utf-8")


def save_report(path: Path | None, figures: dict[str, Any], force: bool) -> None:
    """Writes a report as standard JSON, if there is a path; an unfinished file is never left behind."""
    if path is not None:
        text = json.dumps(figures, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
        write_text(path, text, force)
