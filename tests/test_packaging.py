"""What a stranger meets first: the set-up, a light import, a README that runs, files that fit any machine."""

import importlib
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from rootmatch.jit import sources

ROOT = Path(__file__).resolve().parents[1]
MAKE = shutil.which("make")


def tracked_files() -> list[Path]:
    git = shutil.which("git")
    if git is None or not (ROOT / ".git").exists():
        pytest.skip("not a git clone: which files are tracked is unknown")
    listed = subprocess.run([git, "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True, text=True).stdout
    return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).is_file()]


def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_version_is_said_once() -> None:
    import rootmatch

    assert re.fullmatch(r"\d+\.\d+\.\d+", rootmatch.__version__)
    assert "version" not in project()["project"]
    try:
        installed = importlib.metadata.version("rootmatch")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("rootmatch is on the path but not installed")
    assert installed == rootmatch.__version__


def test_package_says_that_it_is_typed() -> None:
    assert (ROOT / "src" / "rootmatch" / "py.typed").is_file()


def test_script_points_to_a_function() -> None:
    module, function = project()["project"]["scripts"]["rootmatch"].split(":")
    assert callable(getattr(importlib.import_module(module), function))


def test_import_brings_no_heavy_library() -> None:
    heavy = ["matplotlib", "typer", "rich", "dask", "plotly", "sympy", "cv2", "numba.cuda", "rootmatch.cli"]
    heavy += ["rootmatch.derivation.derive", "rootmatch.hypergraph.invariants", "rootmatch.problems.derived.store"]
    code = f"import sys, rootmatch; print(*[name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout.split() == []


def test_public_names_exist() -> None:
    import rootmatch

    missing = [name for name in rootmatch.__all__ if not hasattr(rootmatch, name)]
    assert missing == []
    contract = {"Camera", "P3P", "UP2P", "ThreePlusOne", "match", "Match", "residuals", "AffinityTensor"}
    assert contract <= set(rootmatch.__all__)


def test_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert blocks
    names: dict = {}
    for block in blocks:
        exec(compile(block, "README.md", "exec"), names)
    assert (names["match"].assignment == names["scene"].truth).all()


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "examples/board/README.md"])
def test_links_lead_somewhere(name: str) -> None:
    page = ROOT / name
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8"))
    assert [link for link in links if "://" not in link and not (page.parent / link).exists()] == []


def test_tracked_files_fit_any_machine() -> None:
    # Written so that this file does not hold what it looks for.
    machine = re.compile(r"(?<![\w.])/(?:tm[p]|hom[e]|roo[t]|wor[k])/\w|index[-_]url|files\.pythonhosted")
    faults = []
    for path in tracked_files():
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except UnicodeDecodeError:
            continue
        faults += [f"{path.relative_to(ROOT)}:{i}: {line}" for i, line in enumerate(lines, 1) if machine.search(line)]
    assert faults == []
    assert [path.name for path in tracked_files() if path.suffix == ".lock"] == []


def test_modules_stay_small() -> None:
    long = {
        str(path.relative_to(ROOT)): count
        for path in sorted((ROOT / "src").rglob("*.py"))
        if (count := len(path.read_text(encoding="utf-8").splitlines())) > 350
    }
    assert long == {}


def test_ci_is_executable() -> None:
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


def fake_python(folder: Path, refuses: str) -> Path:
    """An interpreter that fails for every call whose arguments match a shell pattern."""
    script = folder / "fake-python"
    script.write_text(f'#!/bin/sh\ncase "$*" in {refuses}) exit 1;; esac\nexec "{sys.executable}" "$@"\n')
    script.chmod(0o755)
    return script


@pytest.mark.skipif(MAKE is None, reason="make is not installed")
@pytest.mark.parametrize(
    ("refuses", "advice"),
    [("*", "Python 3.11 or newer"), ('"-m venv"*|"-m pip"*', "python3-venv")],
    ids=["old python", "no venv"],
)
def test_make_says_what_is_missing(tmp_path: Path, refuses: str, advice: str) -> None:
    shutil.copy(ROOT / "Makefile", tmp_path)
    (tmp_path / "src").mkdir()
    command = [str(MAKE), f"PYTHON={fake_python(tmp_path, refuses)}", "demo"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False, text=True)
    assert done.returncode != 0
    assert advice in done.stderr
    assert not (tmp_path / ".venv").exists()


def test_digest_follows_every_source_of_compiled_code(tmp_path: Path) -> None:
    package = tmp_path / "rootmatch"
    (package / "algebra").mkdir(parents=True)
    (package / "driver.py").write_text("from numba import njit\nfrom rootmatch.algebra import kernel\n")
    (package / "apart.py").write_text("import numpy\n")
    kernel = package / "algebra" / "kernel.py"
    names = []
    for text in ("b = 1", "b = 2", "b = 1"):
        kernel.write_text(text)
        names.append(sources.digest(sources.compiled_sources(package), package))
    (package / "apart.py").write_text("import sys\n")
    names.append(sources.digest(sources.compiled_sources(package), package))
    kernel.rename(package / "kernel.py")
    names.append(sources.digest(sources.compiled_sources(package), package))
    assert names[0] == names[2] == names[3]
    assert len(set(names)) == 3


def test_kernels_are_cached_apart_from_the_sources() -> None:
    import numba

    assert os.environ["NUMBA_CACHE_DIR"] == numba.config.CACHE_DIR
    assert Path(numba.config.CACHE_DIR).name.startswith("sources-")
