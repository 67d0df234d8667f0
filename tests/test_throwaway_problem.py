"""A problem added, matched with and deleted again: that touches its own folder and one line."""

from __future__ import annotations

import difflib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

import rootmatch

SOURCES = Path(rootmatch.__file__).parent
OWN = Path(__file__).parent / "throwaway_problem" / "zoom"
LINE = '    "zoom": "zoom:Zoom",\n'
BEFORE = '    "rigid": "similarity:Rigid",\n'

MATCHED = """
import pickle
import numpy as np
import rootmatch as rm

source, target = np.loadtxt("a.csv", delimiter=",", skiprows=1), np.loadtxt("b.csv", delimiter=",", skiprows=1)
problem = rm.Zoom()
found = rm.match(source, target, problem, noise=0.01)
again = rm.Matcher(source, problem, noise=0.01).match(target)
assert found.assignment.tolist() == again.assignment.tolist() == list(range(5, -1, -1)), found.assignment
assert found.status is rm.Status.MATCHED
assert found.pose is None
assert pickle.loads(pickle.dumps(problem)) == problem
for argument, use in (
    ("pose", lambda: found.poses),
    ("normals", lambda: rm.match(source, target, problem, normals=np.ones((6, 3)))),
    ("noise", lambda: rm.match(source, target, problem, noise=(0.1, 0.1))),
    ("sampler", lambda: rm.match(source, target, problem, sampler="guided")),
    ("residual", lambda: rm.match(source, target, problem, residual="qr")),
    ("residual", lambda: rm.residuals(source, target, problem, [[0, 1, 2]], [[0, 1, 2]], "svd")),
):
    try:
        use()
    except rm.InputError as error:
        assert str(error).startswith(f"{argument}: zoom "), error
    else:
        raise AssertionError(f"{argument} is not refused")
"""


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Python on the copy of the package, interpreted: to compile it would take longer than all else here."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_DISABLE_JIT": "1"}
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def files(folder: Path) -> dict[Path, str]:
    return {path.relative_to(folder): path.read_text(encoding="utf-8") for path in folder.rglob("*.py")}


def test_a_problem_is_a_folder_and_a_line(tmp_path: Path) -> None:
    package = tmp_path / "rootmatch"
    shutil.copytree(SOURCES, package, ignore=shutil.ignore_patterns("__pycache__"))
    points = np.random.default_rng(5).uniform(-1.0, 1.0, (6, 2))
    for name, rows in (("a.csv", points), ("b.csv", 1.5 * points[::-1] + [0.3, -0.2])):
        np.savetxt(tmp_path / name, rows, delimiter=",", header="x,y", comments="")
    command = "-m", "rootmatch", "match", "a.csv", "b.csv", "--problem", "zoom", "--noise", "0.01", "--json"

    before = files(package)
    assert "invalid value for '--problem'" in run(tmp_path, *command).stderr.lower()

    shutil.copytree(OWN, package / "problems" / "zoom", ignore=shutil.ignore_patterns("__pycache__"))
    listed = package / "problems" / "__init__.py"
    listed.write_text(listed.read_text(encoding="utf-8").replace(BEFORE, BEFORE + LINE), encoding="utf-8")
    added = run(tmp_path, "-c", MATCHED)
    assert added.returncode == 0, added.stderr
    printed = run(tmp_path, *command)
    assert printed.returncode == 0, printed.stderr
    assert json.loads(printed.stdout)["assignment"] == list(range(5, -1, -1))
    after = files(package)
    touched = [path for path in after if after[path] != before.get(path)]
    assert {path.parent if path.parent.name == "zoom" else path for path in touched} == {
        Path("problems/zoom"),
        Path("problems/__init__.py"),
    }
    changes = difflib.ndiff(*(text[Path("problems/__init__.py")].splitlines() for text in (before, after)))
    assert [change for change in changes if change[0] in "+-"] == [f"+ {LINE.rstrip()}"]

    shutil.rmtree(package / "problems" / "zoom")
    listed.write_text(listed.read_text(encoding="utf-8").replace(LINE, ""), encoding="utf-8")
    assert files(package) == before
    assert "invalid value for '--problem'" in run(tmp_path, *command).stderr.lower()
    assert run(tmp_path, "-c", "import rootmatch as rm\nassert not hasattr(rm, 'Zoom')").returncode == 0
