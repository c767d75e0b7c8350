"""``duplex bench real``: its output, and the recordings that it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fusion.evaluation.faults import FAULTS
from viewer_app.bench.real_tables import real_tables
from viewer_app.cli import main


def write(folder: Path, frames: int | None, shared: Path) -> Path:
    """A folder with the first frames of a real pair; all frames where None."""
    folder.mkdir()
    for side in "ab":
        lines = (shared / "real" / "kinect_v2_90deg_walk" / f"{side}.csv").read_text().splitlines()
        kept = lines if frames is None else lines[: 1 + 25 * frames]
        (folder / f"{side}.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    return folder


def test_a_pair_is_judged(
    shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    folder = write(tmp_path / "a_person_who_walks_for_a_while", 300, shared)
    main(["bench", "real", str(folder), "--json", str(tmp_path / "r.json")])
    said = capsys.readouterr().out
    assert "…" not in said
    assert max(len(line) for line in said.splitlines()) <= 80
    document = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    assert document["mean"] == document["pairs"]["a_person_who_walks_for_a_while"]
    row = document["mean"]
    # of 20 frames of one view at most, everything passes except the part that the solver's bones change
    shares = [row[f"{fault}_{side}"] for fault in FAULTS for side in "ab"]
    assert all(0.0 <= share < 1.5 for share in shares)
    assert f"{1e3 * row['rough_a']:.1f}" in said
    assert f"{np.degrees(row['held_out_rotation_off']):.1f}" in said
    assert 0.005 < row["rough_a"] < 0.1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nowhere",), "No folder nowhere."),
        (("empty",), "empty has no two recordings a and b"),
        (("short",), "short: A recording needs 120 pairs or more to be judged"),
        (("short", "short"), "short is named twice"),
        (("broken",), "broken/a.csv"),
        (("short", "--json", "short"), "short is a folder"),
        ((), "Name one or more folders with a.csv and b.csv, or two recordings."),
    ],
)
def test_recordings_that_cannot_be_judged_give_one_line_and_exit_code_2(
    arguments: tuple[str, ...],
    words: str,
    shared: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    write(tmp_path / "short", 60, shared)
    broken = write(tmp_path / "broken", 60, shared)
    (broken / "a.csv").write_text("time_us,body\n1\n", encoding="utf-8")
    with pytest.raises(SystemExit) as stop:
        main(["bench", "real", *arguments])
    said = capsys.readouterr().err
    assert stop.value.code == 2
    assert words in said
    assert said.startswith("duplex: ")
    assert said.count("\n") == 1


def test_means_leave_out_what_a_recording_does_not_have() -> None:
    rows = {"one": dict.fromkeys(_names(), 0.004), "two": dict.fromkeys(_names(), 0.002)}
    rows["two"]["rough_a"] = np.nan
    tables = real_tables(rows, FAULTS)
    assert list(tables[0].columns[1].cells) == ["4.0", "–", "4.0"]
    assert list(tables[0].columns[2].cells) == ["4.0", "2.0", "3.0"]


def _names() -> list[str]:
    from viewer_app.bench import real_tables as tables

    columns = (*tables._MOTION, *tables._FACING, *tables._HELD_OUT)
    return [*columns, *(f"{fault}_{side}" for fault in FAULTS for side in "ab")]
