"""Logs a session to a stream of Rerun, which leads to a viewer or a file."""
