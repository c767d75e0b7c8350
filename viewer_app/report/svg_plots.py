"""Plots as SVG inside a page, in the page's text colour.

The plots use matplotlib, whose SVG needs no script, so that a page is small and safe to open. Plotly would
add 4 MB of script to each page, Bokeh 1 MB.
"""

import io
import re
from collections.abc import Mapping, Sequence
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from recordings.appearance.colors import PREDICTED_COLOR, SIDE_COLORS, SKELETON_COLORS, Color

_INK = "#010203"  # placeholder for the page's text colour
_POINTS_PER_INCH = 120  # of the width of a plot: about one point per pixel
_TRUST_COLUMNS, _BAND_POINTS = 600, 240
_DASHES = (0, (3, 1.5))
_WIDE = 11.0  # inches, of a plot across the page
_MARGINS = 0.8, 0.5, 0.1, 0.3  # inches: left, bottom, right, top
_LONGEST_JOINED = 0.3  # seconds between two values that a line joins
Line = tuple[NDArray[Any], str]


def line_plot(
    title: str,
    unit: str,
    time: NDArray[Any],
    lines: Mapping[str, Line],
    levels: Sequence[float] = (),
    logarithmic: bool = False,
    wide: bool = False,
    sigma: Mapping[str, NDArray[Any]] | None = None,
    beyond: tuple[float, float] = (-np.inf, np.inf),
) -> str:
    """Plots values over seconds; each line has the key of a skeleton or side. Levels are dashed.

    Args:
        sigma: (T,) one standard deviation of each line, drawn as a band.
        beyond: Values outside of these two are marked with crosses.
    """
    width = _WIDE if wide else 6.0
    figure, axes = _figure(width, 2.4)
    pauses = np.flatnonzero(np.diff(time) > _LONGEST_JOINED) + 1
    time = np.insert(time, pauses, time[pauses - 1])
    for name, (values, key) in lines.items():
        known = np.insert(np.asarray(values, dtype=np.float64), pauses, np.nan)
        joined = _joined(time, known)
        if sigma is not None:
            band = _band(time[joined], known[joined], np.insert(sigma[name], pauses, np.nan)[joined])
            axes.fill_between(*band, color=line_color(key), alpha=0.25, linewidth=0)
        shown = joined[_thinned(known[joined], int(width * _POINTS_PER_INCH))]
        thick = 1.6 if key in ("fused", *SIDE_COLORS) else 0.8
        dashes = _DASHES if key == "right" else "-"
        axes.plot(
            time[shown], known[shown], color=line_color(key), linewidth=thick, linestyle=dashes, label=name
        )
        outside = shown[(known[shown] < beyond[0]) | (known[shown] > beyond[1])]
        if len(outside):
            axes.plot(time[outside], known[outside], "x", color=_INK, markersize=5, zorder=3)
    for level in levels:
        axes.axhline(level, color=_INK, linewidth=0.9, linestyle=(0, (5, 4)))
    if logarithmic and any(np.any(values > 0.0) for values, _ in lines.values()):
        _use_decades(axes)
    _ticks(axes, in_degrees=unit == "°")
    axes.set_title(title, fontsize=10, loc="left", color=_INK)
    axes.set_xlabel("s")
    axes.set_ylabel(unit)
    if len(lines) > 1:
        _legend(axes, len(lines))
    return _svg(figure, f"{title}, {unit}, over time", wide)


def cycle_plot(title: str, curves: Mapping[str, NDArray[Any]], toe_offs: Mapping[str, float]) -> str:
    """Plots degrees over the gait cycle, from heel strike to heel strike: mean and standard deviation.

    Args:
        curves: (C, 101) by side.
        toe_offs: Share of the cycle at which the foot leaves the floor, by side; a dotted line.
    """
    figure, axes = _figure(4.0, 2.6)
    percent = np.arange(101)
    for side, each in curves.items():
        known = each[np.isfinite(each).all(axis=1)]
        if not len(known):
            continue
        mean, deviation = known.mean(axis=0), known.std(axis=0, ddof=min(1, len(known) - 1))
        band = mean - deviation, mean + deviation
        axes.fill_between(percent, *band, color=line_color(side), alpha=0.2, linewidth=0)
        dashes = _DASHES if side == "right" else "-"
        axes.plot(percent, mean, color=line_color(side), linewidth=1.6, linestyle=dashes, label=side)
        if np.isfinite(toe_offs[side]):
            axes.axvline(100.0 * toe_offs[side], color=line_color(side), linewidth=0.9, linestyle=(0, (1, 2)))
    axes.axhline(0.0, color=_INK, linewidth=0.5)
    axes.set_xlim(0, 100)
    _ticks(axes, in_degrees=True)
    axes.set_title(title, fontsize=10, loc="left", color=_INK)
    axes.set_xlabel("% of the gait cycle")
    axes.set_ylabel("°")
    _legend(axes, 3)
    return _svg(figure, f"{title}, degrees, over the gait cycle")


