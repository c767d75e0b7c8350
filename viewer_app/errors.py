"""Usage errors of the command line."""


class UsageError(Exception):
    """A command cannot run. The message states what happened, the value and the way out.

    Whatever a command calls may raise it; :func:`viewer_app.cli.main` prints the line.
    """


def mistakes() -> tuple[type[Exception], ...]:
    """The errors of one line for the person who asked. Imported on demand: not every command needs them."""
    from devices.sensor import DeviceError
    from fusion.errors import FusionError
    from recordings.errors import RecordingError

    return (DeviceError, FusionError, RecordingError, UsageError)
