"""Sessions as ``.rrd`` files: read, write, and files that grow while a session runs."""
