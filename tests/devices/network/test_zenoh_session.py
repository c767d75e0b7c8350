"""Zenoh sessions: explicit addresses, one session per set of addresses, one line for each mistake."""

import socket
from contextlib import ExitStack

import psutil
import pytest

from devices.network.zenoh_session import ZenohAddresses, checked_key, zenoh_session
from devices.sensor import DeviceError
from tests.helpers.network import free_address
from tests.helpers.waiting import eventually

zenoh = pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install -e '.[zenoh]'")


def test_a_message_reaches_a_peer_that_opened_later():
    address, got = free_address(), []
    with ExitStack() as stack:
        early = stack.enter_context(zenoh_session(ZenohAddresses(connect=(address,))))
        late = stack.enter_context(zenoh_session(ZenohAddresses(listen=(address,))))
        late.declare_subscriber("lab/test", lambda sample: got.append(bytes(sample.payload)))

        def put():
            early.put("lab/test", b"here")
            return bool(got)

        assert eventually(put)
    assert set(got) == {b"here"}


def test_blocks_with_the_same_addresses_share_a_session():
    addresses = ZenohAddresses(listen=(free_address(),))
    with zenoh_session(addresses) as one:
        with zenoh_session(addresses) as two:
            assert one is two
        assert not one.is_closed()
    assert one.is_closed()


def test_a_session_listens_where_it_was_told_and_nowhere_else():
    address = free_address()
    before = _sockets()
    with zenoh_session(ZenohAddresses(listen=(address,))):
        opened = _sockets() - before
        assert opened == {("127.0.0.1", int(address.rpartition(":")[2]))}
    with zenoh_session(ZenohAddresses(connect=(address,))):
        assert _sockets() - before == set()


def test_a_busy_address_gives_one_line():
    address = free_address()
    with socket.socket() as other:
        other.bind(("127.0.0.1", int(address.rpartition(":")[2])))
        other.listen()
        busy = zenoh_session(ZenohAddresses(listen=(address,)))
        with pytest.raises(DeviceError, match="Zenoh cannot use") as fault:
            busy.__enter__()
    assert address in str(fault.value)
    assert "\n" not in str(fault.value)
    assert ".rs" not in str(fault.value)


@pytest.mark.parametrize("address", ["", "tcp/host", "host:7447", "http/host:1", "tcp/h:0", "tcp/h:70000"])
def test_a_wrong_address_gives_one_line(address):
    with pytest.raises(DeviceError, match=r"write tcp/HOST:PORT"):
        ZenohAddresses(listen=(address,))


@pytest.mark.parametrize("key", ["", "/a", "a/", "a//b", "a/*", "a/$*", "a b", "a?x"])
def test_a_key_with_wildcards_or_empty_names_is_refused(key):
    with pytest.raises(DeviceError, match="is not a Zenoh key"):
        checked_key(key)
    assert checked_key("lab/kinect-a") == "lab/kinect-a"


def _sockets():
    """Addresses on which this process waits for others, by TCP or UDP."""
    found = psutil.Process().net_connections(kind="inet")
    return {(c.laddr.ip, c.laddr.port) for c in found if c.status in ("LISTEN", "NONE")}
