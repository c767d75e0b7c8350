"""Usage errors of the command line."""

from fusion.errors import DuplexError


class UsageError(DuplexError):
    """A command cannot run. The message states what happened, the value and the way out.

    Whatever a command calls may raise it; :func:`viewer_app.cli.main` prints the line.
    """
