"""The stand-in for pyorbbecsdk and the real library, without hardware, held to the same clauses."""

import sys

import pytest

from tests.helpers.orbbec import contract
from tests.helpers.orbbec.contract import CLAUSES

NAMES = [clause.__name__ for clause in CLAUSES]


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("clause", CLAUSES, ids=NAMES)
def test_the_real_library_keeps_it_and_says_the_same(orbbecs, real_orbbec, clause):
    assert orbbecs.devices == []
    real = real_orbbec[clause.__name__]
    assert real.get("fault") is None
    if clause is not contract.names:
        assert real["said"] == clause(sys.modules["pyorbbecsdk"])


def test_the_standin_has_no_name_that_the_real_library_lacks(orbbecs, real_orbbec):
    assert orbbecs.devices == []
    real = real_orbbec["names"]["said"]
    for kind, names in contract.names(sys.modules["pyorbbecsdk"]).items():
        assert set(names) - set(real[kind]) == set(), kind
