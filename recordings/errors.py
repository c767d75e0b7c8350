"""The errors of sessions on disk."""


class RecordingError(Exception):
    """A session or report cannot be written or read. The message names the problem, the value and the
    remedy."""
