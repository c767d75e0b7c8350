"""Addresses of this machine."""

from __future__ import annotations

LOOPBACK = "127.0.0.1"
"""Reaches this machine, and only from itself."""


def in_url(host: str) -> str:
    """A host as URLs write it: an IPv6 address in brackets."""
    return f"[{host}]" if ":" in host else host


def reached_at(listening: str) -> str:
    """The host, as in a URL, at which this machine reaches its own server that listens on an address."""
    return in_url({"0.0.0.0": LOOPBACK, "::": "::1"}.get(listening, listening))
