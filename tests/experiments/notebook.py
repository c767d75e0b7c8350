"""Runs the example notebook on a session of the demo and puts the outputs into it.

``python -m tests.experiments.notebook`` is a part of ``make pictures``. A forge and the site then show the
plots.
"""

import base64
import contextlib
import io
import json
import tempfile
from pathlib import Path

from PIL import Image

from tests.helpers.notebooks import code_cells, read_notebook, run_cells
from viewer_app.cli import main

NOTEBOOK = Path(__file__).resolve().parents[2] / "examples" / "session_in_a_notebook.ipynb"


def with_outputs(notebook, outputs):
    """The notebook with these outputs in place of its own; the cells stay as they are."""
    for number, (cell, output) in enumerate(zip(code_cells(notebook), outputs, strict=True), 1):
        cell["execution_count"] = number
        cell["outputs"] = []
        if output.printed:
            lines = output.printed.splitlines(keepends=True)
            cell["outputs"].append({"name": "stdout", "output_type": "stream", "text": lines})
        for picture in output.pictures:
            data = {"image/png": base64.b64encode(_small(picture)).decode(), "text/plain": ["<Figure>"]}
            cell["outputs"].append({"data": data, "metadata": {}, "output_type": "display_data"})
    return notebook


def _small(picture):
    """The picture with a palette, a third of the size."""
    file = io.BytesIO()
    palette = Image.open(io.BytesIO(picture)).convert("RGB").quantize(64)
    palette.save(file, "PNG", optimize=True)
    return file.getvalue()


def run():
    """Renews the outputs."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        options = ["--no-viewer", "--save"]
        main(["demo", "--seconds", "10", "--depth", "none", "--quiet", *options, "demo.rrd"])
        main(["replay", "demo.rrd", "--method", "paper", *options, "paper.rrd"])
        notebook = read_notebook(NOTEBOOK)
        outputs = run_cells(notebook, dpi=90)
    text = json.dumps(with_outputs(notebook, outputs), indent=1, ensure_ascii=False)
    NOTEBOOK.write_text(text + "\n", encoding="utf-8")
    print(f"{NOTEBOOK}: {len(outputs)} cells, {len(text) / 1e3:.0f} kB")


if __name__ == "__main__":
    run()
