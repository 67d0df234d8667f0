"""The store keeps whole batches, each row once, and refuses files that are not its own."""

import os
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from rootmatch.errors import InputError
from rootmatch.research.paper.settings import Method, Setting
from rootmatch.research.store import Row, Store

UP2P = Setting("up2p", 5, 0.25)
QR = Method("qr", "power-l1", 1e-2)


def row(seed=0, samples=100, accuracy=0.5, setting=UP2P, method=QR):
    return Row(setting, method, seed, samples, accuracy, 1.25, 42, 7, True)


def test_rows_come_back_as_they_were(tmp_path):
    with Store(tmp_path / "new folder" / "results.sqlite") as store:
        store.add([row(seed=1, accuracy=0.1 + 0.2), row(seed=0)], "versions")
        assert store.rows() == [
            ("up2p", 5, 0.25, 0.0, 1, "qr", "power-l1", 0.01, 0, 100, 0.5, 1.25, 42, 7, 1, "versions"),
            ("up2p", 5, 0.25, 0.0, 1, "qr", "power-l1", 0.01, 1, 100, 0.1 + 0.2, 1.25, 42, 7, 1, "versions"),
        ]


def test_the_first_row_of_a_key_stays(tmp_path):
    with Store(tmp_path / "results.sqlite") as store:
        store.add([row(accuracy=0.5)], "one")
        store.add([row(accuracy=0.9), row(samples=200)], "two")
        assert [(r[9], r[10], r[15]) for r in store.rows()] == [(100, 0.5, "one"), (200, 0.5, "two")]
        assert store.versions() == ["one", "two"]


def test_done_and_accuracies(tmp_path):
    other = Setting("3p1", 0, 0.25, 5.0)
    with Store(tmp_path / "results.sqlite") as store:
        store.add([row(seed=s, samples=n, accuracy=s / 10) for s in range(5) for n in (100, 200)], "v", 1.5)
        store.add([row(setting=other)], "v", 2.0)
        assert store.done()[UP2P, QR, 3] == {100, 200}
        assert store.done()[other, QR, 0] == {100}
        assert store.accuracies(UP2P, QR, range(1, 3)) == {
            100: {1: 0.1, 2: 0.2},
            200: {1: 0.1, 2: 0.2},
        }
        assert store.accuracies(other, Method("svd", "power-l1", 1e-2), range(9)) == {}
        assert store.seconds() == 3.5


def test_a_batch_that_breaks_leaves_nothing(tmp_path):
    def broken():
        yield row(seed=0)
        raise RuntimeError("broken")

    with Store(tmp_path / "results.sqlite") as store:
        with pytest.raises(RuntimeError, match="broken"):
            store.add(broken(), "v")
        assert store.rows() == []
        assert store.versions() == []
        store.add([row()], "v")
        assert len(store.rows()) == 1


def test_two_runs_may_write_to_one_store(tmp_path):
    with Store(tmp_path / "results.sqlite") as first, Store(tmp_path / "results.sqlite") as second:
        first.add([row(seed=0)], "v")
        second.add([row(seed=0), row(seed=1)], "v")
        assert first.rows() == second.rows()
        assert len(first.rows()) == 2


def test_a_file_of_something_else_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "results.sqlite"
    path.write_text("a letter to a friend, long enough to be no empty file\n" * 20)
    before = path.read_bytes()
    with pytest.raises(InputError, match="not a store"):
        Store(path)
    assert path.read_bytes() == before


def test_another_layout_is_refused(tmp_path):
    path = tmp_path / "results.sqlite"
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA user_version=99")
    with pytest.raises(InputError, match="layout 99, expected 2"):
        Store(path)


def filled(path, seeds=range(40)):
    """A store of some pages, all of them in the file itself."""
    with Store(path) as store:
        for seed in seeds:
            store.add([row(seed=seed, samples=n) for n in range(1, 40)], "v")
        rows = store.rows()
        store._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    return rows


def damaged(path, how):
    data = path.read_bytes()
    if how == "cut short":
        path.write_bytes(data[: len(data) // 2])
    elif how == "overwritten":
        path.write_bytes(data[:6000] + b"\xa5" * 3000 + data[9000:])
    elif how == "head":
        path.write_bytes(b"\0" * 100 + data[100:])


@pytest.mark.parametrize("how", ["cut short", "overwritten", "head"])
def test_a_damaged_store_is_refused_and_left_alone(tmp_path, how):
    path = tmp_path / "results.sqlite"
    filled(path)
    damaged(path, how)
    before = path.read_bytes()
    with pytest.raises(InputError, match="damaged, or not a store"):
        Store(path)
    assert path.read_bytes() == before


def test_a_database_of_something_else_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "results.sqlite"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE friends (name TEXT)")
    connection.close()
    before = path.read_bytes()
    with pytest.raises(InputError, match="another database"):
        Store(path)
    assert path.read_bytes() == before


def test_a_store_that_another_program_holds(tmp_path, monkeypatch):
    monkeypatch.setattr("rootmatch.research.store.WAITS", 0.1)
    path = tmp_path / "results.sqlite"
    with Store(path) as store:
        other = sqlite3.connect(path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(InputError, match=r"held it for 0\.1 s; end that one"):
            store.add([row()], "v")
        other.execute("ROLLBACK")
        other.close()
        store.add([row()], "v")
        assert len(store.rows()) == 1


def test_a_store_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot be made"):
        Store(tmp_path / "file" / "folder" / "results.sqlite")
    (tmp_path / "results.sqlite").mkdir()
    with pytest.raises(InputError, match="unable to open database file; check its permissions"):
        Store(tmp_path / "results.sqlite")


FULL = """
import resource, sys
from pathlib import Path
from rootmatch.errors import InputError
from test_experiments_store import row
from rootmatch.research.store import Store
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
done = 0
try:
    with Store(Path(sys.argv[1])) as store:
        for seed in range(1000):
            store.add([row(seed=seed, samples=n) for n in range(1, 40)], "v")
            done += 1
except InputError as error:
    print(done, error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limits of files there")
def test_a_full_disk_keeps_whole_batches_and_the_run_goes_on_later(tmp_path):
    path = tmp_path / "results.sqlite"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])}
    command = [sys.executable, "-c", FULL, str(path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    batches, _, text = done.stdout.partition(" ")
    assert "free some space" in text
    with Store(path) as store:
        assert 0 < int(batches) < 1000
        assert len(store.rows()) == 39 * int(batches)
        store.add([row(seed=1000)], "v")
        assert len(store.rows()) == 39 * int(batches) + 1
