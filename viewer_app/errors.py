"""What a person did that the program cannot follow."""


class UsageError(Exception):
    """A command that cannot be carried out: what happened, the value, the way out."""
