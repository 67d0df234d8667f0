"""What a start does not load, and kernels compiled ahead of it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from rootmatch.errors import RootmatchError
from rootmatch.precompile import warm_up, workers
from rootmatch.precompile.steps import STEPS

CALLS = """
import json, os, sys
from rootmatch.cli import main
found = []
for folder, *words in json.loads(sys.argv[1]):
    os.chdir(folder)
    sys.argv = ["rootmatch", *words]
    code = 0
    try:
        main()
    except SystemExit as end:
        code = end.code
    found.append([code, [name for name in ("numpy", "numba") if name in sys.modules]])
print()
print(json.dumps(found))
"""
MATCH = ["match", "model.csv", "image.csv", "--problem", "p3p", "--camera"]

COUNTED = """
from numba.core import event
import rootmatch as rm
from rootmatch.simulation import up2p_scene
compiled = event.RecordingListener()
event.register("numba:compile", compiled)
scene = up2p_scene(8, 2, 0.5, 3)
rm.match(scene.source, scene.target, scene.problem, noise=0.5)
assert not compiled.buffer, compiled.buffer
"""


def called(*commands: tuple[str, ...]) -> list[list[object]]:
    """Exit codes of commands, each with its folder before it, and what is imported by then of NumPy and Numba."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    program = [sys.executable, "-c", CALLS, json.dumps(commands)]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found: list[list[object]] = json.loads(done.stdout.splitlines()[-1])
    return found


def test_help_scenes_and_bad_input_take_no_numba(tmp_path: Path) -> None:
    here, scene, broken = (str(tmp_path / name) for name in (".", "p3p", "broken"))
    Path(broken).mkdir()
    (tmp_path / "broken" / "image.csv").write_text("x,y\n1,none\n")
    (tmp_path / "broken" / "model.csv").write_text("x,y,z\n1,2,3\n")
    (tmp_path / "broken" / "camera.json").write_text(json.dumps({"fx": 1000, "fy": 1000, "cx": 320, "cy": 240}))
    plain = [(here, "--help"), (here, "match", "--help"), (broken, *MATCH, "camera.json", "--seed", "none")]
    made = [(here, "simulate", name, "--points", "6", "--output", name) for name in ("p3p", "up2p", "3p1")]
    refused = [(scene, *MATCH, "absent.json")]
    for name in ("p3p", "up2p", "3p1", "similarity"):
        words = ["--problem", name, *(() if name == "similarity" else ("--camera", "camera.json"))]
        model = "image.csv" if name in ("3p1", "similarity") else "model.csv"
        refused.append((broken, "match", model, "image.csv", *words))
    found = called(*plain, *made, *refused)
    assert found[:3] == [[0, []], [0, []], [2, []]]
    assert found[3:] == [[0, ["numpy"]]] * len(made) + [[2, ["numpy"]]] * len(refused)


def test_a_match_imports_scipy_where_it_is_needed_only_and_functions_are_not_their_modules() -> None:
    """SciPy's optimisation and search trees take longer to import than Numba's kernels to load."""
    code = (
        "import sys, rootmatch.api, rootmatch.cli.match, rootmatch.tracking.tracker\n"
        "print([name for name in ('scipy.optimize', 'scipy.spatial', 'scipy.linalg') if name in sys.modules])\n"
        "import rootmatch.precompile.steps, rootmatch\n"
        "print(type(rootmatch.match).__name__, type(rootmatch.warmup).__name__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[]", "function function"]


def test_after_a_warm_up_a_match_compiles_nothing() -> None:
    told: list[tuple[int, int]] = []
    warm_up(progress=lambda done, total: told.append((done, total)))
    count = len(STEPS["first"]())
    assert told[0] == (0, count)
    assert told[-1] == (count, count)
    done = subprocess.run([sys.executable, "-c", COUNTED], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_step_that_fails_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(workers.STEPS, "first", lambda: {"no such step": lambda: None})
    with pytest.raises(RootmatchError, match=r"warm-up, no such step: .*KeyError"):
        warm_up(workers=1)
