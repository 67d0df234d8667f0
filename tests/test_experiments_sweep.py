"""A sweep loses nothing when it is killed, and gives the same rows however it is run."""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rootmatch.errors import InputError, RootmatchError
from rootmatch.research.paper.settings import Method, Setting
from rootmatch.research.store import Store
from rootmatch.research.sweep import run, units
from tiny_sweep import METHODS, PLAN, SEEDS, UNITS, dies, sweep

ROWS = sum(len(sizes) for _, sizes in METHODS) * len(PLAN) * len(SEEDS)


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """Rows of a sweep in this process without interruption."""
    return sweep(tmp_path_factory.mktemp("unbroken") / "results.sqlite")


def units_done(path):
    """How many units the store holds, seen from another process."""
    if not path.exists():
        return 0
    with sqlite3.connect(path) as connection:
        try:
            return connection.execute("SELECT COUNT(*) FROM work").fetchone()[0]
        except sqlite3.OperationalError:  # not laid out yet
            return 0


def start(path, pause):
    command = [sys.executable, str(Path(__file__).with_name("tiny_sweep.py")), str(path), "1", str(pause)]
    return subprocess.Popen(command, start_new_session=True)


def kill_once_some_are_done(path, more):
    """Start the sweep, kill it the hard way when it has done so many more units, and say how many are kept."""
    before = units_done(path)
    process = start(path, 0.15)
    deadline = time.monotonic() + 60
    while units_done(path) < before + more:
        assert process.poll() is None, "the sweep ended before it was killed"
        assert time.monotonic() < deadline, "the sweep does not get on"
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    return units_done(path)


def test_unbroken_sweep_has_every_row(unbroken):
    assert len(unbroken) == ROWS
    assert len({row[:10] for row in unbroken}) == ROWS


def test_killed_twice_and_resumed_gives_the_same_rows_bit_for_bit(tmp_path, unbroken):
    path = tmp_path / "results.sqlite"
    first = kill_once_some_are_done(path, more=2)
    second = kill_once_some_are_done(path, more=2)
    assert 2 <= first < second < UNITS
    # Nothing is worked out twice: what was done before a kill was kept.
    with Store(path) as store:
        assert len(units(PLAN, SEEDS, store)) == UNITS - second
    # Two processes give the rows of one.
    assert sweep(path, jobs=2) == unbroken
    assert units_done(path) == UNITS


def test_dask_with_two_workers_gives_the_same_rows(tmp_path, unbroken, monkeypatch):
    distributed = pytest.importorskip("distributed")
    # The workers import the helper module from here.
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)]))
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        rows = sweep(tmp_path / "results.sqlite", scheduler=cluster.scheduler_address)
    assert rows == unbroken


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
