"""Addresses and messages for tests of network sessions."""

from viewer_app.addresses import LOOPBACK
from viewer_app.viewer.hub import free_port


def free_address():
    """A Zenoh address on this machine that nobody listens on now."""
    return f"tcp/{LOOPBACK}:{free_port()}"
