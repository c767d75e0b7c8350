"""Addresses for tests of network sessions."""

from __future__ import annotations

import socket


def free_address() -> str:
    """A Zenoh address on this machine that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def free_port() -> int:
    """A TCP port of this machine that nobody listens on now."""
    return int(free_address().rpartition(":")[2])
