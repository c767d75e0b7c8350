"""What stands in a saved session, for tests that ask only whether it can be read."""

from __future__ import annotations

from pathlib import Path

import rerun as rr


def rows_of(path: Path, entity: str) -> int:
    """In how many frames an entity was logged; it may be in several parts in each."""
    frames: set[int] = set()
    for chunk in rr.chunk.RrdReader(path).stream():
        if chunk.entity_path == entity and not chunk.is_static:
            frames.update(chunk.to_record_batch().column("frame").to_pylist())
    return len(frames)


def events_of(path: Path) -> list[str]:
    """The texts of all events, in order."""
    texts: list[str] = []
    for chunk in rr.chunk.RrdReader(path).stream():
        if chunk.entity_path == "/events":
            for row in chunk.to_record_batch().column("TextLog:text").to_pylist():
                texts += row
    return texts
