"""The command line as values: a command is a frozen dataclass; its field docstrings are the help text.

The folder imports nothing slow, so that ``duplex --help`` answers at once.
"""
