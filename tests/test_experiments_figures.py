"""Figures and their CSV files, from made-up results, and a whole reproduction with made-up accuracies."""

import csv
import io
import shutil

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from made_up_results import EXACT, NEEDED, ONE, RHO, made_up_rhos, made_up_table
from rootmatch.errors import InputError
from rootmatch.research.paper.figures import COLOURS, draw, draw_scan
from rootmatch.research.paper.reproduce import STORE_NAME, curves_csv, reproduce, scan_csv, write
from rootmatch.research.paper.rho import ALL_RULES, RESIDUALS, RULES, choose
from rootmatch.research.paper.settings import GRID, PANELS, PROBLEMS, SAMPLES, Effort
from rootmatch.research.store import Row, Store


def accuracy(setting, method, samples):
    return min(1.0, np.log10(samples) / 6) * (1.0 - 0.3 * setting.noise - 0.02 * setting.outliers)


@pytest.fixture(scope="module")
def table():
    return made_up_table(accuracy, spread=0.05)


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("beside", [None, "tan", "balanced", "pipeline"])
def test_panels_have_the_same_axes_labels_and_all_curves(table, problem, beside):
    if beside == "tan" and problem != "3p1":
        pytest.skip("only 3P1 has another unknown")
    figure = draw(table, problem, "one", beside)
    axes = [axis for axis in figure.axes if axis.lines]
    assert [axis.get_title(loc="left").split()[0] for axis in axes] == [panel.label for panel in PANELS[problem]]
    assert {(axis.get_xlim(), axis.get_ylim(), axis.get_xscale()) for axis in axes} == {((1e3, 1e6), (0, 102), "log")}
    for axis, panel in zip(axes, PANELS[problem], strict=True):
        assert axis.get_xlabel() == "sampled hyper-edges"
        assert axis.get_ylabel() == "mean accuracy (%)"
        assert len(axis.lines) == (3 if beside else 2) * len(panel.settings)
        looks = {
            (line.get_color(), line.get_marker(), str(line.get_linestyle()), line.get_linewidth())
            for line in axis.lines
        }
        assert len(looks) == len(axis.lines), "two curves look alike"
        styles = {line.get_linestyle() for line in axis.lines}
        assert {"-", "--"} <= styles
        assert len(axis.collections) == len(panel.settings) * (1 if beside else 2)  # bands
    legend = " ".join(text.get_text() for text in figure.legends[0].get_texts())
    for word in ("σ = 0.25 px", "10 outliers", "sparse", "dense"):
        assert word in legend
    assert ("default pipeline" in legend) == (beside == "pipeline")
    assert ("balanced solver" in legend) == (beside == "balanced")
    assert f"{ONE:.3g}" in figure.get_suptitle()


def test_curves_show_the_means_of_the_table(table):
    axis = draw(table, "p3p", "paper").axes[0]
    for line in axis.lines:
        np.testing.assert_array_equal(line.get_xdata(), SAMPLES)
    noise_free = next(line for line in axis.lines if line.get_color() == COLOURS[0.0] and line.get_linestyle() == "-")
    setting = PANELS["p3p"][0].settings[0]
    expected = [100 * table.paper(setting, rule="paper", samples=size).mean() for size in SAMPLES]
    np.testing.assert_allclose(noise_free.get_ydata(), expected)


def test_colours_keep_apart_for_colour_blind_eyes():
    """Simulated red- and green-blindness (Viénot, Brettel and Mollon 1999): all pairs stay visibly different."""
    to_cones = np.array([[17.8824, 43.5161, 4.11935], [3.45565, 27.1554, 3.86714], [0.0299566, 0.184309, 1.46709]])
    without_red = np.array([[0, 2.02344, -2.52581], [0, 1, 0], [0, 0, 1]])
    without_green = np.array([[1, 0, 0], [0.494207, 0, 1.24827], [0, 0, 1]])
    colours = np.array([to_rgb(colour) for colour in COLOURS.values()])
    for view in (np.eye(3), without_red, without_green):
        seen = np.clip(colours @ (np.linalg.inv(to_cones) @ view @ to_cones).T, 0, 1)
        gaps = np.linalg.norm(seen[:, None] - seen[None], axis=2)[np.triu_indices(len(seen), 1)]
        assert gaps.min() > 0.2


