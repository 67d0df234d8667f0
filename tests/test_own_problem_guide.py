"""The guide "Bring your own problem" and its example run as they stand."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
GUIDE = ROOT / "docs" / "bring-your-own-problem.md"


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROOTMATCH_CACHE_DIR", str(tmp_path / "derived"))


def blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def test_from_equations_to_a_match_takes_under_forty_lines() -> None:
    code = [line for line in blocks()[0].splitlines() if line.strip()]
    assert len(code) < 40


def test_the_guide_runs(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict = {}
    for block in blocks():
        exec(compile(block, GUIDE.name, "exec"), names)
    # a planar motion with its one constraint leaves two points on one epipolar line exchangeable: the guide says so
    assert capsys.readouterr().out.startswith("100% right; ambiguous")
    assert names["floor"].degree == 2
    assert names["by_hand"] == pytest.approx(names["by_kernel"], rel=1e-6)
    match = names["match"]  # of a problem that fits no pose
    assert match.pose is None
    assert match.probability is None
    assert all(value != value for value in match.confidence)
    assert len(names["cosine_laws"]([names["sp"].zeros(3, 1)] * 3, [names["sp"].zeros(3, 1)] * 3)) == 4


def test_the_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    example = ROOT / "examples" / "own_problem" / "cosine_laws.py"
    with pytest.raises(SystemExit) as stop:
        runpy.run_path(str(example), run_name="__main__")
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert "degree 4, 2 constraints for 4 points" in out
    assert "100% of the points right" in out
    assert str(example.relative_to(ROOT)).replace("\\", "/") in GUIDE.read_text(encoding="utf-8")


def test_links_lead_somewhere() -> None:
    for page in (GUIDE, ROOT / "examples" / "own_problem" / "README.md"):
        for name in re.findall(r"`((?:docs|examples|benchmarks)/[\w./-]+)`", page.read_text(encoding="utf-8")):
            assert (ROOT / name).exists(), name
