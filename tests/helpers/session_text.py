"""Contents of a saved session, for tests of the command line."""

from pathlib import Path

from recordings.file.rrd_file import RrdFile


def rows_of(path: Path, entity: str) -> int:
    """Number of frames in which an entity was logged. It may consist of several parts in each frame."""
    frames: set[int] = set()
    with RrdFile(path) as file:
        for of, batch in file.chunks(images=True):
            if of == entity and "frame" in batch.schema.names:
                frames.update(batch.column("frame").to_pylist())
    return len(frames)


def events_of(path: Path) -> list[str]:
    """The texts of all events, in order."""
    texts: list[str] = []
    with RrdFile(path) as file:
        for of, batch in file.chunks(images=False):
            if of == "/events":
                for row in batch.column("TextLog:text").to_pylist():
                    texts += row
    return texts
