"""The errors of the method."""


class FusionError(Exception):
    """What the method cannot do, with the value that stopped it and the way out."""


class CalibrationError(FusionError):
    """The two sensors cannot be registered, or bone lengths cannot be measured, from these skeletons."""
