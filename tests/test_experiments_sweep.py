"""A sweep gives the same rows however it is run, and works out none of them twice."""

import pytest

from rootmatch.errors import InputError, RootmatchError
from rootmatch.research.paper.settings import Method, Setting
from rootmatch.research.store import Store
from rootmatch.research.sweep import run, units
from tiny_sweep import METHODS, PLAN, SEEDS, UNITS, dies, sweep, units_done

ROWS = sum(len(sizes) for _, sizes in METHODS) * len(PLAN) * len(SEEDS)


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """Rows of a sweep in this process without interruption."""
    return sweep(tmp_path_factory.mktemp("unbroken") / "results.sqlite")


def test_unbroken_sweep_has_every_row(unbroken):
    assert len(unbroken) == ROWS
    assert len({row[:10] for row in unbroken}) == ROWS


def test_what_is_there_is_not_worked_out_again_and_two_processes_give_the_rows_of_one(tmp_path, unbroken):
    """That a kill loses nothing of it is tested in test_torture.py."""
    path = tmp_path / "results.sqlite"
    with Store(path) as store:
        run(units(PLAN, SEEDS, store)[:4], store, jobs=1)
        assert len(units(PLAN, SEEDS, store)) == UNITS - 4
    assert sweep(path, jobs=2) == unbroken
    assert units_done(path) == UNITS


def test_scheduler_that_does_not_answer_is_named(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("rootmatch.backends.dask.CONNECT_SECONDS", 0.5)
    with Store(tmp_path / "results.sqlite") as store:
        work = units(PLAN, SEEDS, store)[:1]
        with pytest.raises(InputError, match=r"tcp://127\.0\.0\.1:9 does not answer"):
            run(work, store, scheduler="tcp://127.0.0.1:9")


def test_more_seeds_and_methods_add_to_what_is_there(tmp_path):
    setting, method, other = Setting("up2p"), Method("qr", "power-l1", 1e-2), Method("qr-both", "power-l1", 1e-2)
    with Store(tmp_path / "results.sqlite") as store:
        run(units({setting: ((method, (100,)),)}, range(2), store), store, jobs=1)
        plan = {setting: ((method, (100,)), (other, (100, 200)))}
        work = units(plan, range(3), store)
        assert [unit.rows for unit in work] == [2, 2, 3]
        run(work, store, jobs=1)
        assert units(plan, range(3), store) == []
        assert len(store.rows()) == 9


def test_progress_counts_rows(tmp_path):
    told = []
    sweep(tmp_path / "results.sqlite", progress=lambda done, total: told.append((done, total)))
    assert len(told) == UNITS
    assert sorted(told) == told
    assert told[-1] == (ROWS, ROWS)


def test_no_processes_is_refused(tmp_path):
    with Store(tmp_path / "results.sqlite") as store, pytest.raises(InputError, match="jobs: 0"):
        run(units(PLAN, SEEDS, store), store, jobs=0)


def test_a_failing_unit_ends_the_sweep_and_keeps_what_was_done(tmp_path):
    calls = []

    def fail_later(unit):
        calls.append(unit)
        if len(calls) > 2:
            raise RuntimeError("broken")
        return []

    path = tmp_path / "results.sqlite"
    with Store(path) as store, pytest.raises(RuntimeError, match="broken"):
        run(units(PLAN, SEEDS, store), store, jobs=1, function=fail_later)
    assert units_done(path) == 2


def test_a_worker_that_dies_is_said_in_one_line_and_the_sweep_goes_on(tmp_path, unbroken):
    path = tmp_path / "results.sqlite"
    with Store(path) as store, pytest.raises(RootmatchError, match="a worker process died"):
        run(units(PLAN, SEEDS, store), store, jobs=2, function=dies)
    assert sweep(path) == unbroken
