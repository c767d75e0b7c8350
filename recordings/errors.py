"""The errors of sessions."""

from collections.abc import Sequence

from fusion.errors import DuplexError


class RecordingError(DuplexError):
    """A session or report cannot be written or read. The message names the problem, the value and the
    remedy."""


class MissingFileError(RecordingError, FileNotFoundError):
    """There is no such file."""


class UnknownNameError(RecordingError, KeyError):
    """Nothing has this name; the message lists the existing names."""

    def __init__(self, what: str, name: object, known: Sequence[str]) -> None:
        super().__init__(f"There is no {what} {name!r}. Choose one of {', '.join(known)}.")

    __str__ = Exception.__str__  # a KeyError's shows the message in quotes
