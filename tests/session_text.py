"""What stands in a saved session, for tests that ask only whether it can be read."""

from __future__ import annotations

from pathlib import Path

import rerun as rr


def rows_of(path: Path, entity: str) -> int:
    """How many times an entity was logged."""
    chunks = rr.chunk.RrdReader(path).stream()
    return sum(c.num_rows for c in chunks if c.entity_path == entity and not c.is_static)


def events_of(path: Path) -> list[str]:
    """The texts of all events, in order."""
    texts: list[str] = []
    for chunk in rr.chunk.RrdReader(path).stream():
        if chunk.entity_path == "/events":
            for row in chunk.to_record_batch().column("TextLog:text").to_pylist():
                texts += row
    return texts
