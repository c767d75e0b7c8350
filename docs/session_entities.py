"""The page of a session's entities, from the list by which they are written and read."""

from recordings.data.layout import ENTITIES

_ABOUT = """# Entities of a session

Braces stand for a sensor, a joint or a limb. [The architecture](architecture.md#a-session) says more.

| entity | contents | logged | kind |
|---|---|---|---|
"""


def entities_page() -> str:
    """Markdown: a table of all entities."""
    rows = (f"| `{of.path}` | {of.what} | {of.logged} | {of.kind} |" for of in ENTITIES.values())
    return _ABOUT + "\n".join(rows).replace("S*", "S\\*") + "\n"
