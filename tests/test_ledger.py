"""The ledger counts what is code, and no limit rises without a reason."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import ledger

MODULE = '''"""Text that is no code.

3 of 4 lines."""

# a comment, 5
HALF, TENTH, FAR = 0.5, 0.1, -7


class Row:
    name: str
    """Of the row; 8 letters."""

    def text(self):
        return ("one token "
                """of two lines""")
'''


def test_code_is_neither_comment_nor_docstring():
    assert ledger.counted(MODULE) == {"code": 6, "tokens": 29, "modules": 1, "numbers": 2}


limits = st.dictionaries(st.sampled_from(ledger.FIGURES), st.integers(0, 10**6), min_size=1)
rows = st.fixed_dictionaries(
    {
        name: st.tuples(limits, st.sampled_from(["", "B is in A", "one of two"]))
        for name in ("fusion", "tests")
    }
)


@given(rows)
def test_a_ledger_is_written_as_it_is_read(rows):
    text = ledger.FILE.read_text(encoding="utf-8")
    assert ledger.limits_of(ledger.with_limits(text, ledger.limits_of(text) | rows)) == (
        ledger.limits_of(text) | rows
    )


@given(rows, rows)
def test_limits_are_lowered_to_what_is_there_and_never_raised(rows, there):
    now = {name: dict.fromkeys(ledger.FIGURES, 0) | figures for name, (figures, _) in there.items()}
    low = ledger.lowered(rows, now)
    assert list(ledger.faults(low, {}, [rows])) == []
    for name, (limits, _) in low.items():
        assert all(limits[f] == min(rows[name][0][f], now[name][f]) for f in rows[name][0])


@pytest.mark.parametrize(
    ("limit", "why", "said"),
    [
        (9, "", "fusion: 10 code, over the limit of 9."),
        (10, "", None),
        (11, "", "fusion: the limit of code was lower: say in 'why' what was replaced."),
        (11, "old", "fusion: the limit of code was lower: say in 'why' what was replaced."),
        (11, "new", None),
    ],
)
def test_a_limit_holds_and_rises_with_a_new_reason_only(limit, why, said):
    earlier = [{"fusion": ({"code": limit}, why)}, {"fusion": ({"code": 10}, "old")}]
    found = list(ledger.faults({"fusion": ({"code": limit}, why)}, {"fusion": {"code": 10}}, earlier))
    assert found == ([] if said is None else [said])
