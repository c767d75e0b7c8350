"""Writes ``docs/benchmarks.md`` from the figures that the benchmarks left: ``make benchmarks``."""

import re
from pathlib import Path
from string import Template

import numpy as np

from tests.benchmarks import results
from tests.benchmarks.methods import METHODS, OURS
from tests.benchmarks.real import FAULTS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "benchmarks.md"
_SETS = {
    "azure": "Azure Kinect",
    "kinect_v2": "Kinect v2",
    "blazepose": "BlazePose, simulated errors",
    "larger_errors": "Azure, errors × 1.5",
    "heavy_tails": "Azure, heavy-tailed errors",
    "depth": "Azure, with depth images",
}
_OTHERS = ("real", "certainty", "coverage", "ablation", "surface", "conditions", "speed", "latency")
_FEWEST = 8  # recordings, of which an interval is stated
_DEGREES = float(np.degrees(1.0))
_BASELINES = ("mean, refined", "tracked wins", "Kalman, refined")


def page():
    """The whole page."""
    template = Template(Path(__file__).with_name("page.md").read_text(encoding="utf-8"))
    names = {f"accuracy_{name}": f"accuracy_{name}" for name in _SETS}
    names |= dict.fromkeys(_OTHERS, "")
    real = results.read("real")["figures"]
    origins = [_origin(name) for name in names if (results.FOLDER / f"{name}.json").exists()]
    return template.substitute(
        methods=_methods(results.read("accuracy_azure")["figures"]),
        sets=_sets(),
        real=_real(real),
        conditions=_conditions(
            results.read("conditions")["figures"], results.read("real")["figures"]["pairs"]
        ),
        certainty=_certainty(results.read("certainty")["figures"], results.read("coverage")["figures"]),
        ablation=_ablation(results.read("ablation")["figures"]),
        surface=_surface(results.read("surface")["figures"]),
        speed=_speed(results.read("speed")),
        latency=_latency(results.read("latency")),
        origins="\n".join(origins),
        machine=_machine(results.read("accuracy_azure")["machine"]),
        measured_methods=measured("accuracy_azure"),
        measured_sets=measured(*(f"accuracy_{name}" for name in _SETS)),
        **{f"measured_{name}": measured(name) for name in _OTHERS},
    )


def measured(*names):
    """Revision and date of a table's figures, the oldest of several."""
    documents = [results.read(name) for name in names if (results.FOLDER / f"{name}.json").exists()]
    return f"Revision {min(one['revision'] for one in documents)}, {min(one['date'] for one in documents)}."


def _machine(machine):
    return f"{machine['system']} {machine['architecture']}, {machine['processors']} processors"


def _origin(name):
    command = results.read(name)["command"].removeprefix("python -m tests.benchmarks.")
    if name in ("real", "certainty", "ablation"):  # one folder after the other
        command = command.partition(" kinect")[0] + " FOLDER…"
    return re.sub(r" --processes \d+", "", command)  # changes no figure


def _methods(figures):
    rows = []
    for name in (method.name for method in METHODS if method.name in figures["methods"]):
        row = figures["methods"][name]
        rows.append(
            (
                f"**{name}**" if name.startswith("duplex") else name,
                f"{_mm(row['mpjpe'], 1)} ({_interval(row['interval'])})",
                _mm(row["p95"]),
                f"{_mm(row['hidden_one'])}/{_mm(row['hidden_both'])}",
                _mm(row["bone_error"]),
                _mm(row["jitter"], 1),
                _number(row["lag"], 1, 2),
                "–" if name == OURS else f"{_nearer(figures, name)}; {_number(row['nearer'], 100, 0)}",
            )
        )
    columns = (
        "method", "mean error", "95 %", "hidden in one/both views", "worst bone", "jitter, still",
        "lag, frames", "*duplex* closer by; %",
    )  # fmt: skip
    return _table(columns, rows)


