"""The errors of sessions on disk."""


class RecordingError(Exception):
    """A session or report that cannot be written or read: what happened, the value, the way out."""
