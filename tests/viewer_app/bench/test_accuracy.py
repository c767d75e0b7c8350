"""``duplex bench accuracy``: it prints and writes the measured figures."""

import io
import json
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console
from scipy.spatial.transform import Rotation

from devices.simulated.realism.pair_statistics import PairStatistics
from devices.simulated.realism.reference_figures import PUBLISHED, REASONS
from devices.simulated.tracking.harsher_errors import heavy_tailed, scaled
from devices.simulated.tracking.tracker_errors import JointGroups, TrackerErrors
from fusion.body import KINECT_V2
from fusion.rigid import RigidTransform
from fusion.setup import FuserSettings, FusionSetup
from recordings.fusing.live import LiveFusion
from viewer_app.bench.accuracy_methods import ABLATIONS, METHODS, OURS, WITHOUT_DEPTH
from viewer_app.bench.accuracy_tables import (
    clearly_best,
    lost_to,
    over_seeds,
    rivals_of,
    said_of_losses,
    table_by,
    tables_of_methods,
    wins,
)
from viewer_app.bench.accuracy_trials import Outcome, Simulation, Trial, record, run_trials
from viewer_app.cli import main

FIGURES = ("mpjpe", "p95", "hidden_one", "hidden_both", "bone_error", "bone_deviation", "jitter",
           "acceleration", "swapped", "lag", "within_1sd", "within_2sd", "fuse_us")  # fmt: skip
NAMES = tuple(method.name for method in METHODS)


def made_up(size: dict[str, float] | None = None) -> list[Outcome]:
    """Two movements, two angles, three seeds; all figures of a method as large as ``size`` says."""
    random = np.random.default_rng(0)
    return [
        Outcome(
            Trial(motion, angle, seed),
            method,
            {name: (size or {}).get(method, 1.0) + random.uniform(0.0, 0.2) for name in FIGURES},
        )
        for motion in ("basketball", "still")
        for angle in (45.0, 135.0)
        for seed in range(3)
        for method in NAMES
    ]


def printed(outcomes: list[Outcome]) -> str:
    console = Console(file=io.StringIO(), width=80)
    for table in (*tables_of_methods(outcomes), table_by("movement", lambda trial: trial.motion, outcomes)):
        console.print(table)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_the_tables_can_be_read_at_80_columns() -> None:
    assert "…" not in printed(made_up(dict.fromkeys(NAMES, 100.0)))
    text = printed(made_up(dict.fromkeys(NAMES, 0.4)))
    assert "…" not in text
    assert max(len(line) for line in text.splitlines()) <= 80
    for method in NAMES:
        rows = [
            line.split(method)[1].split() for line in text.splitlines() if line.startswith(f"  {method} ")
        ]
        distances, movement, certainty, by_movement = rows
        assert all(cell.count("±") == 1 for cell in (*distances[:-1], *movement, *certainty))
        assert (len(distances), len(movement), len(certainty)) == (6, 5, 2)
        assert len(by_movement) == (3 if method == OURS else 4)


def test_a_trial_counts_only_where_every_method_has_the_figure() -> None:
    outcomes = made_up()
    for outcome in outcomes:
        outcome.figures["lag"] = 1.0 if outcome.trial.motion == "still" else 5.0
        if outcome.method == "B alone" and outcome.trial.motion == "basketball":
            outcome.figures["lag"] = np.nan
    for method in NAMES:
        assert over_seeds(outcomes, method, "lag").tolist() == [1.0, 1.0, 1.0]
    assert "lag 6 of 12" in " ".join(printed(outcomes).split())