def _sets():
    rows = []
    for name, title in _SETS.items():
        if not (results.FOLDER / f"accuracy_{name}.json").exists():
            continue
        figures = results.read(f"accuracy_{name}")["figures"]
        methods = figures["methods"]
        best = min((m for m in _BASELINES if m in methods), key=lambda m: methods[m]["mpjpe"])
        cells = [
            "–" if m not in methods else f"{_mm(methods[m]['mpjpe'], 1)}/{_mm(methods[m]['p95'])}"
            for m in (best, "paper", "duplex", "duplex, live", "duplex, smoothed", "oracle")
        ]
        motions = {(case["motion"], case["angle"]) for case in figures["lost"]}
        worst = max((case["by"] for case in figures["lost"]), default=0.0)
        lost = f"{len(motions)}, by {_mm(worst, 1)} at most" if motions else "none"
        if name == "depth":
            lost = f"without images {_mm(methods['without depth']['mpjpe'], 1)}"
        n = f"{figures['recordings']} ({len(figures['seeds'])})"
        rows.append((title, n, *cells, _nearer(figures, best), lost))
    columns = (
        "trackers", "recordings (seeds)", "best baseline", "paper", "**duplex**", "live", "smoothed",
        "oracle",
        "**duplex** closer by", "baseline closer: movements × angles",
    )  # fmt: skip
    return _table(columns, rows)


def _nearer(figures, name):
    """By how much ours is nearer to the truth than another method on average, and the interval."""
    ours, other = (figures["methods"][each] for each in (OURS, name))
    by = _mm(other["mpjpe"] - ours["mpjpe"], 1)
    if figures["recordings"] < _FEWEST:
        return by
    return f"{by} ({_interval([-each for each in reversed(other['less'])])})".replace("-", "−")


def _interval(of):
    low, high = (_mm(each, 1) for each in of)
    return f"{low}, {high}" if of[0] < 0.0 else f"{low}–{high}"


def _real(figures):
    walks, still, squats = ({}, {}, {})
    for name, row in figures["pairs"].items():
        kind = walks if "walk" in name else squats if "squats" in name else still
        paths = ("heading", "astray", "against") if kind is squats else ("heading", "astray")
        # a few fast steps are no path, and who squats has none
        kind[name] = row if kind is walks else {
            of: figure for of, figure in row.items() if not any(part in of for part in paths)
        }  # fmt: skip
    rows = [
        _real_row(f"{len(walks)} walks of {_people(walks)} people, mean", walks, np.mean),
        _real_row("worst in each column", walks, np.max),
        _real_row(f"{_people(still)} people who stand or step, {len(still)}, mean", still, np.mean),
        _real_row(f"{_people(squats)} people who squat, {len(squats)}, Azure, mean", squats, np.mean),
    ]
    columns = (
        "recordings", "roughness of S\\*, views = 1", "own jumps, %", "against the motion A/B/S\\*, %",
        "heading, °/*astray*, %", "live", "flips per minute", "hands together, %",
    )  # fmt: skip
    return _table(columns, rows)


def _people(names):
    """How many people: a name ends in its person's number, or in the movement for the first person."""
    return len({number if (number := name.rpartition("_")[2]).isdigit() else "" for name in names})


