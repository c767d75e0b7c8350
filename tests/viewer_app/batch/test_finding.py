"""The pairs of a folder or a manifest, and the summary: order, table and page."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from recordings.calibration_file import calibration_to_json
from tests.helpers.command_line import duplex
from tests.helpers.machine import need_browser
from viewer_app.batch import processes
from viewer_app.batch.finding import Pair, find_pairs
from viewer_app.batch.jobs import Job, Outcome, checksum
from viewer_app.batch.manifest import read_manifest
from viewer_app.batch.summary import RANKED, Row, worst_first, write_page, write_parquet
from viewer_app.errors import UsageError
from viewer_app.options.sensing import BatchOptions


def touch(root, *names):
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()


def names_of(root):
    return [pair.name for pair in find_pairs(root, root / "out")[0]]


def test_pairs_by_folder_and_by_name(tmp_path):
    touch(tmp_path, "a.json", "b.json", "walk_a.csv", "walk_b.csv", "anna/a.csv", "anna/b.csv")
    touch(tmp_path, "anna/jump_A.skeleton", "anna/jump_B.skeleton", "notes.csv", "anna/x.txt", "data.csv")
    pairs, alone = find_pairs(tmp_path, tmp_path / "out")
    assert [(pair.name, pair.a.name, pair.b.name) for pair in pairs] == [
        ("anna", "a.csv", "b.csv"),
        ("anna_jump", "jump_A.skeleton", "jump_B.skeleton"),
        (tmp_path.name, "a.json", "b.json"),
        ("walk", "walk_a.csv", "walk_b.csv"),
    ]
    assert not alone


def test_files_that_macos_adds_are_none_of_a_recording(tmp_path):
    touch(
        tmp_path,
        "a.csv",
        "b.csv",
        "._a.csv",
        "._b.csv",
        "walk/a.csv",
        "walk/b.csv",
        "walk/._a.csv",
        ".DS_Store",
    )
    pairs, alone = find_pairs(tmp_path, tmp_path / "out")
    assert [pair.name for pair in pairs] == [tmp_path.name, "walk"]
    assert not alone


def test_a_recording_without_partner_is_named(tmp_path):
    touch(tmp_path, "walk_a.csv", "walk_b.json", "run_a.csv", "run_b.csv")
    pairs, alone = find_pairs(tmp_path, tmp_path / "out")
    assert [pair.name for pair in pairs] == ["run"]
    assert alone == [f"{tmp_path / f'walk_{x}'} has no partner and is skipped." for x in ("a.csv", "b.json")]


def test_an_mkv_takes_the_skeletons_beside_it(tmp_path):
    touch(tmp_path, "walk_a.mkv", "walk_b.mkv", "walk_a.json", "walk_b.csv")
    (pair,), _ = find_pairs(tmp_path, tmp_path / "out")
    files = ("walk_a.mkv", "walk_b.mkv", "walk_a.json", "walk_b.csv")
    assert pair == Pair("walk", *(tmp_path / name for name in files))


def test_output_hidden_and_linked_folders_are_searched_once_or_not(tmp_path):
    touch(tmp_path, "walk/a.csv", "walk/b.csv", "out/x/a.csv", "out/x/b.csv", ".old/a.csv", ".old/b.csv")
    (tmp_path / "walk" / "loop").symlink_to(tmp_path)
    assert names_of(tmp_path) == ["walk"]


def test_two_pairs_of_one_name_are_refused(tmp_path):
    touch(tmp_path, "anna/walk_a.csv", "anna/walk_b.csv", "anna_walk/a.csv", "anna_walk/b.csv")
    with pytest.raises(UsageError, match="both be session anna_walk"):
        find_pairs(tmp_path, tmp_path / "out")


@pytest.mark.parametrize("name", ["summary.parquet", "SUMMARY.html"])
def test_no_session_takes_the_place_of_the_summary(name, tmp_path):
    touch(tmp_path, f"{name}_a.csv", f"{name}_b.csv")
    with pytest.raises(UsageError, match=f"would be session {name}"):
        find_pairs(tmp_path, tmp_path / "out")


def test_a_manifest(tmp_path):
    touch(tmp_path, "one.csv", "two.csv", "deep/three.mkv", "s.json")
    manifest = tmp_path / "m.csv"
    manifest.write_text(
        "﻿name,a,b,skeletons_a,person_b\nwalk, one.csv,two.csv,,7\n\nrun,deep/three.mkv,two.csv,s.json,\n",
        encoding="utf-8",
    )
    assert read_manifest(manifest) == [
        Pair("walk", tmp_path / "one.csv", tmp_path / "two.csv", person_b="7"),
        Pair("run", tmp_path / "deep/three.mkv", tmp_path / "two.csv", tmp_path / "s.json"),
    ]


@pytest.mark.parametrize(
    ("tracker", "option", "name"),
    [("blazepose", "tracker_model", "networks"), ("k4abt", "k4abt", "libk4abt.so")],
)
def test_workers_in_another_folder_find_the_files_of_the_options(
    tracker, option, name, tmp_path, monkeypatch
):
    touch(tmp_path, "pairs/a.mkv", "pairs/b.mkv", "networks/full", "elsewhere/x", "libk4abt.so")
    (tmp_path / "k.json").write_text(calibration_to_json(nominal_calibration(AZURE_KINECT)))
    seen = []

    def run(jobs, _):
        monkeypatch.chdir(tmp_path / "elsewhere")
        seen.extend(jobs)
        yield Outcome("pairs", None, "not fused")

    monkeypatch.setattr(processes, "run_in_processes", run)
    monkeypatch.chdir(tmp_path)
    files = "--calibrate", "k.json", "--tracker", tracker, f"--{option.replace('_', '-')}", name
    assert duplex("batch", "pairs", "--out", "out", *files) == 1
    options, identity = seen[0].options, seen[0].identity()["options"]
    assert (options.source, options.out) == (tmp_path / "pairs", tmp_path / "out")
    assert getattr(options, option) == tmp_path / name
    assert options.calibrate == str(tmp_path / "k.json")
    assert identity["calibrate"] == f"sha256:{checksum(tmp_path / 'k.json')}"
    (tmp_path / "k.json").unlink()  # as if the worker did not see this folder
    with pytest.raises(UsageError, match=r"k\.json"):
        seen[0].identity()


COUNTS = {f"{what}_{side}": 0 for what in ("dropped", "alone", "stale") for side in "ab"}


def row(name, state="fused", error="", **figures):
    job = Job(Pair(name, Path("a.csv"), Path("b.csv")), BatchOptions(source=Path(), out=Path()))
    known = dict.fromkeys(n for n in RANKED if n != "lost") | COUNTS | {"frames_a": 50, "frames_b": 50}
    record = {
        "figures": known | {"calibration": "pose <1>", "verdict": "good"} | figures,
        "warnings": ["<b>"],
        "identity": {},
    }
    return Row(job, state, record if state == "fused" else None, error)


def order(*rows):
    return [of.job.name for of in worst_first(rows)]


def test_failed_rows_come_first_then_the_worst_then_pending_ones():
    assert order(
        row("calm", views_agree=0.03, jumps_fused=0.0),
        row("left", "pending"),
        row("wild", views_agree=0.09, jumps_fused=0.2),
        row("lost", "failed", "no frames"),
        row("fair", views_agree=0.06, jumps_fused=0.1),
    ) == ["lost", "wild", "fair", "calm", "left"]


def test_frames_without_a_partner_count():
    one, two = row("one", dropped_a=20, alone_b=5), row("two")
    assert one.figures["lost"] == 0.25
    assert order(two, one) == ["one", "two"]


def test_the_table_is_in_si_units_and_the_page_escapes(tmp_path):
    rows = [row("bad", "failed", "a < b"), row("a b", views_agree=0.0625), row("rest", "pending")]
    write_parquet(rows, tmp_path / "s.parquet")
    table = pq.read_table(tmp_path / "s.parquet").to_pydict()
    assert table["name"] == ["bad", "a b", "rest"]
    assert table["views_agree"] == [None, 0.0625, None]
    assert table["session"] == [None, "a b/a b.rrd", None]
    write_page(rows, tmp_path / "s.html")
    page = (tmp_path / "s.html").read_text(encoding="utf-8")
    for words in ("a &lt; b", 'href="a%20b/a%20b.rrd"', "<td>62</td>", "pose &lt;1&gt;", "1 not fused yet"):
        assert words in page
    assert "<b>" not in page


def test_the_page_sorts_filters_and_explains(tmp_path):
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright")
    chromium = need_browser()
    random = np.random.default_rng(0)
    rows, words = [], ("good", "usable", "poor", "unknown")
    for k, apart in enumerate([None, *random.permutation(12) * 0.011]):
        told = {"verdict": words[k % 4], "verdict_reason": f"reason {k}" if k % 4 else ""}
        rows.append(row(f"n{k}", views_agree=apart, bone_error=0.0, good=k / 12, **told))
    write_page(rows, tmp_path / "s.html")
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        try:
            tab = browser.new_page()
            errors, asked = [], []
            tab.on("pageerror", lambda error: errors.append(str(error)))
            tab.on("request", lambda request: asked.append(request.url))
            tab.goto((tmp_path / "s.html").as_uri())
            shown, heads = tab.locator("#fused tbody tr:visible"), tab.locator("#fused th")
            names = heads.all_inner_texts()
            agree = names.index("views agree mm")

            def column(k):
                return [each.split("\t")[k].strip() for each in shown.all_inner_texts()]

            for turn in (1, -1):
                heads.nth(agree).click()
                *known, last = column(agree)
                assert last == "–"
                assert [int(each) for each in known] == sorted(map(int, known))[::turn]
            heads.nth(1).click()
            order = [each.split()[0] for each in column(1)]
            assert order == sorted(order, key=("poor", "unknown", "usable", "good").index)
            tab.locator("#word").select_option("poor")
            assert {each.split()[0] for each in column(1)} == {"poor"}
            assert tab.locator("#count").inner_text() == f"{shown.count()} of 13"
            tab.locator("#word").select_option("")
            tab.locator("#filter").fill("REASON 11")
            assert column(0) == ["n11"]
            meanings = tab.locator("details dt").all_text_contents()
            assert meanings == names[2:]
            assert (errors, asked) == ([], [(tmp_path / "s.html").as_uri()])
        finally:
            browser.close()