def bar_plot(unit: str, names: Sequence[str], bars: Mapping[str, Line]) -> str:
    """Plots one group of bars per name."""
    figure, axes = _figure(_WIDE, 3.2, named=True)
    at, width = np.arange(len(names)), 0.8 / len(bars)
    for k, (name, (values, key)) in enumerate(bars.items()):
        axes.bar(
            at + (k - (len(bars) - 1) / 2) * width,
            np.nan_to_num(values),
            width,
            color=skeleton_color(key),
            label=name,
        )
    axes.set_xticks(at, names, rotation=60, ha="right", fontsize=8)
    axes.set_ylabel(unit)
    _legend(axes, len(bars))
    return _svg(figure, f"{', '.join(bars)}, {unit}, of each joint", wide=True)


def trust_map(time: NDArray[Any], names: Sequence[str], share: NDArray[Any]) -> str:
    """Plots the share of A (T, J), one row per joint: from A's colour over that of S* to B's, grey
    without data."""
    from matplotlib.colors import LinearSegmentedColormap

    figure, axes = _figure(_WIDE, 0.16 * len(names) + 1.0, named=True)
    mean = _columns_of_time(time, share)
    ramp = [skeleton_color(key) for key in ("b", "fused", "a")]
    colors = LinearSegmentedColormap.from_list("trust", ramp).with_extremes(bad=_css(PREDICTED_COLOR))
    extent = (float(time[0]), float(time[-1]) or 1.0, len(names) - 0.5, -0.5)
    image = axes.imshow(
        mean.T, aspect="auto", cmap=colors, vmin=0.0, vmax=1.0, extent=extent, interpolation="none"
    )
    axes.set_yticks(np.arange(len(names)), names, fontsize=7)
    axes.set_xlabel("s")
    bar = figure.colorbar(image, ax=axes, pad=0.01, ticks=[0.0, 0.5, 1.0])
    bar.ax.set_yticklabels(["B", "both", "A"], fontsize=8, color=_INK)
    bar.ax.tick_params(color=_INK)
    return _svg(figure, "share of A in the trust, of each joint, over time", wide=True)


def _columns_of_time(time: NDArray[Any], share: NDArray[Any]) -> NDArray[np.float64]:
    """(columns, J) means of (T, J) over equal time spans; NaN without a frame within 0.15 s."""
    if len(time) < 2:
        return np.asarray(share, dtype=np.float64)
    edges = np.linspace(time[0], time[-1], _TRUST_COLUMNS + 1)
    column = np.clip(np.searchsorted(edges, time, side="right") - 1, 0, _TRUST_COLUMNS - 1)
    counted = np.isfinite(share)
    total, count = np.zeros((2, _TRUST_COLUMNS, share.shape[1]))
    np.add.at(total, column, np.where(counted, share, 0.0))
    np.add.at(count, column, counted)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    # columns narrower than a frame take the nearer of two frames
    middle = (edges[:-1] + edges[1:]) / 2
    after = np.clip(np.searchsorted(time, middle), 1, len(time) - 1)
    nearest = np.where(middle - time[after - 1] <= time[after] - middle, after - 1, after)
    empty = np.bincount(column, minlength=_TRUST_COLUMNS) == 0
    near = np.abs(time[nearest] - middle) <= 0.5 * _LONGEST_JOINED
    mean[empty & near] = share[nearest[empty & near]]
    return np.asarray(mean)


def _legend(axes: Any, columns: int) -> None:
    """Places the legend above the plot, where it covers no curve."""
    axes.legend(
        fontsize=8,
        frameon=False,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        borderaxespad=0.2,
        ncols=columns,
        labelcolor=_INK,
    )


