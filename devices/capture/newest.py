"""Frames that come on a thread of their own, for a reader that is slower than they come."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import TypeVar

Item = TypeVar("Item")


def newest(
    items: Iterator[Item], name: str, *, drop: Callable[[], object], interrupt: Callable[[], object]
) -> Iterator[Item]:
    """The newest item each time; the iterator runs on its own thread, whatever the reader does meanwhile.

    Args:
        name: Of the thread.
        drop: Called for each item that the reader did not get, because a newer one came.
        interrupt: Makes ``items`` end soon; called when the reader ends first.

    Raises:
        Exception: What ``items`` raised, after the item before it.
    """
    waiting: deque[Item] = deque(maxlen=1)
    ended, fault, came = False, None, threading.Condition()

    def run() -> None:
        nonlocal ended, fault
        try:
            for item in items:
                with came:
                    if waiting:
                        drop()
                    waiting.append(item)
                    came.notify()
        except BaseException as raised:
            fault = raised
        with came:
            ended = True
            came.notify()

    thread = threading.Thread(target=run, name=name, daemon=True)  # a driver may hang
    thread.start()
    try:
        while True:
            with came:
                came.wait_for(lambda: waiting or ended)
                item = waiting.pop() if waiting else None
            if item is None:
                break
            yield item
    finally:
        if not ended:
            interrupt()
            thread.join()
    if fault is not None:
        raise fault
