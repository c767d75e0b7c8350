"""Runs the cells of a Jupyter notebook in this process, without Jupyter."""

import contextlib
import io
import json
from dataclasses import dataclass

import matplotlib.pyplot as plt


@dataclass(frozen=True)
class CellOutput:
    """What a cell gave.

    Attributes:
        printed: Its text.
        pictures: Its figures as PNG files.
    """

    printed: str
    pictures: tuple[bytes, ...]


def read_notebook(path):
    """The notebook as JSON."""
    return json.loads(path.read_text(encoding="utf-8"))


def code_cells(notebook):
    """The cells with code, in their order."""
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run_cells(notebook, dpi=72):
    """Runs all cells with code one after the other, in the current folder."""
    plt.switch_backend("Agg")
    names = {"__name__": "__main__"}
    outputs = []
    for cell in code_cells(notebook):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec("".join(cell["source"]), names)
        pictures = []
        for number in plt.get_fignums():
            file = io.BytesIO()
            plt.figure(number).savefig(file, format="png", dpi=dpi)
            pictures.append(file.getvalue())
        plt.close("all")
        outputs.append(CellOutput(printed.getvalue(), tuple(pictures)))
    return outputs