def test_scan_marks_what_was_chosen():
    figure = draw_scan(made_up_rhos())
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["solver of the text", "published solver"]
    for axis, shift in zip(figure.axes, (1.0, 10.0), strict=True):
        marked = sorted(float(line.get_xdata()[line.get_markevery()[0]]) for line in axis.lines)
        np.testing.assert_allclose(marked, sorted([shift * ONE, shift * NEEDED, *RHO.values(), *EXACT.values()]))
        assert "ρ" in axis.get_xlabel()


@pytest.mark.parametrize("problem", PROBLEMS)
def test_csv_is_tidy_and_holds_the_means(table, problem):
    lines = list(csv.DictReader(io.StringIO(curves_csv(table, problem))))
    keys = {tuple(v for k, v in line.items() if k not in ("accuracy", "low", "high")) for line in lines}
    assert len(keys) == len(lines)
    assert {line["panel"] for line in lines} == {panel.label for panel in PANELS[problem]}
    for line in lines:
        assert 0.0 <= float(line["low"]) <= float(line["accuracy"]) <= float(line["high"]) <= 1.0
        assert line["instances"] == "12"
        assert line["rho_rule"] in (("",) if line["solver"] == "ascent" else ALL_RULES)
    written = "qr-cos" if problem == "3p1" else "qr"
    settings = sum(len(panel.settings) for panel in PANELS[problem])
    for solver in ("power-l1", "power-l1-start"):
        paper = [line for line in lines if (line["residual"], line["solver"]) == (written, solver)]
        assert sum(line["rho_rule"] in RULES for line in paper) == 2 * len(SAMPLES) * settings
        assert {line["rho_rule"] for line in paper} == set(ALL_RULES)
    assert any(line["residual"] == "qr" for line in lines)


def test_scan_csv_names_the_choices():
    lines = list(csv.DictReader(io.StringIO(scan_csv(made_up_rhos()))))
    assert len(lines) == (2 * 3 * (2 + 6) + 2 + 2) * len(GRID)
    chosen = {
        (line["rho_rule"], line["problem"], float(line["rho"]))
        for line in lines
        if line["chosen"] == "1" and line["solver"] == "power-l1"
    }
    expected = {("one", "all", ONE), ("paper", "all", NEEDED)}
    expected |= {("own", p, rho) for p, rho in RHO.items()} | {("exact", p, rho) for p, rho in EXACT.items()}
    assert chosen == expected


def fake(unit):
    """Rows of a unit in no time: the accuracy falls with the distance of ρ from a peak of the problem's own."""
    rows = []
    for task in unit.tasks:
        for method, sizes in task.methods:
            off = abs(np.log10(method.rho / RHO[task.setting.problem])) if method.solver != "ascent" else 0.0
            for size in sizes:
                value = round(accuracy(task.setting, method, size) / (1.0 + 0.1 * off), 1)
                rows.append(Row(task.setting, method, unit.seed, size, value, 1.0, 10, 5, True))
    return rows


def draw_few(table, problem, rule, beside=None):
    """One figure of the paper; empty ones in the place of all others, whose panels are looked at above."""
    drawn = (problem, table.variant, rule, beside) == ("p3p", "text", "paper", None)
    return draw(table, problem, rule, beside) if drawn else draw_none()


def draw_none(*_):
    """A figure of one empty axis."""
    figure = mpl.figure.Figure(figsize=(2.0, 1.5))
    figure.subplots()
    return figure


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reproduced")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rootmatch.research.paper.reproduce.draw", draw_few)
        return folder, reproduce(PROBLEMS, folder, effort=Effort(2), jobs=1, function=fake)


def test_reproduction_writes_every_figure_curve_and_claim(reproduced):
    folder, done = reproduced
    kinds = ("", "-free-rho", "-published", "-published-free-rho", "-balanced", "-default-pipeline")
    stems = [f"figure-{k}-{p}{kind}" for k, p in (("2", "p3p"), ("3", "3p1"), ("4", "up2p")) for kind in kinds]
    stems += ["figure-3-3p1-tan"]
    names = {f"{stem}.{end}" for stem in [*stems, "rho-scan"] for end in ("png", "svg")}
    names |= {"figure-2-p3p.csv", "figure-3-3p1.csv", "figure-4-up2p.csv", "rho-scan.csv", "claims.md"}
    assert {path.name for path in done} == names
    assert {path.name for path in folder.iterdir()} == names | {"results.sqlite"}
    for path in done:
        content = path.read_bytes()
        assert len(content) > 500
        if path.stem not in ("figure-2-p3p", "rho-scan"):
            continue  # see `draw_few`
        if path.suffix == ".png":
            pixels = mpl.image.imread(path)
            assert pixels.shape[0] > 500
            assert pixels[..., :3].std() > 0.01, "an empty picture"
        if path.suffix == ".svg":
            assert b"sampled hyper-edges" in content or path.stem == "rho-scan"