def _certainty(figures, simulated):
    bodies = ("kinect_v2", "azure_kinect")

    def row(title, of_body, figures=figures["real"]):
        return (title, *(of_body(figures[body]) if body in figures else "–" for body in bodies))

    def deleted(title, kind):
        return row(
            title,
            lambda of: (
                f"{_number(of['deleted'][kind]['rms_over_added'], 1, 2)}; "
                f"{_mm(of['deleted'][kind]['apart_95'])}"
            ),
        )

    rows = [
        deleted("a limb deleted from one view: RMS distance over RMS added σ; 95 %, mm", "one"),
        deleted("the same, from both views", "both"),
    ]
    rows += [
        row(
            "a tenth of B's frames deleted: joints that move 100 mm; also beyond 2.5 σ, %",
            lambda of: "; ".join(_number(of["thinned"][each], 100, 2) for each in ("elsewhere", "unsaid")),
        ),
        row(
            "events that are true of S\\*: left and right; limbs, %",
            lambda of: "; ".join(_number(of["words"][each], 100, 1) for each in ("exchanged", "follows")),
        ),
        row(
            "R in recordings of one set-up: median difference, °; within 2.5 σ, %",
            lambda of: "; ".join(
                (
                    _number(of["one_set_up"]["median"], _DEGREES, 1),
                    _number(of["one_set_up"]["within"], 100, 0),
                )
            ),
        ),
        row(
            "clock offsets found from 20 s: right, wrong, none",
            lambda of: ", ".join(str(count) for count in of["clocks"].values()),
        ),
    ]
    fused = {body: of_body["labels"] for body, of_body in simulated.items()}
    rows += [
        row("simulated: errors within 2 σ, %; RMS σ over RMS error", lambda of: _covered(of, "all"), fused),
        row("after a gap of 2.5 s", lambda of: _covered(of, "after a gap of both views"), fused),
        row("left and right exchanged", lambda of: _covered(of, "left and right exchanged"), fused),
        row(
            "covariance: errors outside its 99.5 % region, %; z² along its least axis",
            lambda of: (
                f"{_number(of['covariance']['beyond_12.8'], 100, 1)}; "
                f"{_number(of['covariance']['least_axis'], 1, 1)}"
            ),
            fused,
        ),
        row(
            "walks: speed over true speed; within 2.5 σ, %",
            lambda of: (
                f"{_number(of['walks']['speed_over_true'], 1, 3)}; "
                f"{_number(of['walks']['speed_within'], 100, 0)}"
            ),
            fused,
        ),
        row(
            "walks: delay of strikes; of toe-offs, ms",
            lambda of: f"{_mm(of['walks']['strike_late'])}; {_mm(of['walks']['toe_off_late'])}".replace(
                "-", "−"
            ),
            fused,
        ),
    ]
    if "laboratory" in figures:
        labelled, found, invented, late = (
            ", ".join(f"{row[name] * factor:.0f}".replace("-", "−") for row in figures["laboratory"].values())
            for name, factor in (("labelled", 1), ("found", 1), ("invented", 1), ("late", 1e3))
        )
        title = "laboratory strikes, toe-offs: found; invented; delay, ms"
        rows.append((title, "–", f"{found} of {labelled}; {invented}; {late}"))
    if "cable" in figures:
        paired = ", ".join(_number(share, 100, 1) for share in figures["cable"].values())
        rows.append(("cable, B 20, 100 ms later: frames paired, %", "–", paired))
    return _table(("", "Kinect v2", "Azure Kinect"), rows)


def _surface(figures):
    rows = [
        (name, *(_of_surface(figures[body][name]) for body in ("azure_kinect", "kinect_v2")))
        for name in figures["azure_kinect"]
    ]
    return _table(("R, °/t, mm/S\\*, mm", "Azure Kinect", "Kinect v2"), rows)


def _of_surface(row):
    shown = (row["turn"], _DEGREES, 2), (row["shift"], 1e3, 1), (row["error"], 1e3, 1)
    return "/".join(_number(*each) for each in shown)


def _covered(figures, group):
    joints = figures["joints"][group]
    if joints is None:
        return "–"
    return f"{_number(joints['within_2'], 100, 1)}; {_number(joints['rms_sigma_over_error'], 1, 2)}"


def _over(function, rows, name):
    known = [row[name] for row in rows if row.get(name) is not None]
    return float(function(known)) if known else None


def _conditions(figures, real):
    clean, *others = figures["conditions"].items()
    clocks = [row for name, row in others if " off" in name or "clock" in name]
    rows = [
        (name, _number(max(row["mpjpe"] for row in of) / clean[1]["mpjpe"], 1, 2))
        for name, of in (
            ("B's clock off by 33 ms–7 s, or 200 ppm fast; worst case", clocks),
            *((name, [row]) for name, row in others if row not in clocks),
        )
    ]
    bad = figures["bad_setups"].values()
    worst = max(row[f"fused_where_{view}"] / row[view] for row in bad for view in "ab")
    title = f"{len(figures['bad_setups'])} bad set-ups: S\\* if a view is 1, same joints; worst case"
    rows.append((title, _number(worst, 1, 2)))
    wrong = (
        f"20 faulty frames in a real view ({', '.join(FAULTS)}): share that reaches S\\*; if deleted instead"
    )
    for body, title in (("kinect_v2", f"{wrong}; Kinect v2"), ("azure", "the same; Azure")):
        pairs = [row for name, row in real.items() if name.startswith(body)]
        shares = (
            ", ".join(_number(_over(np.mean, pairs, f"{what}_{kind}"), 1, 2) for kind in FAULTS)
            for what in ("fault", "floor")
        )
        rows.append((title, "; ".join(shares)))
    return _table(("condition", "error, clean = 1"), rows)


