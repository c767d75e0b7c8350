"""The figures of a report in words: lines and tables that the terminal and the page share.

The verdict with what to do, what S* is expected to be off, how well the two views agree, and how much of the
data had to be repaired: these lines lead. All other figures follow on request.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from devices.findings.finding import capital, in_words, spoken
from recordings.quality.figures import Figures
from recordings.quality.verdict import DOUBT_WORDS, doubt, verdict
from viewer_app.flags import in_flags

_PAUSED = 0.9  # of the time: with less there are pauses
_SOME_TIME = 0.5  # seconds
_LENGTH_FROM = {
    "other side": "as long as on the other side",
    "proportions": "by an adult's proportions",
    "file": "as the calibration file says",
}
"""Of bones that no view shows: where their lengths are from."""
_MICROMETRE = 1e-3  # millimetres; what a file stores of S* is no more exact


@dataclass(frozen=True)
class Line:
    """One line of a report."""

    label: str  # the subject, one or two words
    text: str  # the figure and what it means
    warning: bool = False  # whether someone should act on it
    figure: str = ""  # the figure alone, where the line has one that matters; else empty
    rest: str = ""  # the text beside this figure


def lead_lines(figures: Figures) -> Iterator[Line]:
    """The lines that lead every report."""
    if "fused_frames" in figures:
        found = figures["verdict"]
        word = found["word"]
        sentence = in_flags(in_words(**found))
        rest = sentence.removeprefix(f"{word}:").removeprefix(f"{word}.").strip()
        yield Line("Verdict", sentence, word in ("poor", "unknown"), word, capital(rest))
        yield _pace(figures)
        median, high = (in_mm(figures["views_agree_mm"][key]) for key in ("median", "p95"))
        last_s = figures.get("of_the_last_s")
        since = "since the calibration" if last_s is None else f"over the last {last_s:.0f} s"
        every = f"95 % {high}, {since}."
        yield Line("Views agree", f"median {median}, {every}", figure=median, rest=f"Median; {every}")
        if doubts := [f"{words} {lasts}" for words, lasts in _doubts(figures)]:
            yield Line("Doubtful", f"{', '.join(doubts)}.")
        turn = figures["calibration"]["rotation_sd_deg"]
        precision = f"{precision_in_words(figures['calibration'])}."
        turn_text = "–" if turn is None else f"± {turn:.1f}°"
        rest = precision.removeprefix(f"{turn_text}, ")
        yield Line("Calibration", precision, figure=turn_text, rest=capital(rest))
        yield _repaired(figures["repaired"])
    yield from _frames(figures)


def detail_lines(figures: Figures) -> Iterator[Line]:
    """All other figures but those of each bone."""
    yield from _frames(figures, every=True)
    if "calibration" in figures:
        for k, text in enumerate(verdict(figures).sentences[1:]):
            yield Line("" if k else "Also", in_flags(text))
        for k, text in enumerate(calibration_in_words(figures["calibration"])):
            yield Line("" if k else "Calibration", text)
        if never := [spoken(name) for name in figures["in_no_frame"]]:
            whence = {_LENGTH_FROM.get(bone["length_from"], "") for bone in figures["bones"].values()}
            lengths = " or ".join(sorted(whence - {""}))
            yield Line("Never seen", f"{', '.join(never)}: S* guesses them; their bones are {lengths}.")
        error, ms = figures["bone_error_mm"], figures["fuse_ms"]
        a, b, fused = (in_mm(error[key]["max"]) for key in ("a", "b", "fused"))
        yield Line("Largest bone error", f"S_A {a}, S_B {b}, S* {fused}.")
        yield Line("Fusion", f"{_times(ms, 3, 'ms per frame')}.")
    if figures.get("latency_ms", {}).get("p50") is not None:
        yield Line("From images to S*", f"{_times(figures['latency_ms'], 0, 'ms')}.")
    if "without_truth" in figures:
        yield from _without_truth(figures["without_truth"])


def calibration_in_words(figures: Figures) -> list[str]:
    """The source of a calibration, and how certain it is, as lines."""
    lines = [f"{figures['how']}."]
    angle, residual, frames = figures["axes_angle_deg"], figures["residual_mm"], figures["frames"]
    if residual is None:
        return [*lines, f"The sensors' axes are {angle:.0f}° apart."]
    worst = ", ".join(f"{name} {distance:.0f} mm" for name, distance in figures["worst_joints_mm"].items())
    return [
        *lines,
        f"In its {frames} frames the views differ by {residual['median']:.0f} mm (median), "
        f"{residual['rms']:.0f} mm (RMS); worst: {worst}.",
        f"The sensors' axes are {angle:.0f}° apart; "
        f"that rotation is certain to about {figures['rotation_sd_deg']:.1f}°.",
    ]


def bone_rows(figures: Figures) -> Iterator[list[str]]:
    """Of each bone: its name, the target in millimetres, and mean ± deviation of S_A, S_B and S*."""
    for name, bone in figures["bones"].items():
        means = [bone[key] for key in ("a", "b", "fused")]
        yield [
            name.replace("_", " "),
            f"{bone['target_m'] * 1e3:.0f}"
            + (f", {_LENGTH_FROM[bone['length_from']]}" if bone["length_from"] in _LENGTH_FROM else ""),
            *("–" if m["mean_m"] is None else f"{m['mean_m'] * 1e3:.0f} ± {m['std_mm']:.1f}" for m in means),
        ]


BONE_HEAD = ("bone", "target", "S_A", "S_B", "S*")
"""The columns of :func:`bone_rows`."""


def precision_in_words(calibration: Figures) -> str:
    """How certain a calibration is, in standard deviations, and from what."""
    turn, shift, frames = (calibration[key] for key in ("rotation_sd_deg", "translation_sd_mm", "frames"))
    if turn is None or not math.isfinite(turn):
        return "precision unknown"
    far = calibration["sd_at_3m_mm"]
    size = "" if shift is None else f", ± {shift:.0f} mm at the person"
    size += "" if far is None else f" and ± {far:.0f} mm 3 m from there"
    return f"± {turn:.1f}°{size}, from {frames} frame{'' if frames == 1 else 's'}"


def _doubts(figures: Figures) -> Iterator[tuple[str, str]]:
    """What is doubtful for half a second or longer, and for how long."""
    of = figures["seconds_of"]
    for name, words in DOUBT_WORDS.items():
        if (of[name] or 0.0) >= _SOME_TIME:
            yield words.format(limb=of["limb"]), doubt(of[name], of["seen"])[0]


def _repaired(repaired: Figures) -> Line:
    unseen, exchanged = in_percent(repaired["unseen_joints"]), repaired["exchanged"]
    filled_in = f"joints filled in: {unseen}."
    if exchanged is None:
        return Line("Repaired", filled_in, figure="" if unseen == "0 %" else unseen, rest="Joints filled in.")
    a, b = in_percent(exchanged["a"]), in_percent(exchanged["b"])
    figure = f"{a}, {b}" if any(exchanged.values()) else ""
    rest = f"Left and right, of A and of B; {filled_in}"
    return Line("Repaired", f"left and right: {a} of A, {b} of B; {filled_in}", figure=figure, rest=rest)


def _pace(figures: Figures) -> Line:
    """What S* is expected to be off, and how fast it comes."""
    frames, seconds, rate = figures["fused_frames"], figures["seconds"], figures["frames_per_second"]
    latency_ms, off = figures.get("latency_ms", {}), figures["expected_error_mm"]
    paused = rate is not None and (frames - 1) / rate < _PAUSED * seconds
    each = "" if rate is None else f", {rate:.1f} per second" + " between pauses" * paused
    counted = "1 frame" if frames == 1 else f"{frames} frames"
    text = f"{counted} in {seconds:.1f} s{each}"
    if latency_ms.get("p50") is not None:
        text += f", {latency_ms['p50']:.0f} ms after the images (99 %: {latency_ms['p99']:.0f} ms)"
    if off is None:
        return Line("S*", f"{text}.")
    expected = "expected to be off"
    return Line(
        "S*", f"{expected} by {in_mm(off)}; {text}.", figure=in_mm(off), rest=f"{capital(expected)}; {text}."
    )


_COUNTS = {
    "too slow for": "too_slow_for",
    "lost on USB": "lost_on_usb",
    "reconnects": "lost_and_back",
    "without a partner": "dropped",
    "alone": "alone",
    "without a person": "without_person",
    "repeated": "stale",
}
"""Of each sensor: what is counted, by its name in a report or in its ``streams``."""
_ACTED_ON = ("too slow for", "lost on USB", "reconnects", "without a partner", "clocks reset")


def _frames(figures: Figures, every: bool = False) -> Iterator[Line]:
    """What the frames lack: what someone might act on, or `every` count."""
    streams, frames = figures.get("streams", {}), figures["frames"]
    links = figures.get("network", {})
    live = bool(streams)
    counts: Figures = {}
    for what, name in _COUNTS.items():
        if every or live == (name in streams):
            counts |= {f"{what} {side.upper()}": (streams | figures).get(name, {}).get(side) for side in "ab"}
    if live:
        sensors = {"sensor", "network"} & set(streams["origins"].values())
        counts["clocks reset" if sensors else "stalls of this machine"] = streams["clock_resets"]
    if every:
        counts |= {what: streams.get(what.replace(" ", "_")) for what in ("late", "repeated", "out of order")}
    told = [f"{what} {count}" for what, count in counts.items() if count]
    warning = any(each.startswith(_ACTED_ON) for each in told)
    for side, link in links.items():
        bad = link["lost"] or link["malformed"] or link["restarts"] or link["clock_bound_ns"] is None
        told += [f"{side.upper()}'s network: {_link(link)}"] * bool(every or bad)
        warning |= bool(bad)
    if every and streams.get("clock_offset_ms") is not None:
        offset, drift = streams["clock_offset_ms"], streams["drift_ppm"]
        told.append(f"B's clock less A's {offset:.1f} ms, drifting {drift:.0f} ppm")
    if figures.get("others_seen"):
        told.append(f"others seen in {in_percent(figures['others_seen'])}; S* follows one person")
    if told or every:
        paired = f"{figures['paired']} pairs of {frames['a']} (A) and {frames['b']} (B)"
        yield Line("Frames", f"{', '.join([paired, *told])}.", warning=warning)


def _link(link: Figures) -> str:
    counts = {"lost": link["lost"], "damaged messages": link["malformed"], "restarts": link["restarts"]}
    bad = ", ".join(f"{what} {count}" for what, count in counts.items() if count)
    text = f"frames arrived: {link['received']}, {bad or 'none lost'}"
    if link["round_trip_ns"] is None or link["clock_bound_ns"] is None:
        return f"{text}; the clocks of the two PCs could not be related"
    trip_ms, bound_ms = link["round_trip_ns"] * 1e-6, link["clock_bound_ns"] * 1e-6
    return f"{text}; round trip {trip_ms:.1f} ms, clocks related within {bound_ms:.1f} ms"


def _without_truth(figures: Figures) -> Iterator[Line]:
    """Figures that need no ground truth: bad ones prove that S* is wrong, good ones prove nothing."""
    if figures["roughness_ratio"] is None:
        yield Line("Without truth", "too short, or too few joints that both sensors see.")
        return
    ratio, own = figures["roughness_ratio"], in_percent(figures["jumps_own"])
    a, b, fused = (in_mm(1e3 * figures[f"rough_{key}"]) for key in ("a", "b", "fused"))
    yield Line("Roughness", f"second difference: S* {fused}, S_A {a}, S_B {b}; ratio {ratio:.2f}.")
    a, b, fused = (in_percent(figures[f"jumps_{key}"]) for key in ("a", "b", "fused"))
    yield Line("Jumps", f"above 150 mm per frame: S* {fused}, S_A {a}, S_B {b} of steps; S* alone {own}.")
    a, b, fused = (in_percent(figures[f"against_{key}"]) for key in ("a", "b", "fused"))
    flips = figures["flips_per_minute"]
    yield Line(
        "Facing",
        f"against the motion: S* {fused}, S_A {a}, S_B {b} of fast frames; {flips:.1f} flips per minute.",
    )
    if figures["heading_fused"] is not None:
        off = [figures[f"heading_{key}"] for key in ("a", "b", "fused")]
        a, b, fused = ("–" if angle is None else f"{math.degrees(angle):.0f}°" for angle in off)
        astray = in_percent(figures["astray_fused"])
        yield Line("Heading", f"off a straight path: S* {fused}, S_A {a}, S_B {b}; S* astray (45°) {astray}.")
    text = f"R is {math.degrees(figures['rotation_off']):.1f}° from a robust fit"
    if figures["halves_rotation_off"] is not None:
        halves, shift = figures["halves_rotation_off"], in_mm(1e3 * figures["halves_position_off"])
        text += f"; the fits of both halves differ by {math.degrees(halves):.1f}° and {shift}"
    yield Line("Registration", f"{text}.")


def _times(ms: Figures, digits: int, unit: str) -> str:
    median, high, most = (f"{ms[key]:.{digits}f}" for key in ("p50", "p99", "max"))
    return f"{median} {unit} (median), 99 % {high} ms, max {most} ms"


def in_mm(value: float | None, unit: str = " mm") -> str:
    """Whole millimetres from 10 on, two digits below, 0 below a micrometre; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    if abs(value) < _MICROMETRE:
        return f"0{unit}"
    return f"{value:.0f}{unit}" if value >= 10.0 else f"{value:.2g}{unit}"


def in_percent(share: float | None) -> str:
    """A share as a percentage: whole from 10 % on, one digit below; a dash where there is none."""
    if share is None or not math.isfinite(share):
        return "–"
    percent = 100.0 * share
    if 0.0 < percent < 0.05:
        return "below 0.1 %"
    return f"{percent:.0f} %" if percent >= 10.0 or percent == 0.0 else f"{percent:.1f} %"