def test_reproduction_chooses_rho_on_its_own_seeds(reproduced):
    folder, _ = reproduced
    with Store(folder / STORE_NAME) as store:
        rhos = choose(store, Effort(2))
    assert {p: rhos.choose_rho("qr", p, "own") for p in PROBLEMS} == RHO
    for effort in (Effort(), Effort(2), Effort(4, quick=True)):
        assert all(effort.scan_seeds(residual).start >= 1_000_000 for residual in RESIDUALS)
    assert (len(Effort().scan_seeds("qr")), len(Effort().scan_seeds("svd"))) == (24, 12)


def test_one_problem_more_in_a_folder_is_told_with_the_others_and_what_is_known_is_not_worked_out_again(
    reproduced, tmp_path, monkeypatch
):
    monkeypatch.setattr("rootmatch.research.paper.reproduce.draw", draw_none)
    monkeypatch.setattr("rootmatch.research.paper.reproduce.claims_markdown", lambda *_: "judged elsewhere")
    folder, everything = reproduced
    shutil.copy(folder / "results.sqlite", tmp_path)
    before = {path.name: path.read_bytes() for path in everything if path.suffix == ".csv"}

    def never(unit):
        raise AssertionError("nothing is missing")

    done = reproduce(("up2p",), tmp_path, effort=Effort(2), jobs=1, function=never)
    assert {path.name.split("-")[1] for path in done if path.name.startswith("figure")} == {"2", "3", "4"}
    assert {path.name: path.read_bytes() for path in done if path.suffix == ".csv"} == before


def test_one_problem_alone_in_a_quick_run(tmp_path, monkeypatch):
    """It scans no other, its one ρ is chosen on it, and it stops at the samples that it names."""
    monkeypatch.setattr("rootmatch.research.paper.reproduce.draw", draw_none)
    met, maximum = set(), set()

    def noted(unit):
        met.update(task.setting.problem for task in unit.tasks)
        maximum.update(size for task in unit.tasks for _, sizes in task.methods for size in sizes)
        return fake(unit)

    done = reproduce(("up2p",), tmp_path, effort=Effort(1, quick=True), jobs=1, function=noted)
    assert met == {"up2p"}
    assert max(maximum) == 100_000
    assert "figure-4-up2p-published.svg" in {path.name for path in done}
    lines = list(csv.DictReader(io.StringIO((tmp_path / "rho-scan.csv").read_text())))
    assert {line["problem"] for line in lines} == {"all", "up2p"}
    claims = (tmp_path / "claims.md").read_text(encoding="utf-8")
    assert "**A quick run.**" in claims
    rhos = claims.split("## ρ")[1].split("## Accuracy")[0]
    assert "| power-l1 | qr | one ρ, chosen freely | all | 1e-02 " in rhos
    assert "P3P |" not in rhos


def test_writing_replaces_and_leaves_no_parts(tmp_path):
    (tmp_path / "claims.md").write_text("old")
    write(made_up_table(accuracy, problems=()), tmp_path, "new")
    assert (tmp_path / "claims.md").read_text() == "new"
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"problems": ("p4p",)}, "p4p given"),
        ({"problems": ()}, "none given"),
        ({"problems": PROBLEMS, "effort": Effort(0)}, "0 instances"),
        ({"problems": PROBLEMS, "seed": -1}, "from seed -1"),
        ({"problems": PROBLEMS, "seed": 999_999, "effort": Effort(2)}, "seeds from 0"),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_is_written(tmp_path, arguments, words):
    with pytest.raises(InputError, match=words):
        reproduce(output=tmp_path / "new", function=fake, **arguments)
    assert not (tmp_path / "new").exists()
