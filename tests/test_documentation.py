"""Every code block of the README and of the pages runs as it stands, and every link of theirs leads somewhere."""

import contextlib
import csv
import io
import re
from pathlib import Path
from urllib.parse import unquote

import pytest

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
        made = re.match(r"docs/(gallery|concepts)/plot_(\w+)\.rst$", place.relative_to(ROOT).as_posix())
        if made:  # written while the site is built, from this example
            place = ROOT / "examples" / made.group(1) / f"plot_{made.group(2)}.py"
        assert place.exists(), f"{link} of {name_of(page)}"
        if page.is_relative_to(ROOT / "docs"):  # the site would warn
            assert made or place.is_relative_to(ROOT / "docs"), f"{link} of {name_of(page)} leads out of the site"
        if anchor and place.suffix == ".md":
            assert anchor in anchors(place), f"{link} of {name_of(page)}"


def test_every_public_name_is_in_the_reference() -> None:
    import rootmatch

    reference = (ROOT / "docs/reference/api.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"auto(?:class|function):: (?:\w+\.)*(\w+)", reference))
    assert set(rootmatch.__all__) - {"__version__"} <= documented


def test_the_paper_s_preset_has_the_rho_that_the_scan_chose() -> None:
    scan = csv.DictReader((ROOT / "docs" / "reproduction" / "rho-scan.csv").open(newline=""))
    chosen = {
        row["problem"]: float(row["rho"])
        for row in scan
        if (row["residual"], row["rho_rule"], row["chosen"]) == ("qr", "own", "1")
    }
    assert chosen == {"p3p": P3P.paper_rho, "3p1": ThreePlusOne.paper_rho, "up2p": UP2P.paper_rho}
