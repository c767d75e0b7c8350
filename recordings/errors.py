"""The errors of sessions."""

from fusion import errors
from fusion.errors import DuplexError


class RecordingError(DuplexError):
    """A session or report cannot be written or read. The message names the problem, the value and the
    remedy."""


class MissingFileError(RecordingError, FileNotFoundError):
    """There is no such file."""


class UnknownNameError(RecordingError, errors.UnknownNameError):
    """Nothing has this name; the message lists the existing names."""
