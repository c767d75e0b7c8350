"""The chart of ``duplex bench accuracy``: MPJPE of each method, by movement."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from viewer_app.bench.accuracy_tables import methods_of
from viewer_app.bench.accuracy_trials import Outcome
from viewer_app.output_files import whole_file


def draw(outcomes: list[Outcome], path: Path) -> None:
    """Writes the chart as a PNG.

    Raises:
        UsageError: The file cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    motions = list(dict.fromkeys(o.trial.motion for o in outcomes))
    methods = methods_of(outcomes)
    colors = matplotlib.colormaps["tab20"](np.arange(len(methods)) % 20)
    figure, axes = pyplot.subplots(figsize=(10.0, 4.2), dpi=110, layout="constrained")
    width = 0.8 / len(methods)
    for k, method in enumerate(methods):
        by_motion = [
            1e3
            * np.array([o.figures["mpjpe"] for o in outcomes if o.method == method and o.trial.motion == m])
            for m in motions
        ]
        axes.bar(
            np.arange(len(motions)) + (k - (len(methods) - 1) / 2) * width,
            [values.mean() for values in by_motion],
            width,
            yerr=[values.std() for values in by_motion],
            error_kw={"elinewidth": 0.7, "ecolor": "#555555"},
            color=colors[k],
            label=method,
        )
    axes.set_xticks(np.arange(len(motions)), motions)
    axes.set_ylabel("MPJPE (mm)")
    axes.set_title("Distance from the true joints, by movement (error bars: SD over angles and seeds)")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(ncols=min(len(methods), 6), frameon=False, fontsize=9, loc="outside lower center")
    with whole_file(path) as partial:
        figure.savefig(partial, format="png")
    pyplot.close(figure)
