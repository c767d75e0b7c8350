"""The errors of the method."""


class DuplexError(Exception):
    """The base of this program's errors: what was asked for cannot be done.

    The message is one line: what happened, the value, and what to do. Parameters are in backquotes, as `axes`
    or `axes=kinect`.
    """


class FusionError(DuplexError):
    """The method cannot process its input. The message states the value and a remedy."""


class BodyError(FusionError):
    """The joints are those of another body, or an array has the wrong number of joints."""


class CalibrationError(FusionError):
    """The two sensors cannot be registered, or bone lengths cannot be measured, from these skeletons."""