@pytest.mark.parametrize(("lead", "best"), [(0.0, None), (0.5, "Kalman, refined")])
def test_only_a_difference_beyond_its_spread_is_bold(lead: float, best: str | None) -> None:
    assert clearly_best(made_up({"Kalman, refined": 1.0 - lead}), "mpjpe") == best


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--seeds", "0"), "--seeds must be 1 or more; got 0"),
        (("--set", "real", "--seeds", "0"), "--seeds must be 1 or more; got 0"),
        (("--seconds", "nan"), "--seconds must be a positive number; got nan"),
        (("--seconds", "inf"), "--seconds must be a positive number; got inf"),
        (("--set", "real", "--picture", "x.png"), "--picture draws the methods"),
        (("--recordings", "real"), "add --set real"),
        (("--motions", "walk", "fly"), "got fly"),
        (("--angles", "nan"), "between 0 and 180 degrees; got nan"),
        (("--first-seed", "-1"), "--first-seed must be 0 or more; got -1"),
        (("--errors", "0"), "--errors must be a factor above 0, at most 10; got 0.0"),
        (("--errors", "nan"), "--errors must be a factor above 0, at most 10; got nan"),
        (("--methods", "without depth"), "needs depth images: add --depth half"),
        (("--processes", "-1"), "--processes must be 0 or more; got -1"),
        (("--methods", "mean, refined", "magic"), "Got magic."),
        (("--seconds", "1", "--processes", "1"), "leave less than a second after the start-up pose"),
    ],
)
def test_benchmarks_that_cannot_run_give_one_line_and_exit_code_2(
    arguments: tuple[str, ...],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main(["bench", "accuracy", *arguments])
    said = capsys.readouterr().err
    assert stop.value.code == 2
    assert said.startswith("duplex: ")
    assert said.count("\n") == 1
    assert words in said
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A small benchmark's folder, and what it printed."""
    folder = tmp_path_factory.mktemp("bench")
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as said:
        patch.chdir(folder)
        patch.setenv("COLUMNS", "80")
        main(
            [
                "bench",
                "accuracy",
                "--motions",
                "arms",
                "--angles",
                "90",
                "--seeds",
                "2",
                "--seconds",
                "5",
                "--json",
                "a.json",
                "--picture",
                "a.png",
            ]
        )
    return folder, said.getvalue()


def test_a_benchmark_writes_every_figure_of_every_method_on_every_recording(
    measured: tuple[Path, str],
) -> None:
    folder, _ = measured
    document = json.loads((folder / "a.json").read_text(encoding="utf-8"))
    rows = document["trials"]
    assert [(row["motion"], row["angle_deg"], row["seed"], row["method"]) for row in rows] == [
        ("arms", 90.0, seed, method) for seed in (0, 1) for method in NAMES
    ]
    for row in rows:
        assert set(FIGURES) < set(row)
        assert 0.0 < row["mpjpe"] < row["p95"]
    ours, published = ([row for row in rows if row["method"] == method] for method in (OURS, "published"))
    for one, other in zip(ours, published, strict=True):
        assert one["bone_deviation"] < 1e-9 < other["bone_deviation"]
    picture = cv2.imread(str(folder / "a.png"))
    assert picture is not None
    assert picture.std() > 10.0  # of 255: not an empty page


def test_what_a_benchmark_prints_is_what_it_wrote(measured: tuple[Path, str]) -> None:
    folder, said = measured
    rows = json.loads((folder / "a.json").read_text(encoding="utf-8"))["trials"]
    assert "…" not in said
    mpjpe = {m: np.array([row["mpjpe"] for row in rows if row["method"] == m]) for m in NAMES}
    by_movement = said[said.index("MPJPE in mm by movement") : said.index("MPJPE in mm by angle")]
    for method in NAMES:
        row = next(line for line in said.splitlines() if line.startswith(f"  {method} "))
        spread = 1e3 * mpjpe[method].std(ddof=1)
        assert f" {1e3 * mpjpe[method].mean():.1f}±{spread:.1f} " in row
        row = next(line for line in by_movement.splitlines() if line.startswith(f"  {method} "))
        mean = f"{1e3 * mpjpe[method].mean():.1f}"
        nearer = [] if method == OURS else [f"{np.mean(mpjpe[OURS] < mpjpe[method]):.0%}"]
        assert row.removeprefix(f"  {method} ").split() == [mean, mean, *nearer]


def test_wins_are_counted_recording_by_recording() -> None:
    outcomes = made_up()
    for outcome in outcomes:
        nearer = outcome.trial.motion == "still" and outcome.trial.seed > 0  # 4 of 12 recordings
        kalman = 2.0 if nearer else 0.9
        outcome.figures["mpjpe"] = {OURS: 1.0, "Kalman, refined": kalman}.get(outcome.method, 3.0)
    assert wins(outcomes, "Kalman, refined") == pytest.approx(4 / 12)
    assert wins(outcomes, "mean, refined") == 1.0


def test_cases_where_another_method_is_nearer_on_average_are_reported() -> None:
    outcomes = made_up(dict.fromkeys(NAMES, 2.0) | {OURS: 1.0, "oracle": 0.1})
    assert lost_to(outcomes) == []
    assert "In each of 4 movements × angles" in said_of_losses(outcomes)[0]
    for outcome in outcomes:
        place = outcome.trial.motion, outcome.trial.angle
        if outcome.method == "mean, refined" and place == ("still", 135.0):
            outcome.figures["mpjpe"] = 0.5
    ((motion, angle, method, by),) = lost_to(outcomes)
    assert (motion, angle, method) == ("still", 135.0, "mean, refined")
    assert 0.5 < by < 0.7
    assert "In 1 of 4 movements × angles" in said_of_losses(outcomes)[0]
    assert "oracle" not in rivals_of(outcomes)


def test_ours_is_no_rival_of_itself() -> None:
    rivals = rivals_of(made_up())
    assert "duplex, smoothed" in NAMES
    assert not any(name.startswith(OURS) for name in rivals)
    assert "Kalman, refined" in rivals


def test_the_oracle_is_never_the_best() -> None:
    assert clearly_best(made_up({"oracle": 0.0}), "mpjpe") is None


def test_names_are_unique_and_fit_their_column() -> None:
    names = [method.name for method in (*METHODS, *ABLATIONS)]
    assert len(set(names)) == len(names)
    assert max(map(len, names)) <= 18
    assert OURS in names


def test_two_processes_find_what_one_finds() -> None:
    trials = [Trial("arms", 90.0, seed) for seed in (7, 8)]
    simulation = Simulation(seconds=6.0)
    one, two = (list(run_trials(trials, simulation, ["mean, refined"], n)) for n in (1, 2))
    assert [[o.trial for o in of] for of in two] == [[t] for t in trials]
    for a, b in zip(one, two, strict=True):
        for name in set(FIGURES) - {"fuse_us"}:
            np.testing.assert_equal(b[0].figures[name], a[0].figures[name])


def test_harsher_trackers_are_harsher() -> None:
    trial = [Trial("arms", 90.0, 3)]
    ((plain,),), ((larger,),) = (
        list(run_trials(trial, simulation, ["mean, refined"]))
        for simulation in (Simulation(seconds=6.0), Simulation(seconds=6.0, errors=1.5))
    )
    # all errors times 1.5, and more joints hidden: the mean distance grows by about as much
    assert 1.25 < larger.figures["mpjpe"] / plain.figures["mpjpe"] < 2.0
    tails = heavy_tailed(TrackerErrors.of(KINECT_V2))
    assert Simulation("kinect_v2", tracker_errors="heavy-tailed").errors_of_tracker() == tails
    assert Simulation("kinect_v2", 9.0, 2.0, "heavy-tailed").errors_of_tracker() == scaled(tails, 2.0)


def test_depth_images_reach_our_method_and_not_its_ablation() -> None:
    """Images change S*, and nothing else: the ablation on images is our method on no images."""
    trial = [Trial("arms", 90.0, 3)]
    names = ["mean, refined", OURS, WITHOUT_DEPTH]
    (without,), (having,) = (
        list(run_trials(trial, Simulation(seconds=6.0, depth=depth), names)) for depth in ("none", "half")
    )
    blind = {o.method: o.figures["mpjpe"] for o in without}
    seeing = {o.method: o.figures["mpjpe"] for o in having}
    assert blind[OURS] == blind[WITHOUT_DEPTH]
    assert seeing[OURS] != seeing[WITHOUT_DEPTH]


def test_the_live_row_refines_a_wrong_registration() -> None:
    """Without learning, S* keeps the error of the registration that it starts from."""
    recording, _ = record(Trial("walk", 90.0, 3), Simulation(seconds=10.0))
    tilt = RigidTransform(Rotation.from_euler("y", 4.0, degrees=True).as_matrix(), np.array([0.06, 0.0, 0.0]))
    wrong = replace(recording.calibration, a_from_b=tilt @ recording.calibration.a_from_b)
    (live,) = (method for method in METHODS if method.name == "duplex, live")
    setup = FusionSetup(wrong, FuserSettings())
    kept = LiveFusion(setup, calibrated=True)
    unrefined = np.array([kept.fuse(pair).fused.positions for pair in recording.pairs])
    end = slice(-60, None)

    def error(positions: NDArray[np.float64]) -> float:
        return float(np.nanmean(np.linalg.norm((positions - recording.truth)[end], axis=-1)))

    assert error(live.find(replace(recording, calibration=wrong)).joints) < 0.8 * error(unrefined)


def test_set_real_says_which_published_figures_are_out_and_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    middling = {name: float(np.mean(of_it)) for name, of_it in PUBLISHED["azure_squat"].items()}
    jitter = dict.fromkeys(JointGroups.__dataclass_fields__, 0.004)
    simulated = PairStatistics(**middling, jitter=jitter, swapped=0.166, swap_frames=20.0)
    monkeypatch.setattr("viewer_app.bench.accuracy.simulated_statistics", lambda *_: simulated)
    monkeypatch.setenv("COLUMNS", "80")
    main(["bench", "accuracy", "--set", "real", "--json", str(tmp_path / "r.json")])
    said = capsys.readouterr().out
    assert "…" not in said
    assert max(len(line) for line in said.splitlines()) <= 80
    assert "13 of 13 figures within 1.5" in said
    plain = " ".join(said.split())
    for (setting, figure), reason in REASONS.items():
        assert f"{figure.replace('_', ' ')}: {reason}." in plain, setting
    document = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    assert list(document) == [f"{name}, published" for name in PUBLISHED]
    (swapped,) = (f for f in document["kinect_v2_90deg_walk, published"] if f["figure"] == "swapped")
    assert swapped["ratio"] == pytest.approx(0.166 / 0.076)
    assert swapped["within_1.5"] is False
