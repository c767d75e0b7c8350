"""Fusion of recordings and of live sensors into frames that a session records."""
