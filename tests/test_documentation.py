"""Every code block of the README and of the pages runs as it stands, and every link of theirs leads somewhere."""

import contextlib
import csv
import importlib
import io
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest
from PIL import Image

from commands import run
from rootmatch import P3P, UP2P, ThreePlusOne

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    page for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")]
    if not {"_build", "gallery", "concepts", "output"} & set(page.relative_to(ROOT).parts)
)  # fmt: skip
ELSEWHERE = {
    "docs/bring-your-own-problem.md": "runs in test_own_problem_guide.py",
}
"""Pages whose blocks run in another test."""


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


WITH_CODE = [page for page in PAGES if blocks(page) and name_of(page) not in ELSEWHERE]


@pytest.mark.parametrize("page", WITH_CODE, ids=name_of)
def test_code_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROOTMATCH_CACHE_DIR", str(tmp_path / "derived"))
    names: dict = {"__name__": "page"}
    with contextlib.redirect_stdout(io.StringIO()):
        for block in blocks(page):
            exec(compile(block, name_of(page), "exec"), names)


def shown_commands(page: Path) -> list[tuple[list[str], list[str]]]:
    """Commands of a page whose output it shows, each with the lines of that."""
    found = []
    for block in re.findall(r"(?:^ {4}\S.*\n(?:(?: {4}.*)?\n)*)", page.read_text(encoding="utf-8"), re.MULTILINE):
        for part in re.split(r"^ {4}\$ ", block.replace("\\\n", " "), flags=re.MULTILINE)[1:]:
            command, *lines = [line.strip() for line in part.splitlines() if line.strip()]
            if lines:
                found.append((shlex.split(command), lines))
    return found


