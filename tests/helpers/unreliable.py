"""Generators that fail as libraries do; a child process imports this module."""

import os
import threading

from devices.sensor import DeviceError


def counts(most):
    """Numbers, also printed by a library."""
    for k in range(most):
        os.write(1, b"a greeting\n")
        yield k


def crashes():
    yield "first"
    os.abort()


def fails():
    yield "first"
    raise KeyError("a fault of the reader")


def never_ends(*_):
    threading.Event().wait()
    yield


def hoards():
    yield bytes(1 << 40)


def refuses():
    yield "first"
    raise DeviceError("it is no recording")


def reads_its_input():
    yield os.read(0, 1)


def tells_its_process():
    yield os.getpid()
    threading.Event().wait()
