"""Fuses recordings and live sensors into the frames of a session."""
