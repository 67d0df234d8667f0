"""What a release is made of agrees with itself: versions, dependencies, the Pythons that are tested."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_one_version() -> None:
    version = re.search(r'__version__ = "(.+)"', (ROOT / "src/rootmatch/_version.py").read_text()).group(1)
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    recipe = yaml.safe_load((ROOT / "conda/recipe.yaml").read_text())
    assert citation["version"] == recipe["context"]["version"] == version


def test_the_paper_is_cited_by_title_and_authors() -> None:
    paper = yaml.safe_load((ROOT / "CITATION.cff").read_text())["preferred-citation"]
    readme = re.sub(r"\s+", " ", (ROOT / "README.md").read_text())
    assert paper["title"] in readme
    for author in paper["authors"]:
        assert author["family-names"] in readme


@pytest.mark.parametrize("source", [None, "https://host.example/rootmatch"])
def test_the_description_on_an_index_has_no_link_that_leads_nowhere(
    source: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has all words of the README, and what is left of its links is absolute."""
    monkeypatch.syspath_prepend(ROOT / "build_backend")
    from index_page import for_index

    text = (ROOT / "README.md").read_text(encoding="utf-8")
    given, shown = (MarkdownIt("commonmark").enable("table").render(page) for page in (text, for_index(text, source)))
    links = re.findall(r'(?:href|src)="([^"]*)"', shown)
    assert all(link.startswith("https://") for link in links)
    assert len(links) == (0 if source is None else len(re.findall(r'(?:href|src)="', given)))
    words = [re.sub(r"<!--.*?-->|<[^>]*>|\s", "", page, flags=re.DOTALL) for page in (given, shown)]
    assert words[1].startswith(words[0])


def test_the_conda_recipe_has_the_dependencies_of_the_package() -> None:
    recipe = yaml.safe_load((ROOT / "conda/recipe.yaml").read_text())["requirements"]["run"]
    ours = {line.replace(" ", "").replace("matplotlib-base", "matplotlib") for line in recipe}
    assert ours == {*PROJECT["dependencies"], f"python{PROJECT['requires-python']}"}


def test_every_python_of_the_classifiers_is_in_the_matrix() -> None:
    versions = {found.group(1) for line in PROJECT["classifiers"] if (found := re.search(r"Python :: (3\.\d+)$", line))}
    matrix = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())["jobs"]["checks"]["strategy"]["matrix"]
    assert versions
    assert versions <= set(matrix["python"])


def test_the_changelog_and_the_citation_agree() -> None:
    """A version is dated in both, or not released yet and dated in neither."""
    version = re.search(r'__version__ = "(.+)"', (ROOT / "src/rootmatch/_version.py").read_text()).group(1)
    heads = re.findall(r"^## \[(.+?)\](?: - (\S+))?$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert heads[0][0] in ("Unreleased", version)
    dates = dict(heads)
    released = yaml.safe_load((ROOT / "CITATION.cff").read_text()).get("date-released")
    assert (dates.get(version) or None) == (released and str(released))
    assert all(dates[name] for name in dates if name != "Unreleased")


def test_a_program_that_uses_the_library_is_typed(tmp_path: Path) -> None:
    """What mypy makes of the public names from outside: no hint is missing, and a wrong use is told."""
    program = tmp_path / "program.py"
    program.write_text(
        "import numpy as np\n"
        "import rootmatch as rm\n"
        "found: rm.Match = rm.match(np.zeros((5, 3)), np.zeros((5, 2)), rm.P3P(rm.Camera(1.0, 1.0, 0.0, 0.0)))\n"
        "probability: float | None = found.probability\n"
        "matcher = rm.Matcher(np.zeros((5, 3)), rm.P3P(rm.Camera(1.0, 1.0, 0.0, 0.0)), noise=0.5)\n"
        "status: rm.Status = matcher.match(np.zeros((5, 2))).status\n"
        "rm.match('points', 1, 2, nose=1.0)\n"
    )
    command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", str(program)]
    environment = {**os.environ, "MYPYPATH": str(ROOT / "src"), "MYPY_CACHE_DIR": str(ROOT / ".mypy_cache")}
    told = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment, check=False).stdout
    # by name: of a program that has not changed mypy repeats what it said, with the folder of the run before
    about = [line for line in told.splitlines() if f"{program.name}:" in line]
    assert [line for line in about if ":7:" not in line] == [], told
    assert any("nose" in line for line in about), told
