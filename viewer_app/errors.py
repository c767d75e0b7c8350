"""Usage errors of the command line."""


class UsageError(Exception):
    """A command cannot run. The message states what happened, the value and the way out."""
