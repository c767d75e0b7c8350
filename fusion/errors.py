"""The errors of the method."""


class DuplexError(Exception):
    """Something was asked for that cannot be done: the base of this program's errors.

    The message is one line: what happened, the value, the way out. Parameters are in backquotes, as `axes` or
    `axes=kinect`.
    """


class FusionError(DuplexError):
    """The method cannot process its input. The message states the value and a remedy."""


class BodyError(FusionError):
    """Joints of another body than the one described, or arrays that do not have its number of joints."""


class CalibrationError(FusionError):
    """The two sensors cannot be registered, or bone lengths cannot be measured, from these skeletons."""
