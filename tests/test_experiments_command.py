"""The command ``rootmatch reproduce`` and what it says while it runs."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from rootmatch.cli import progress
from rootmatch.cli.app import app
from rootmatch.research import sweep
from rootmatch.research.paper import reproduce
from rootmatch.research.paper.settings import Effort


@pytest.fixture
def call(monkeypatch):
    """Run the command with the work itself replaced; gives what the work was asked for."""
    asked = {}

    def work(problems, output, **options):
        asked.update(options, problems=problems, output=output)
        with options["progress"]("scenes") as show:
            if show is not None:
                show(4, 4)
        return (output / "claims.md",)

    monkeypatch.setattr("rootmatch.research.paper.reproduce.reproduce", work)

    def run(*arguments):
        result = CliRunner().invoke(app, ["reproduce", *arguments])
        return result, asked

    return run


def test_all_problems_and_the_papers_number_of_instances_are_the_default(call):
    result, asked = call("all", "--output", "somewhere")
    assert result.exit_code == 0, result.output
    assert asked["problems"] == ("p3p", "3p1", "up2p")
    assert asked["output"] == Path("somewhere")
    assert (asked["effort"], asked["seed"], asked["jobs"], asked["scheduler"]) == (Effort(100), 0, -1, None)
    assert result.stdout == "somewhere/claims.md\n"
    assert result.stderr == "scenes: 100 %\n"


def test_options_arrive(call):
    result, asked = call(
        "3p1", "--output", "x", "--instances", "7", "--seed", "3", "--jobs", "2", "--scheduler", "tcp://a:1", "--quiet"
    )
    assert result.exit_code == 0, result.output
    assert asked["problems"] == ("3p1",)
    assert (asked["effort"], asked["seed"], asked["jobs"], asked["scheduler"]) == (Effort(7), 3, 2, "tcp://a:1")
    assert result.stderr == ""


def test_quick_is_a_few_instances_unless_more_are_asked_for(call):
    _, asked = call("all", "--quick", "--output", "x")
    assert asked["effort"] == Effort(4, quick=True)
    _, asked = call("all", "--quick", "--instances", "9", "--output", "x")
    assert asked["effort"] == Effort(9, quick=True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("p4p", "--output", "x"), "p4p"),
        (("p3p",), "--output"),
        (("p3p", "--output", "x", "--instances", "0"), "0 instances"),
        (("p3p", "--output", "x", "--jobs", "0"), "jobs: 0"),
    ],
)
def test_mistakes_take_one_line_and_exit_code_two(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["reproduce", *arguments])
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("which", ["p3p", "hypergraph"])
def test_a_folder_of_something_else_is_refused_and_left_as_it_is(tmp_path, which):
    scene = tmp_path / "scene"
    assert CliRunner().invoke(app, ["simulate", "p3p", "--output", str(scene)]).exit_code == 0
    there = sorted(scene.iterdir())
    result = CliRunner().invoke(app, ["reproduce", which, "--output", str(scene)])
    assert result.exit_code == 2
    assert f"{scene}: the folder is not empty, and no results are in it" in result.stderr
    assert sorted(scene.iterdir()) == there


def test_log_says_how_much_time_is_left(monkeypatch, capsys):
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with progress.progress_bar("scenes", True) as show:
        for done in (0, 20, 24, 28, 100):
            show(done, 100)
            now[0] += 20.0
    assert capsys.readouterr().err.splitlines() == [
        "scenes: 0 %",
        "scenes: 20 %, about 0:01:20 left",
        "scenes: 28 %, about 0:02:34 left",
        "scenes: 100 %",
    ]


class ChosenError(Exception):
    """Raised where ρ is chosen, in the place of everything that follows."""


@pytest.mark.parametrize("problems", [("up2p",), ("p3p", "up2p")])
def test_rho_is_scanned_for_the_problems_that_are_asked_for_alone(tmp_path, monkeypatch, problems):
    scanned = []

    def chosen(*given):
        raise ChosenError

    monkeypatch.setattr(sweep, "run", lambda work, store, **options: scanned.extend(work))
    monkeypatch.setattr(reproduce, "choose", chosen)
    with pytest.raises(ChosenError):
        reproduce.reproduce(problems, tmp_path, effort=Effort(instances=2))
    assert {task.setting.problem for unit in scanned for task in unit.tasks} == set(problems)
