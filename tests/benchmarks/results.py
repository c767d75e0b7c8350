"""The figures that each benchmark leaves, as JSON beside this module.

``python -m tests.benchmarks.page`` makes ``docs/benchmarks.md`` from them.
"""

import json
import math
import os
import platform
import shlex
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from fusion.setup import REVISIONS

FOLDER = Path(__file__).parent / "results"
_LOAD = round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None  # before the benchmark adds to it


def write(name, figures):
    """Writes the figures of a benchmark, with the command and the machine they come from.

    Args:
        name: Name of the file without its ending.
        figures: Numbers in SI units unless a name says otherwise; NaN becomes null.
    """
    module = sys.modules["__main__"].__spec__
    document = {
        "command": shlex.join(["python", "-m", module.name if module else name, *sys.argv[1:]]),
        "version": version("duplex-kinects"),
        "revision": REVISIONS["duplex"],
        "date": datetime.now(UTC).date().isoformat(),
        "machine": {
            "system": platform.system(),
            "architecture": platform.machine(),
            "processors": os.cpu_count(),
            "load": _LOAD,
            "python": platform.python_version(),
            **{package: version(package) for package in ("numpy", "numba", "rerun-sdk")},
        },
        "figures": _plain(figures),
    }
    FOLDER.mkdir(exist_ok=True)
    text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False)
    (FOLDER / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def read(name):
    """Returns the document that :func:`write` wrote."""
    return json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))


def quiet(document):
    """Whether a benchmark began on a machine with an idle processor, so that its wall-clock times count."""
    load = document["machine"]["load"]
    return load is None or load < 0.5 * document["machine"]["processors"]


def _plain(value):
    """Dictionaries and lists with floats of six digits."""
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value