def _figure(width: float, height: float, named: bool = False) -> tuple[Any, Any]:
    """A figure with one plot; the names of joints need as much space as they have letters."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height))
    axes = figure.add_subplot()
    if named:  # it draws twice, and places each text four times
        figure.set_layout_engine("constrained")
    else:
        left, bottom, right, top = np.divide(_MARGINS, (width, height) * 2)
        figure.subplots_adjust(left, bottom, 1.0 - right, 1.0 - top)
    axes.patch.set_visible(False)
    axes.tick_params(colors=_INK, labelsize=9)
    axes.grid(axis="y", color=_INK, alpha=0.15, linewidth=0.6)
    axes.set_axisbelow(True)
    for part in (axes.xaxis.label, axes.yaxis.label):
        part.set_color(_INK)
    for name, spine in axes.spines.items():
        spine.set_color(_INK)
        spine.set_visible(name in ("left", "bottom"))
    return figure, axes


def _svg(figure: Any, label: str, wide: bool = False) -> str:
    from matplotlib import rc_context

    out = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": label, "font.family": "sans-serif"}):
        figure.savefig(out, format="svg", transparent=True, metadata={"Date": None})
    svg = out.getvalue()
    svg = svg[svg.index("<svg") :].replace(_INK, "currentColor")
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
    # ids are shared by the whole page, so each plot gets unique ones
    own = f"p{crc32((label + svg).encode()):x}"
    svg = re.sub(r'\bid="', f'id="{own}-', svg)
    svg = re.sub(r"url\(#", f"url(#{own}-", svg)
    svg = re.sub(r'href="#', f'href="#{own}-', svg)
    kind = ' class="wide"' if wide else ""
    return f'<figure{kind} role="img" aria-label="{label}">{svg}</figure>'


def line_color(key: str) -> str:
    """The colour of a skeleton, or of the person's left or right side, as CSS and SVG write it."""
    return _css({**SKELETON_COLORS, **SIDE_COLORS}[key])


def skeleton_color(key: str) -> str:
    """The colour of a skeleton as CSS and SVG write it."""
    return _css(SKELETON_COLORS[key])


def _css(color: Color) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color)


def _ticks(axes: Any, in_degrees: bool) -> None:
    """Ticks at whole steps; of degrees at multiples of 15, 30, 45 or 90, for a range of 30 at least."""
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 2, 5, 10]))
    if not in_degrees:
        return
    low, high = axes.get_ylim()
    more = max(0.0, 30.0 - (high - low)) / 2.0
    axes.set_ylim(low - more, high + more)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 1.5, 3, 4.5, 6, 9, 10]))


def _use_decades(axes: Any) -> None:
    """A logarithmic axis of whole decades, with plain numbers: 0.1, 0.2, 0.5, 1 …"""
    from matplotlib.ticker import LogLocator

    axes.set_yscale("log")
    low, high = np.log10(axes.get_ylim())
    axes.set_ylim(10.0 ** np.floor(low), 10.0 ** np.ceil(high))
    steps = LogLocator(subs=(1.0, 2.0, 5.0) if high - low < 3.0 else (1.0,))
    axes.yaxis.set(major_locator=steps, major_formatter="{x:g}", minor_formatter="")


def _band(time: NDArray[Any], values: NDArray[Any], sigma: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Times, lower and upper ends of a band of one standard deviation; of spans, its extremes.

    What is unknown is a span of its own.
    """
    even = np.linspace(0, len(time), _BAND_POINTS, endpoint=False).astype(np.intp)
    changes = np.flatnonzero(np.diff(np.isnan(values))) + 1
    starts = np.union1d(even, changes)
    low, high = values - sigma, values + sigma
    return time[starts], np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def _joined(time: NDArray[Any], values: NDArray[Any]) -> NDArray[np.intp]:
    """The indices without the unknown values between known ones that are near in time, so that a line joins
    them: one sensor may have half the frames of the other."""
    known = np.isfinite(values)
    at = np.flatnonzero(known)
    after = np.searchsorted(at, np.arange(len(values)))
    between = ~known & (after > 0) & (after < len(at))
    after = after[between]
    kept = np.ones(len(values), dtype=bool)
    kept[between] = time[at[after]] - time[at[after - 1]] > _LONGEST_JOINED
    return np.flatnonzero(kept)


def _thinned(values: NDArray[Any], most: int) -> NDArray[np.intp]:
    """The indices of minimum and maximum of each span, so that no peak is lost, and of its first unknown
    value, else a line would join what is apart."""
    if len(values) <= most:
        return np.arange(len(values))
    span, unknown = np.arange(len(values)) * (most // 2) // len(values), np.isnan(values)
    starts = np.flatnonzero(np.diff(span, prepend=-1))
    least, greatest, first = (np.lexsort((key, span))[starts] for key in (values, -values, ~unknown))
    return np.unique(np.concatenate([least, greatest, first[unknown[first]]]))
