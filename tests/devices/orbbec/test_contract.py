"""The stand-in for pyorbbecsdk and the real library, without hardware, held to the same clauses."""

import sys

import pytest

from tests.helpers.orbbec.contract import BY_HAND, CLAUSES


@pytest.mark.parametrize("clause", CLAUSES, ids=lambda clause: clause.__name__)
def test_the_stand_in_says_what_the_real_library_says(orbbecs, real_orbbec, clause, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert orbbecs.devices == []
    assert real_orbbec[clause.__name__] == clause(sys.modules["pyorbbecsdk"])


@pytest.mark.parametrize("clause", BY_HAND, ids=lambda clause: clause.__name__)
def test_this_program_reads_what_the_real_library_makes(real_orbbec, clause):
    assert real_orbbec[clause.__name__] is None
