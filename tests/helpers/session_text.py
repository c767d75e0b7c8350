"""Contents of a saved session, for tests of the command line."""

from recordings.file.rrd_file import RrdFile


def logged_in(path, entity, component=None):
    """The frames in which an entity, or a component of it, was logged, each with its value."""
    found = []
    with RrdFile(path) as file:
        for of, batch in file.chunks(images=True):
            names = batch.schema.names
            if of == entity and "frame" in names and (component is None or component in names):
                columns = (batch.column(name).to_pylist() for name in ("frame", component or "frame"))
                found += zip(*columns, strict=True)
    return found


def rows_of(path, entity):
    """Number of frames in which an entity was logged. It may consist of several parts in each frame."""
    return len({frame for frame, _ in logged_in(path, entity)})


def events_of(path):
    """The texts of all events, in order."""
    texts = []
    with RrdFile(path) as file:
        for of, batch in file.chunks(images=False):
            if of == "/events":
                for row in batch.column("TextLog:text").to_pylist():
                    texts += row
    return texts