def test_commands_print_what_their_page_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of docs/cli.md, but for the seconds."""
    monkeypatch.chdir(tmp_path)
    shown = shown_commands(ROOT / "docs" / "cli.md")
    assert len(shown) == 5
    for (program, *arguments), expected in shown:
        assert program == "rootmatch"
        result = run(*arguments)
        printed = [re.sub(r" in [\d.]+ s$", "", line.strip()) for line in result.output.splitlines()]
        for line in expected:
            if line.startswith("{"):
                record = json.loads(printed[0])
                for key, value in json.loads(line.replace(", …", "")).items():
                    assert record[key] == pytest.approx(value, rel=1e-3), key
            else:
                assert re.sub(r" in [\d.]+ s$", "", line) in printed


def test_pages_with_code_are_found() -> None:
    assert {"README.md", "docs/start.md", "docs/howto/extend.md"} <= {name_of(page) for page in WITH_CODE}
    for name in ELSEWHERE:
        assert blocks(ROOT / name)


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as they are made on the web."""
    heads = re.findall(r"^#+ +(.+?)\s*$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = unquote(link).partition("#")
        place = (page.parent / path).resolve() if path else page
        # the site leads a link to an example to the page that is made of it
        made = re.match(r"examples/(gallery|concepts)/plot_\w+\.py$", place.relative_to(ROOT).as_posix())
        assert place.exists(), f"{link} of {name_of(page)}"
        if page.is_relative_to(ROOT / "docs"):  # the site would warn
            assert made or place.is_relative_to(ROOT / "docs"), f"{link} of {name_of(page)} leads out of the site"
        if anchor and place.suffix == ".md":
            assert anchor in anchors(place), f"{link} of {name_of(page)}"


def test_the_flight_moves_and_is_small() -> None:
    """docs/flight.gif, of docs/make_flight.py, is a picture that a page can load at once."""
    file = ROOT / "docs" / "flight.gif"
    assert file.stat().st_size < 1_000_000
    with Image.open(file) as flight:
        assert flight.n_frames > 50
        assert flight.info["loop"] == 0


def documented() -> dict[str, set[str]]:
    """What the reference lists, by module."""
    found: dict[str, set[str]] = {}
    module = ""
    for line in (ROOT / "docs/reference/api.md").read_text(encoding="utf-8").splitlines():
        if entry := re.match(r"\.\. (\w+):: ([\w.]+)$", line):
            kind, name = entry.groups()
            if kind == "currentmodule":
                found.setdefault(name, set())
            elif kind == "automodule":
                module = name
            else:
                place, _, own = name.rpartition(".")
                found.setdefault(place or "rootmatch", set()).add(own)
        elif (members := re.match(r"   :members: (.+)$", line)) and module:
            found.setdefault(module, set()).update(members[1].split(", "))
            module = ""
    return found


def test_what_is_public_is_one_list() -> None:
    """`rootmatch.__all__`, the reference and CONTRIBUTING name the same, and all of it is there."""
    import rootmatch

    found = documented()
    assert found.pop("rootmatch") == set(rootmatch.__all__) - {"__version__"}
    section = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## Versions")[1].split("## ")[0]
    assert set(re.findall(r"`(rootmatch\.[a-z_.]+[a-z])`", section)) == set(found)
    for module, names in found.items():
        missing = [name for name in names if not hasattr(importlib.import_module(module), name)]
        assert missing == [], f"{module} has no {missing}"


INSIDE = {"docs/architecture.md", "docs/internals.md", "docs/notebook"}
"""Pages about what is not public."""


def test_pages_use_what_is_public() -> None:
    public = {f"{module}.{name}" for module, names in documented().items() for name in names}
    public |= set(documented())
    for page in PAGES:
        if any(name_of(page).startswith(inside) for inside in INSIDE):
            continue
        for block in blocks(page):
            for module, names in re.findall(r"^from (rootmatch[\w.]*) import (.+)$", block, re.MULTILINE):
                used = {f"{module}.{name.strip()}" for name in names.split(",")}
                assert used <= public, f"{name_of(page)}: {used - public}"


def test_figures_are_those_of_the_files() -> None:
    """Tables of measured figures are what docs/make_tables.py makes of them."""
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "make_tables.py", "--check"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    shown = "\n".join((ROOT / page).read_text(encoding="utf-8") for page in ("README.md", "docs/benchmarks.md"))
    assert shown.count("<!-- table: ") == shown.count("<!-- end -->") == 6
    for results in (ROOT / "benchmarks" / "results").glob("*.csv"):
        assert f"<!-- table: {results.stem} -->" in shown


QUOTED = [
    ("README.md", "99 are called matched", "accuracy", "a drone with 6 LEDs"),
    ("README.md", "ten points among ten clutter detections take 9 ms", "speed", "`P3P`, 10 + 10"),
    ("docs/faq.md", "99 of 100 simulated matches are called matched", "accuracy", "a drone with 6 LEDs"),
    ("docs/faq.md", "Ten points among ten clutter detections take 9 ms", "speed", "`P3P`, 10 + 10"),
    ("docs/howto/photogrammetry.md", "15 to 131 of 157 targets", "accuracy", "157 targets"),
    ("docs/howto/photogrammetry.md", "all 57 recorded views", "accuracy", "157 targets"),
    ("docs/benchmarks.md", "`constellations` has 19 ms", "speed", "a real headset of 32 LEDs"),
]
"""Sentences with measured figures: page, words, and the file and row of results that the figures are from."""


@pytest.mark.parametrize(("page", "words", "file", "begin"), QUOTED)
def test_figures_in_sentences_are_those_of_the_files(page: str, words: str, file: str, begin: str) -> None:
    assert words in " ".join((ROOT / page).read_text(encoding="utf-8").split())
    with (ROOT / "benchmarks" / "results" / f"{file}.csv").open(encoding="utf-8", newline="") as rows:
        (row,) = (row for row in csv.reader(rows) if row[0].startswith(begin))
    known = {round(float(number)) for number in re.findall(r"\d+(?:\.\d+)?", " ".join(row))}
    assert {int(number) for number in re.findall(r"\d+", words)} <= known


def test_the_readme_says_how_sure_as_the_table_does() -> None:
    table = (ROOT / "docs" / "trust.md").read_text(encoding="utf-8")
    row = re.search(r"^\| \*\*all\*\* \|.*$", table, re.MULTILINE)
    assert row is not None
    trusted, wrong, expected = row[0].strip("| ").split(" | ")[-3:]
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"of {int(trusted):,} bodies that it called *matched*" in readme
    assert f"{wrong} are wrong; its own probabilities predicted {float(expected):.0f} " in readme


def test_the_time_of_the_headset_is_that_of_the_leaderboard() -> None:
    pages = {name: (ROOT / name).read_text(encoding="utf-8") for name in ("docs/which-tool.md", "docs/real-targets.md")}
    row = re.search(r"^\| `headset-normals` \| rootmatch \| 40/40 .*$", pages["docs/real-targets.md"], re.MULTILINE)
    assert row is not None
    assert f"40 of 40 in {row[0].split(' | ')[-2]} " in " ".join(pages["docs/which-tool.md"].split())


def test_the_paper_s_preset_has_the_rho_that_the_scan_chose() -> None:
    scan = csv.DictReader((ROOT / "docs" / "reproduction" / "preset-rho-scan.csv").open(newline=""))
    chosen = {
        row["problem"]: float(row["rho"])
        for row in scan
        if (row["residual"], row["rho_rule"], row["chosen"]) == ("qr", "own", "1")
    }
    assert chosen == {"p3p": P3P.paper_rho, "3p1": ThreePlusOne.paper_rho, "up2p": UP2P.paper_rho}
