"""Contents of a saved session, for tests of the command line."""

from recordings.file.rrd_file import RrdFile


def rows_of(path, entity):
    """Number of frames in which an entity was logged. It may consist of several parts in each frame."""
    frames = set()
    with RrdFile(path) as file:
        for of, batch in file.chunks(images=True):
            if of == entity and "frame" in batch.schema.names:
                frames.update(batch.column("frame").to_pylist())
    return len(frames)


def events_of(path):
    """The texts of all events, in order."""
    texts = []
    with RrdFile(path) as file:
        for of, batch in file.chunks(images=False):
            if of == "/events":
                for row in batch.column("TextLog:text").to_pylist():
                    texts += row
    return texts
