"""Compiled kernels on disk, and when they no longer fit their sources.

numba keeps a compiled kernel until the file that the kernel itself stands in changes. But a kernel holds the
code of the kernels that it calls, and the values of the constants it imports: an edit of *those* files would
go unnoticed.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path


def drop_stale_kernels(package: Path) -> None:
    """Deletes the compiled kernels of a package that are older than its newest source.

    Only an edit in place can leave a stale kernel behind, and it makes a newest source. Where the folder is
    read-only nobody edits either.

    Args:
        package: The folder of the sources.
    """
    newest = max(source.stat().st_mtime_ns for source in package.glob("*.py"))
    with suppress(OSError):
        for kernel in (package / "__pycache__").glob("*.nb[ic]"):
            with suppress(FileNotFoundError):  # another process may be doing the same
                if kernel.stat().st_mtime_ns <= newest:
                    kernel.unlink()
