"""The summary of a batch: order, table and page."""

from pathlib import Path

import pyarrow.parquet as pq

from viewer_app.batch.finding import Pair
from viewer_app.batch.jobs import Job
from viewer_app.batch.summary import RANKED, Row, worst_first, write_page, write_parquet
from viewer_app.options.sensing import BatchOptions

COUNTS = {f"{what}_{side}": 0 for what in ("dropped", "alone", "stale") for side in "ab"}


def row(name, state="fused", error="", **figures):
    job = Job(Pair(name, Path("a.csv"), Path("b.csv")), BatchOptions(source=Path(), out=Path()))
    known = dict.fromkeys(n for n in RANKED if n != "lost") | COUNTS | {"frames_a": 50, "frames_b": 50}
    record = {"figures": known | {"calibration": "pose <1>"} | figures, "warnings": ["<b>"], "identity": {}}
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
