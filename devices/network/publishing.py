"""Publishes a sensor's frames over Zenoh, describes the sensor and answers for this machine's clock."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

from devices.capture.sensor_state import SensorState
from devices.capture.sensor_thread import SensorThread
from devices.events import Event
from devices.network.messages import (
    MOST_PEOPLE,
    ClockMessage,
    FrameMessage,
    MalformedError,
    SensorMessage,
    decode_clock,
    encode_clock,
    encode_frame,
    encode_sensor,
)
from devices.network.remote_sensor import CLOCK, FRAMES, SENSOR
from devices.network.zenoh_session import ZenohAddresses, checked_key, first_words, load_zenoh, zenoh_session
from devices.sensor import DeviceError, Sensor, SensorFrame

_LARGEST_REQUEST = 256  # bytes; a clock request has 56
_POLL_S = 0.05


class FramePublisher:
    """Publishes frames under a key. Use it as a context manager; ``publish`` never blocks.

    Attributes:
        session: The number of this run; every run has a different one.
        published: Frames so far.
        bytes_sent: Bytes so far.
        requests: Clock requests that were answered.
        malformed: Requests that were ignored.
        most_people: The largest number of people in a frame; 16 of them are sent.
    """

    def __init__(
        self,
        key: str,
        addresses: ZenohAddresses,
        sensor: Sensor,
        *,
        interval_ns: int = 33_333_333,
        depth: bool = False,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self.session = secrets.randbits(64)
        self.published = self.bytes_sent = self.requests = self.malformed = self.most_people = 0
        self._key, self._addresses, self._depth, self._clock = checked_key(key), addresses, depth, clock
        self._description = encode_sensor(
            SensorMessage(self.session, sensor.name, sensor.body, sensor.intrinsics, interval_ns)
        )
        self._stack = ExitStack()
        self._publisher: Any = None

    def __enter__(self) -> FramePublisher:
        zenoh = load_zenoh()
        session = self._stack.enter_context(zenoh_session(self._addresses))
        declare = self._stack.enter_context
        # A full queue drops frames: an old skeleton is worth less than the next one. Express frames are not
        # held back to be sent together with others.
        self._publisher = declare(
            session.declare_publisher(
                f"{self._key}/{FRAMES}",
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
                express=True,
            )
        )
        declare(session.declare_queryable(f"{self._key}/{SENSOR}", self._describe))
        declare(session.declare_queryable(f"{self._key}/{CLOCK}", self._answer))
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._stack.close()

    def publish(self, frame: SensorFrame) -> None:
        """Sends a frame to all current subscribers.

        Raises:
            DeviceError: Zenoh cannot send, for example because its session was closed.
        """
        if not self._depth:
            frame = replace(frame, depth=None)
        message = encode_frame(FrameMessage(self.session, self.published, frame, self._clock()))
        try:
            self._publisher.put(message)
        except load_zenoh().ZError as fault:
            raise DeviceError(f"Zenoh cannot send under {self._key!r}: {first_words(str(fault))}.") from fault
        self.published += 1
        self.most_people = max(self.most_people, len(frame.people))
        self.bytes_sent += len(message)

    def _describe(self, query: Any) -> None:
        with query:
            query.reply(f"{self._key}/{SENSOR}", self._description)

    def _answer(self, query: Any) -> None:
        came_ns = self._clock()
        with query:
            payload = query.payload
            try:
                if payload is None or len(payload) > _LARGEST_REQUEST:
                    raise MalformedError("No clock request.")
                asked_ns = decode_clock(payload.to_bytes()).asked_ns
            except MalformedError:
                self.malformed += 1
                return
            self.requests += 1
            reply = ClockMessage(self.session, asked_ns, came_ns, self._clock())
            query.reply(f"{self._key}/{CLOCK}", encode_clock(reply))


def publish_until(
    thread: SensorThread,
    publisher: FramePublisher,
    stopped: threading.Event,
    tell: Callable[[Event], None] = lambda _: None,
) -> None:
    """Publishes an open sensor's frames until it ends or ``stopped`` is set.

    Raises:
        DeviceError: A fault of the program or of a driver inside the sensor.
    """
    told = False
    while not stopped.is_set():
        ended = thread.state is SensorState.ENDED
        thread.arrival.wait(0.0 if ended else _POLL_S)
        thread.arrival.clear()
        for arrival in thread.take():
            publisher.publish(arrival.frame)
        for event in thread.events():
            tell(event)
        if publisher.most_people > MOST_PEOPLE and not told:
            told = True
            text = (
                f"{thread.sensor.name} sees {publisher.most_people} people; {MOST_PEOPLE} of them are sent."
            )
            tell(Event(text, "WARN", time_ns=time.perf_counter_ns()))
        if ended:
            return
