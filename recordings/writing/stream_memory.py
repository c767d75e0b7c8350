"""Frees the threads and buffers of Rerun's streams, so that a process can write many sessions.

Rerun keeps two threads and the buffers of each stream, together 1 to 4 MB, until it looks for streams that
the program no longer refers to. Only ``rr.init`` does that. ``RecordingStream.send_blueprint`` makes another
stream, which remains even then, because it is never disconnected. The functions below call the same internal
functions of Rerun as these two, which is safe as long as ``pyproject.toml`` pins Rerun's minor version.
"""

from __future__ import annotations

from typing import Any

import rerun as rr
import rerun_bindings


def free_dropped_streams() -> None:
    """Frees all disconnected streams to which the program no longer refers."""
    rerun_bindings.flush_and_cleanup_orphaned_recordings()


def send_blueprint(stream: rr.RecordingStream, blueprint: Any) -> None:
    """Sends a layout, as ``stream.send_blueprint`` does, but the stream that it makes can be freed.

    The layout is made the active one; otherwise a viewer restores the layout that it remembers.

    Args:
        stream: Receives the layout.
        blueprint: The layout of the viewer, anything that Rerun takes as such.
    """
    application = rr.get_application_id(stream)
    assert application is not None
    layout = rr.RecordingStream._from_native(
        rerun_bindings.new_blueprint(application, make_default=False, make_thread_default=False)
    )
    layout.set_time("blueprint", sequence=0)
    blueprint.to_blueprint()._log_to_stream(layout)
    storage = layout.memory_recording().storage
    rerun_bindings.send_blueprint(storage, make_active=True, make_default=True, recording=stream.to_native())
    layout.disconnect()
