"""Files that are either whole or not there."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from viewer_app.errors import UsageError


def check_writable(path: Path, force: bool) -> None:
    """Finds out before the work, not after it, that a file could not be written.

    Raises:
        UsageError: The file exists and `force` is not set, or its folder is missing or read-only.
    """
    if path.is_dir():
        raise UsageError(f"{path} is a folder; name a file.")
    if path.exists() and not force:
        raise UsageError(f"{path} exists already. Choose another name, or overwrite it with --force.")
    if not path.parent.is_dir():
        raise UsageError(f"No folder {path.parent} to write {path.name} into.")
    if not os.access(path.parent, os.W_OK):
        raise UsageError(f"The folder {path.parent} is not writable.")


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path], force: bool) -> None:
    """:func:`check_writable` for all files that a command will write.

    Raises:
        UsageError: As there; or two outputs are one file, or an output is an input.
    """
    taken = {path.resolve(): f"is also read, as {path}" for path in inputs}
    for path in filter(None, outputs):
        if path.resolve() in taken:
            raise UsageError(f"{path} cannot be written: it {taken[path.resolve()]}. Choose another name.")
        taken[path.resolve()] = "is to be written twice"
        check_writable(path, force)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Gives a temporary name beside `path`, renamed to it when all went well and removed when not."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        yield partial
        partial.replace(path)
    except OSError as error:
        raise UsageError(f"{path} could not be written: {error.strerror or error}.") from error
    finally:
        partial.unlink(missing_ok=True)
