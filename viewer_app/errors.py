"""Usage errors of the command line."""

from fusion.errors import DuplexError


class UsageError(DuplexError):
    """A command cannot run. The message states what happened, the value and the way out.

    Whatever a command calls may raise it; :func:`viewer_app.cli.main` prints the line.
    """


def refuse_bytes(name: str) -> None:
    """Refuses a name that is not UTF-8, which no session, table or page can hold.

    Raises:
        UsageError: It is such a name.
    """
    try:
        name.encode()
    except UnicodeEncodeError:
        raise UsageError(f"{ascii(name)[1:-1]} is not UTF-8: rename it.") from None
