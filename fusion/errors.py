"""The errors of the method."""


class FusionError(Exception):
    """The method cannot process its input. The message states the value and a remedy."""


class BodyError(FusionError):
    """Joints of another body than the one described, or arrays that do not have its number of joints."""


class CalibrationError(FusionError):
    """The two sensors cannot be registered, or bone lengths cannot be measured, from these skeletons."""