def _ablation(figures):
    steps = figures["steps"]
    columns = {
        "Azure/Kinect v2/BlazePose, mm": [
            (steps[body], "error", 1e3) for body in ("azure_kinect", "kinect_v2", "blazepose")
        ],
        "real: roughness, %/hands together, %/heading, °": [
            (steps["real"], what, by)
            for what, by in (("roughness", 100.0), ("hands_together", 100.0), ("heading", _DEGREES))
        ],
    }
    rows = [
        (
            name or "–",
            *(
                "/".join(_change(of[name][what], by, name) for of, what, by in cell)
                for cell in columns.values()
            ),
        )
        for name in steps["real"]
    ]
    return _table(("without", *columns), rows)


def _change(values, factor, name):
    """A mean, or a mean change and half of its interval; bold where the interval excludes 0."""
    mean, low, high = (factor * value for value in values)
    if not name:
        return f"{mean:.1f}"
    text = f"{mean:+.1f}±{0.5 * (high - low):.1f}".replace("-", "−")
    return f"**{text}**" if low * high > 0.0 else text


def _real_row(name, rows, over):
    def figure(name, factor, digits):
        return _number(_over(over, rows.values(), name), factor, digits)

    return (
        name,
        figure("roughness_ratio", 1, 2),
        figure("jumps_own", 100, 2),
        "/".join(figure(f"against_{view}", 100, 1) for view in ("a", "b", "fused")),
        f"{figure('heading_fused', _DEGREES, 0)}/{figure('astray_fused', 100, 0)}",
        f"{figure('live_heading_fused', _DEGREES, 0)}/{figure('live_astray_fused', 100, 0)}",
        figure("flips_per_minute", 1, 1),
        figure("hands_together", 100, 1),
    )


def _speed(document):
    figures = document["figures"]
    rows = [
        (f"`Fuser.update`, {body}, *{method}*", f"{row['median_us']:.0f} µs", f"{row['p99_us']:.0f} µs")
        for body, methods in figures["update"].items()
        for method, row in methods.items()
        if (body == "kinect_v2" and "alone" not in method) or (method, body) == ("duplex", "azure_kinect")
    ]
    commands = figures["commands"]
    batch = figures["update"]["kinect_v2"]["duplex"]["batch_per_s"]
    rows.append(("whole recording, Kinect v2", f"{batch:,.0f} pairs/s", ""))
    timed = [
        ("`duplex fuse --save`, after start-up", f"{commands['fuse_pairs_per_s']:,.0f} pairs/s", ""),
        ("start-up of `duplex fuse`", f"{commands['fuse_start_up_s']:.1f} s", ""),
        ("`duplex replay --verify`", f"{commands['replay_pairs_per_s']:,.0f} pairs/s", ""),
        ("opening a session of an hour", f"{commands['open_hour_s']:.1f} s", ""),
    ]
    rows += timed if results.quiet(document) else []
    return _table(("", "median", "99 %"), rows)


def _latency(document):
    if not results.quiet(document):
        return "Not measured on a quiet machine yet."
    figures = document["figures"]
    conditions = (
        ("file", "file"), ("viewer", "file, viewer"), ("busy", "file, viewer; beside two busy processes")
    )  # fmt: skip
    rows = []
    for key, title in conditions:
        row = figures[key]
        shown = row["shown"]
        rows.append(
            (
                title,
                f"{row['handed_over']['median_ms']:.1f}/{row['handed_over']['p99_ms']:.1f}",
                "–" if shown is None else f"{shown['median_ms']:.1f}/{shown['p99_ms']:.1f}",
                str(row["lost"]),
                f"{100 * row['processor']:.0f} %",
                "–" if row["growth_mb"] is None else f"{row['growth_mb']:.0f} MB",
            )
        )
    vmc = figures["vmc"]
    rows.append(("from S\\* to a VMC receiver", f"{vmc['median_ms']:.1f}/{vmc['p99_ms']:.1f}", "–",
                 str(vmc["frames"] - vmc["arrived"]), "–", "–"))  # fmt: skip
    columns = (
        "sinks", "S\\* handed over, ms", "logged for the viewer, ms", "frames lost or skipped",
        "share of one processor", "memory growth",
    )  # fmt: skip
    return _table(columns, rows)


def _table(columns, rows):
    lines = ["| " + " | ".join(columns) + " |", "|---|" + "--:|" * (len(columns) - 1)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def _mm(metres, digits=0):
    return _number(metres, 1e3, digits)


def _number(value, factor, digits):
    return "–" if value is None else f"{factor * value:.{digits}f}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
