"""A sweep of seconds, for tests that kill it and those whose workers import it."""

import os
import sqlite3
import time
from functools import partial
from pathlib import Path

from rootmatch.research.paper.settings import DEFAULT_PIPELINE, Method, Setting
from rootmatch.research.paper.work_unit import evaluate
from rootmatch.research.store import Store
from rootmatch.research.sweep import run, units

SIZES = (500, 1000, 3000)
METHODS = (
    (Method("qr", "power-l1", 1e-2), SIZES),
    (Method("qr", "power-dense", 1e-2), SIZES),
    (Method("qr-both", "power-l1", 1e-2), SIZES[1:]),
    (DEFAULT_PIPELINE, SIZES),
)
PLAN = dict.fromkeys((Setting("up2p", 0, 0.0), Setting("up2p", 0, 0.5, motions=2), Setting("up2p", 5, 0.5)), METHODS)
SEEDS = range(3, 9)
UNITS = 12  # two numbers of outliers, six seeds


def paused(unit, pause):
    time.sleep(pause)
    return evaluate(unit)


def dies(unit):
    """Work out the first seed's units; at the second one this process ends at once, as for lack of memory."""
    if unit.seed > SEEDS[0]:
        os._exit(1)
    return evaluate(unit)


def sweep(path, jobs=1, pause=0.0, scheduler=None, progress=None):
    with Store(Path(path)) as store:
        work = units(PLAN, SEEDS, store)
        run(work, store, jobs=jobs, scheduler=scheduler, progress=progress, function=partial(paused, pause=pause))
        return store.rows()


def units_done(path):
    """How many units a store holds, seen from another process."""
    if not path.exists():
        return 0
    connection = sqlite3.connect(path)
    try:
        return int(connection.execute("SELECT COUNT(*) FROM work").fetchone()[0])
    except sqlite3.OperationalError:  # not laid out yet
        return 0
    finally:
        connection.close()
