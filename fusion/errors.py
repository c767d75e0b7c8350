"""The errors of the method."""

from collections.abc import Iterable


class DuplexError(Exception):
    """The base of this program's errors: what was asked for cannot be done.

    The message is one line: what happened, the value, and what to do. Parameters are in backquotes, as `axes`
    or `axes=kinect`.
    """


class FusionError(DuplexError):
    """The method cannot process its input. The message states the value and a remedy."""


class UnknownNameError(FusionError, KeyError):
    """Nothing has this name; the message lists the existing names."""

    def __init__(self, what: str, name: object, known: Iterable[str]) -> None:
        super().__init__(f"There is no {what} {name!r}. Choose one of {', '.join(known)}.")

    __str__ = Exception.__str__  # a KeyError's shows the message in quotes


class BodyError(FusionError):
    """The joints are those of another body, or an array has the wrong number of joints."""


class CalibrationError(FusionError):
    """The two sensors cannot be registered, or bone lengths cannot be measured, from these skeletons."""
