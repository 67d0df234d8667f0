"""The command as a user meets it: files in, files out, exit codes, and one line for every mistake."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import rootmatch as rm
from commands import rows_of, run, started
from rootmatch.cli import app
from rootmatch.cli.error_messages import translate_to_options
from rootmatch.simulation import up2p_scene

PROGRAM = [sys.executable, "-c", "from rootmatch.cli import main; main()"]
CAMERA = "1000,1000,320,240"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes") / "p3p"
    result = run("simulate", "p3p", "--points", 8, "--outliers", 2, "--noise", 0.1, "--seed", 3, "--output", folder)
    assert result.exit_code == 0, result.output
    return folder


def of(scene: Path, *options: object, problem: str = "p3p", camera: object = CAMERA) -> list[object]:
    """Arguments of a match on the scene's files."""
    files = [scene / "model.csv", scene / "image.csv"]
    return ["match", *files, "--problem", problem, "--camera", camera, "--noise", 0.1, *options]


class TestMatch:
    def test_table_files_and_picture(self, scene: Path, tmp_path: Path) -> None:
        output, plot = tmp_path / "matches.csv", tmp_path / "match.svg"
        truth = {row["source"]: row["target"] for row in rows_of(scene / "truth.csv")}
        result = run(*of(scene, "--output", output, "--plot", plot, "--truth", scene / "truth.csv"))
        assert result.exit_code == 0, result.output
        assert result.stderr == ""
        assert "truth: 8 of 8 right, 0 wrong, 0 missed" in result.stdout
        assert "matched: " in result.stdout
        found = rows_of(output)
        assert {row["source"]: row["target"] for row in found} == truth
        assert set(found[0]) == {"source", "target", "weight", "motion", "residual", "confidence"}
        assert all(0.0 <= float(row["residual"]) < 0.5 for row in found)
        assert all(float(row["weight"]) > 0.0 and row["motion"] == "0" for row in found)
        assert "<svg" in plot.read_text()
        assert sorted(path.name for path in tmp_path.iterdir()) == ["match.svg", "matches.csv"]

    def test_json_is_one_object_and_nothing_else(self, scene: Path) -> None:
        result = run(*of(scene, "--json", "--sampler", "exhaustive"))
        assert result.exit_code == 0
        record = json.loads(result.stdout)
        assert set(record) == {
            "assignment", "score", "margin", "probability", "log_odds", "confidence", "motion_labels", "alternatives",
            "status", "converged", "stopped_early", "seconds", "evaluated", "noise", "noise_factor",
            "point_error", "poses", "other_poses", "prior_holds",
        }  # fmt: skip
        truth = [int(row["target"]) for row in rows_of(scene / "truth.csv")]
        assert record["assignment"] == truth
        assert record["motion_labels"] == [0] * 8
        assert record["status"] == "matched"
        assert 0.0 <= record["margin"] <= 1.0
        assert 0.9 <= record["probability"] <= 1.0
        assert record["converged"] is True
        assert record["evaluated"] == 70 * 5040  # C(8, 4) times 10!/6!
        assert record["score"] > 0.0
        assert record["seconds"] > 0.0
        assert record["noise"] == 0.1
        assert record["other_poses"] == []
        for other in record["alternatives"]:
            assert other["score"] <= record["score"]
            assert len(other["assignment"]) == len(other["poses"][0]["residuals"]) == 8
        (pose,) = record["poses"]
        assert np.linalg.det(pose["R"]) == pytest.approx(1.0)
        assert np.shape(pose["covariance"]) == (6, 6)
        assert pose["parameters"] == ["rx", "ry", "rz", "tx", "ty", "tz"]
        assert pose["rms"] < 0.3
        assert pose["points"] == pose["inliers"] == list(range(8))
        assert result.stderr.startswith("rootmatch: matched")

    @pytest.mark.parametrize("name", ["poses.csv", "poses.json"])
    def test_poses_are_written(self, scene: Path, tmp_path: Path, name: str) -> None:
        result = run(*of(scene, "--json", "--poses", tmp_path / name))
        assert result.exit_code == 0, result.output
        (expected,) = json.loads(result.stdout)["poses"]
        written = (tmp_path / name).read_text()
        quaternion = expected["quaternion"]
        if name == "poses.json":
            assert json.loads(written) == [{"motion": 0, **expected}]
        else:
            (row,) = rows_of(tmp_path / name)
            assert [float(row[key]) for key in ("qx", "qy", "qz", "qw", "tx", "ty", "tz")] == [
                *quaternion,
                *expected["t"],
            ]
            assert float(row["cov_rz_tx"]) == expected["covariance"][2][3]
            assert (row["points"], row["scale"], row["focal"]) == ("8", "1.0", "")

    def test_poses_on_standard_output_are_csv(self, scene: Path, tmp_path: Path) -> None:
        printed = run(*of(scene, "--poses", "-"))
        assert printed.exit_code == 0, printed.output
        run(*of(scene, "--poses", tmp_path / "poses.csv"))
        assert printed.stdout == (tmp_path / "poses.csv").read_text()

    @pytest.mark.parametrize("form", ["ros", "openxr", "colmap"])
    def test_poses_are_written_for_other_programs(self, scene: Path, tmp_path: Path, form: str) -> None:
        result = run(*of(scene, "--json", "--poses", tmp_path / "out", "--pose-format", form))
        assert result.exit_code == 0, result.output
        record = json.loads(result.stdout)
        (expected,) = record["poses"]
        if form == "colmap":
            image, detections = (tmp_path / "out" / "images.txt").read_text().splitlines()
            assert [float(word) for word in image.split()[5:8]] == expected["t"]
            owners = [int(word) for word in detections.split()[2::3]]
            assert [owners[j] for j in record["assignment"]] == list(range(1, 9))
            return
        (written,) = json.loads((tmp_path / "out").read_text())
        x, y, z = expected["t"]
        place = written["position"] if form == "openxr" else written["transform"]["translation"]
        assert list(place.values()) == ([x, -y, -z] if form == "openxr" else [x, y, z])

    @pytest.mark.parametrize(
        ("options", "text"),
        [
            (("--poses", "poses.xyz"), "its suffix names no format"),
            (("--poses", "poses.csv", "--pose-format", "euroc"), "give csv, json, ros, openxr or colmap"),
            (("--pose-format", "ros"), "without --poses"),
            (("--poses", "poses.tum"), "a single image does not have; `rootmatch track` writes one"),
            (("--poses", "poses.txt", "--pose-format", "tum"), "a single image does not have"),
            (("--photo", "image.csv"), "give --plot"),
            (("--report", "report.pdf"), "ends in .html"),
            (("--report", "image.csv"), "also an input"),
            (("--plot", "match.png", "--photo", "image.csv"), "cannot be read"),
            (("--plot", "match.png", "--photo", "none.png"), "cannot be read"),
            (("--poses", "a.csv", "--output", "a.csv"), "is also an input or another output"),
        ],
    )
    def test_what_cannot_be_written_is_refused_at_once(
        self, scene: Path, options: tuple[str, ...], text: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(scene)
        before = sorted(scene.iterdir())
        result = run(*of(scene, *options))
        assert result.exit_code == 2
        assert text in " ".join(result.stderr.split())
        assert sorted(scene.iterdir()) == before

    def test_noise_is_estimated_when_asked_for(self, scene: Path) -> None:
        arguments = of(scene)
        arguments[arguments.index("--noise") + 1] = "auto"
        result = run(*arguments)
        assert result.exit_code == 0, result.output
        told = re.search(r"noise: ([0-9.]+) px, estimated", result.stdout)
        assert told is not None
        assert 0.04 < float(told[1]) < 0.25
        record = json.loads(run(*arguments, "--json").stdout)
        assert record["noise"] == pytest.approx(float(told[1]), rel=0.01)

    def test_ids_and_a_camera_file(self, scene: Path, tmp_path: Path) -> None:
        model, output = tmp_path / "model.csv", tmp_path / "matches.csv"
        lines = (scene / "model.csv").read_text().splitlines()
        named = [f"[led {k}],{line}" if k else f"id,{line}" for k, line in enumerate(lines)]
        model.write_text("\n".join(named))
        arguments = of(scene, "--output", output, camera=scene / "camera.json")
        arguments[1] = model
        result = run(*arguments)
        assert result.exit_code == 0, result.output
        assert [row["source"] for row in rows_of(output)] == [f"[led {k}]" for k in range(1, 9)]
        assert "[led 3]" in result.stdout  # and is not taken for markup

    def test_names_of_problems_are_of_either_case(self, scene: Path) -> None:
        plain, capital = (run(*of(scene, "--json", problem=name)) for name in ("p3p", "P3P"))
        assert plain.exit_code == capital.exit_code == 0
        assert json.loads(plain.stdout)["assignment"] == json.loads(capital.stdout)["assignment"]

    def test_the_paper_s_preset_and_its_parts(self, scene: Path) -> None:
        result = run(*of(scene, "--preset", "paper", "--samples", 20_000, "--seed", 5, "--json"))
        assert result.exit_code in (0, 1)
        first = json.loads(result.stdout)
        assert first["evaluated"] == 20_000
        parts = ("--sampler", "random", "--residual", "qr", "--solver", "power-l1")
        again = json.loads(
            run(*of(scene, "--preset", "paper", *parts, "--samples", 20_000, "--seed", 5, "--json")).stdout
        )
        assert (again["assignment"], again["score"]) == (first["assignment"], first["score"])
        wider = run(*of(scene, "--preset", "paper", "--rho", 10, "--samples", 20_000, "--seed", 5, "--json")).stdout
        assert json.loads(wider)["score"] != first["score"]

    def test_candidates_narrow_the_search(self, scene: Path, tmp_path: Path) -> None:
        """Each source point may be its own image point or the next one: a fiftieth of the work is left."""
        truth = [int(row["target"]) for row in rows_of(scene / "truth.csv")]
        candidates = tmp_path / "candidates.csv"
        rows = [f"{i},{(j + step) % 10}" for i, j in enumerate(truth) for step in (0, 1)]
        candidates.write_text("\n".join(["source,target", *rows]))
        record = json.loads(run(*of(scene, "--candidates", candidates, "--json")).stdout)
        assert record["assignment"] == truth
        assert record["evaluated"] < 70 * 5040 / 50

    def test_no_trustworthy_match_is_printed_all_the_same(self, scene: Path, tmp_path: Path) -> None:
        rng = np.random.default_rng(0)
        image, output = tmp_path / "image.csv", tmp_path / "matches.csv"
        image.write_text("x,y\n" + "\n".join(f"{x},{y}" for x, y in rng.uniform(0, 480, (6, 2))))
        arguments = of(scene, "--output", output)
        arguments[2] = image
        result = run(*arguments)
        assert result.exit_code == 1, result.output
        assert "no trustworthy match" in result.stdout or "ambiguous" in result.stdout
        assert output.exists()

    def test_an_ambiguous_match_shows_the_other_answers(self, tmp_path: Path) -> None:
        """A board with a half-turn symmetry fits two ways round."""
        board = np.array([[x, y, 0.0] for x in range(3) for y in range(2)])
        turn = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
        tilt = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
        seen = board @ (turn @ tilt).T + [0.3, -0.2, 9.0]
        pixels = 1000.0 * seen[:, :2] / seen[:, 2:] + [320.0, 240.0]
        for name, points in (("model.csv", board), ("image.csv", pixels)):
            header = "x,y,z" if points.shape[1] == 3 else "x,y"
            np.savetxt(tmp_path / name, points, delimiter=",", header=header, comments="")
        arguments = ["match", tmp_path / "model.csv", tmp_path / "image.csv", "--problem", "p3p", "--camera", CAMERA]
        result = run(*arguments, "--noise", 0.5)
        assert result.exit_code == 1, result.output
        assert "ambiguous: " in result.stdout
        assert "alternative 1, score" in result.stdout

    def test_progress_goes_to_standard_error(self, scene: Path) -> None:
        result = run(*of(scene, "--json", "--progress"))
        json.loads(result.stdout)
        assert "hyper-edges: 100 %" in result.stderr
        assert "hyper-edges: " not in run(*of(scene, "--json")).stderr


class TestOtherProblems:
    @pytest.mark.parametrize(
        ("problem", "options"),
        [("up2p", ["--motions", 2, "--outliers", 2]), ("3p1", ["--baseline", 5]), ("p3p", ["--hidden", 3])],
    )
    def test_a_simulated_scene_is_matched_from_its_files(
        self, tmp_path: Path, problem: str, options: list[object]
    ) -> None:
        folder = tmp_path / "scene"
        made = run("simulate", problem, *options, "--seed", 2, "--output", folder)
        assert made.exit_code == 0, made.output
        more = ["--motions", 2] if problem == "up2p" else []
        result = run(
            *of(folder, "--truth", folder / "truth.csv", *more, problem=problem, camera=folder / "camera.json")
        )
        assert result.exit_code == 0, result.output
        assert "truth: 10 of 10 right, 0 wrong" in result.stdout
        assert ("motion" in result.stdout) == (problem == "up2p")
        advised = made.stdout.splitlines()[-1].split()
        assert advised[:2] == ["rootmatch", "match"]
        again = run(*advised[1:])
        assert again.stdout.splitlines()[:-2] == result.stdout.splitlines()[:-2]  # all but the seconds and the verdict

    @pytest.mark.parametrize("motions", ["2", "auto"])
    def test_several_motions_are_those_of_the_library(self, tmp_path: Path, motions: str) -> None:
        for seed in range(3):
            folder = tmp_path / str(seed)
            assert (
                run("simulate", "up2p", "--motions", 2, "--noise", 0.5, "--seed", seed, "--output", folder).exit_code
                == 0
            )
            result = run(
                *of(
                    folder,
                    "--noise",
                    0.5,
                    "--motions",
                    motions,
                    "--json",
                    problem="up2p",
                    camera=folder / "camera.json",
                )
            )
            assert result.exit_code == 0, result.output
            record = json.loads(result.stdout)
            scene = up2p_scene(10, 0, 0.5, seed, 2)
            match = rm.match(
                scene.source, scene.target, scene.problem, noise=0.5, motions=2 if motions == "2" else "auto"
            )
            assert record["assignment"] == match.assignment.tolist()
            assert record["motion_labels"] == match.motion_labels.tolist()
            assert record["score"] == pytest.approx(match.score)

    def test_directions_come_from_the_options_or_the_camera_file(self, tmp_path: Path) -> None:
        """A world turned on its side: only with its own vertical are its points matched."""
        folder = tmp_path / "scene"
        assert run("simulate", "up2p", "--seed", 4, "--output", folder).exit_code == 0
        turned = [f"{row['y']},{row['z']},{row['x']}" for row in rows_of(folder / "model.csv")]
        (folder / "model.csv").write_text("\n".join(["x,y,z", *turned]))  # (0, 1, 0) became (1, 0, 0)
        truth = ("--truth", folder / "truth.csv")
        wrong = run(*of(folder, *truth, problem="up2p", camera=folder / "camera.json"))
        assert "truth: 10 of 10 right" not in wrong.stdout
        right = run(*of(folder, *truth, "--vertical-world", "2,0,0", problem="up2p", camera=folder / "camera.json"))
        assert right.exit_code == 0, right.output
        assert "truth: 10 of 10 right" in right.stdout
        camera = json.loads((folder / "camera.json").read_text())
        assert camera["vertical_camera"] == [0.0, 1.0, 0.0]
        (folder / "camera.json").write_text(json.dumps(camera | {"vertical_world": [2.0, 0.0, 0.0]}))
        from_file = run(*of(folder, *truth, problem="up2p", camera=folder / "camera.json"))
        assert "truth: 10 of 10 right" in from_file.stdout

    @pytest.mark.parametrize(
        ("problem", "tilted", "stated"),
        [("up2p", "--vertical-camera", "--vertical-noise"), ("3p1", "--axis2", "--axis-noise")],
    )
    def test_the_noise_of_a_direction_widens_the_affinity(
        self, tmp_path: Path, problem: str, tilted: str, stated: str
    ) -> None:
        """With a vertical that is half a degree off, more hyper-edges agree once that is said."""
        folder = tmp_path / "scene"
        assert run("simulate", problem, "--seed", 6, "--noise", 0.2, "--output", folder).exit_code == 0
        arguments = of(folder, tilted, "0.0087,1,0", "--json", problem=problem, camera=folder / "camera.json")
        silent, said = (json.loads(run(*arguments, *more).stdout) for more in ([], [stated, 0.5]))
        assert said["score"] > silent["score"]

    def test_normals_are_used_unless_refused(self, scene: Path, tmp_path: Path) -> None:
        """Normals that all face away leave nothing to match."""
        lines = (scene / "model.csv").read_text().splitlines()
        points = np.array([[float(value) for value in line.split(",")] for line in lines[1:]])
        truth = [int(row["target"]) for row in rows_of(scene / "truth.csv")]
        away = tmp_path / "model.csv"
        # whatever the camera's direction is, one of a normal and its opposite faces away
        hidden = 0
        for sign in (1.0, -1.0):
            normals = np.broadcast_to([0.0, 0.0, sign], points.shape)
            table = np.hstack([points, normals])
            np.savetxt(away, table, delimiter=",", header="x,y,z,nx,ny,nz", comments="", fmt="%.17g")
            arguments = of(scene, "--json")
            arguments[1] = away
            hidden += json.loads(run(*arguments).stdout)["assignment"] != truth
            refused = json.loads(run(*arguments, "--no-normals").stdout)
            assert refused["assignment"] == truth
        assert hidden >= 1

    def test_a_model_without_known_normals_is_as_one_without_normals(self, scene: Path, tmp_path: Path) -> None:
        told = json.loads(run(*of(scene, "--json")).stdout)["assignment"]
        header, *lines = (scene / "model.csv").read_text().splitlines()
        for unknown in (",0,0,0", ",,,"):
            model = tmp_path / "model.csv"
            model.write_text("\n".join([f"{header},nx,ny,nz", *(f"{line}{unknown}" for line in lines)]))
            arguments = of(scene, "--json")
            arguments[1] = model
            result = run(*arguments)
            assert result.exit_code == 0
            assert json.loads(result.stdout)["assignment"] == told


GOOD_MODEL = "x,y,z\n0,0,0\n1,0,0\n0,1,0\n0,0,1\n1,1,0.5\n"
GOOD_IMAGE = "x,y\n300,200\n340,210\n310,260\n350,250\n320,230\n"


class TestBadInput:
    """One line on standard error that names the culprit, exit code 2, and no file left behind."""

    def refused(self, folder: Path, *arguments: object) -> str:
        """The one line of a command that must fail."""
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        result = run(*arguments)
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        assert result.stderr.startswith("rootmatch: ")
        assert result.stderr.count("\n") == 1
        assert result.stderr.endswith("\n")
        assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
        return str(result.stderr)

    def match(
        self,
        folder: Path,
        *options: object,
        model: str | None = GOOD_MODEL,
        image: str | None = GOOD_IMAGE,
        **others: str,
    ) -> str:
        """The one line of a match that must fail on the texts of two files."""
        for name, text in (("model.csv", model), ("image.csv", image)):
            if text is not None:
                (folder / name).write_text(text)
        arguments = ["match", folder / "model.csv", folder / "image.csv"]
        arguments += ["--problem", others.get("problem", "p3p"), "--camera", others.get("camera", CAMERA)]
        outputs = ["--output", folder / "matches.csv", "--plot", folder / "match.png"]
        return self.refused(folder, *arguments, *outputs, *options)

    @pytest.mark.parametrize(
        ("files", "words"),
        [
            ({"model": None}, ["model.csv", "no such file"]),
            ({"model": "x,y\n1,2\n"}, ["model.csv, row 1", "'z' is missing"]),
            ({"image": "x,y,z\n1,2,3\n"}, ["image.csv, row 1", "swapped"]),
            ({"image": GOOD_IMAGE.replace("310", "left")}, ["image.csv, row 4", "x is 'left'"]),
            ({"image": GOOD_IMAGE.replace("310", "nan")}, ["image.csv, row 4", "finite"]),
            ({"model": GOOD_MODEL.replace("0.5", "inf")}, ["model.csv, row 6", "finite"]),
            ({"model": "x,y,z\n0,0,0\n1,0,0\n0,1,0\n"}, ["model.csv", "3 given and at least 4 needed"]),
            ({"image": "x,y\n0,0\n1,0\n0,1\n"}, ["image.csv", "3 given and at least 4 needed"]),
            ({"model": GOOD_MODEL + "1,0\n"}, ["model.csv, row 7", "2 values given, 3 expected"]),
            ({"model": GOOD_MODEL + "1,0,0\n"}, ["model.csv, row 7", "same point as in row 3"]),
            ({"model": "x,y,z\n" + "".join(f"{k},{2 * k},{-k}\n" for k in range(5))}, ["model.csv", "line"]),
        ],
    )
    def test_files(self, tmp_path: Path, files: dict[str, str | None], words: list[str]) -> None:
        line = self.match(tmp_path, **files)  # type: ignore[arg-type]
        for word in words:
            assert word in line

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (["--noise", "-1"], ["--noise", "-1"]),
            (["--noise", "nan"], ["--noise"]),
            (["--noise", "much"], ["--noise"]),
            (["--motions", "0"], ["--motions"]),
            (["--motions", "some"], ["--motions", "auto"]),
            (["--samples", "0"], ["samples", "0"]),
            (["--rho", "0"], ["--rho"]),
            (["--residual", "l2"], ["--residual", "qr-both"]),
            (["--solver", "magic"], ["--solver", "ascent"]),
            (["--sampler", "few"], ["--sampler", "exhaustive"]),
            (["--backend", "abacus"], ["--backend", "cpu"]),
            (["--candidates", "missing.csv"], ["missing.csv", "no such file"]),
            (["--preset", "magic"], ["--preset", "paper"]),
            (["--problem", "P4P"], ["for '--problem': 'P4P' is not one of 'p3p', 'up2p'"]),
            (
                ["--max-evaluations", "100"],
                ["or minimal sets, above the limit of 100", "--sampler random", "--samples", "--max-evaluations"],
            ),
            (["--vertical-camera", "0,1,0"], ["--vertical-camera", "up2p"]),
            (["--axis", "0,1,0"], ["--axis", "3p1"]),
            (["--axis-noise", "0.1"], ["--axis-noise", "3p1"]),
            (["--plot", "match.bmp"], [".png, .svg or .pdf"]),
            (["--output", "missing/matches.csv"], ["--output", "does not exist"]),
            (["--frobnicate"], ["--frobnicate", "rootmatch match --help"]),
        ],
    )
    def test_options(self, tmp_path: Path, options: list[str], words: list[str]) -> None:
        line = self.match(tmp_path, *options)
        for word in words:
            assert word in line

    @pytest.mark.parametrize(
        ("camera", "words"),
        [
            ("0,1000,320,240", "--camera: focal length fx is 0"),
            ("1000,-5,320,240", "--camera: focal length fy is -5"),
            ("1000,1000,320", "--camera: '1000,1000,320' given; give 4 finite numbers"),
            ("camera.json", "camera.json: there is no such file"),
        ],
    )
    def test_cameras(self, tmp_path: Path, camera: str, words: str) -> None:
        assert words in self.match(tmp_path, camera=camera)

    @pytest.mark.parametrize("option", ["--vertical-camera", "--vertical-world"])
    @pytest.mark.parametrize(("vector", "words"), [("0,0,0", "length is 0"), ("0,1", "give 3"), ("0,x,0", "give 3")])
    def test_verticals(self, tmp_path: Path, option: str, vector: str, words: str) -> None:
        line = self.match(tmp_path, option, vector, problem="up2p")
        assert f"rootmatch: {option}: " in line
        assert words in line

    @pytest.mark.parametrize("degrees", ["-1", "46", "nan"])
    def test_noise_of_a_vertical(self, tmp_path: Path, degrees: str) -> None:
        assert "give degrees from 0 to 45" in self.match(tmp_path, "--vertical-noise", degrees, problem="up2p")

    def test_an_output_is_never_an_input(self, tmp_path: Path) -> None:
        (tmp_path / "model.csv").write_text(GOOD_MODEL)
        line = self.match(tmp_path, "--output", tmp_path / "model.csv")
        assert "also an input" in line

    def test_a_request_far_too_large_is_refused_at_once(self, tmp_path: Path) -> None:
        rng = np.random.default_rng(1)
        model = "x,y,z\n" + "".join(f"{x},{y},{z}\n" for x, y, z in rng.normal(size=(60, 3)))
        image = "x,y\n" + "".join(f"{x},{y}\n" for x, y in rng.uniform(0, 480, (90, 2)))
        line = self.match(tmp_path, "--sampler", "exhaustive", model=model, image=image)
        assert "60 source against 90 target points are 2.99e+13 hyper-edges" in line
        for alternative in ("--sampler random", "--samples", "--max-evaluations"):
            assert alternative in line

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["match"], "Missing argument 'MODEL.csv'"),
            (["match", "a.csv", "b.csv"], "Missing option '--problem'"),
            (["match", "a.csv", "b.csv", "--problem", "p5p", "--camera", CAMERA], "p5p"),
            (["mach"], "No such command 'mach'"),
            (["diagnose", "a.csv", "b.csv"], "it is an option: see rootmatch match --help, --diagnose"),
            (["simulate", "p3p"], "Missing option '--output'"),
            (["simulate", "p3p", "--points", "0", "--output", "scene"], "--points is 0"),
            (["simulate", "p3p", "--noise", "-1", "--output", "scene"], "--noise is -1"),
            (["simulate", "p3p", "--baseline", "2", "--output", "scene"], "--baseline"),
            (["simulate", "3p1", "--baseline", "0", "--output", "scene"], "--baseline is 0"),
            (["simulate", "3p1", "--motions", "2", "--output", "scene"], "--motions"),
            (["simulate", "up2p", "--motions", "11", "--output", "scene"], "11 motions for 10 points"),
            (["simulate", "p3p", "--output", "missing/scene"], "does not exist"),
        ],
    )
    def test_usage(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str) -> None:
        monkeypatch.chdir(tmp_path)
        assert words in self.refused(tmp_path, *arguments)
        assert list(tmp_path.iterdir()) == []


class TestSimulate:
    @pytest.mark.parametrize("problem", ["p3p", "up2p", "3p1"])
    def test_the_same_seed_gives_the_same_files(self, tmp_path: Path, problem: str) -> None:
        options = ["--points", 5, "--outliers", 3, "--hidden", 2, "--noise", 0.5]
        for name, seed in (("a", 7), ("b", 7), ("c", 8)):
            assert run("simulate", problem, *options, "--seed", seed, "--output", tmp_path / name).exit_code == 0
        contents = {name: {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in "abc"}
        assert set(contents["a"]) == {"model.csv", "image.csv", "truth.csv", "camera.json"}
        assert contents["a"] == contents["b"]
        assert contents["a"]["model.csv"] != contents["c"]["model.csv"]
        assert len(rows_of(tmp_path / "a" / "model.csv")) == 7
        assert list(rows_of(tmp_path / "a" / "model.csv")[0]) == (["x", "y"] if problem == "3p1" else ["x", "y", "z"])
        assert len(rows_of(tmp_path / "a" / "image.csv")) == 8
        truth = rows_of(tmp_path / "a" / "truth.csv")
        sources, targets = [row["source"] for row in truth], [row["target"] for row in truth]
        assert len(set(sources)) == len(set(targets)) == len(truth) == 5
        assert {int(source) for source in sources} < set(range(7))
        assert {int(target) for target in targets} < set(range(8))
        assert ("camera2" in json.loads((tmp_path / "a" / "camera.json").read_text())) == (problem == "3p1")

    def test_a_full_folder_needs_force(self, tmp_path: Path) -> None:
        assert run("simulate", "p3p", "--output", tmp_path / "s").exit_code == 0
        before = (tmp_path / "s" / "model.csv").read_bytes()
        result = run("simulate", "p3p", "--seed", 1, "--output", tmp_path / "s")
        assert result.exit_code == 2
        assert "--force" in result.stderr
        assert (tmp_path / "s" / "model.csv").read_bytes() == before
        assert run("simulate", "p3p", "--seed", 1, "--output", tmp_path / "s", "--force").exit_code == 0
        assert (tmp_path / "s" / "model.csv").read_bytes() != before


class TestProgram:
    def test_help_and_version_import_nothing_heavy(self) -> None:
        code = (
            "import sys\nfrom rootmatch.cli import main\nsys.argv = ['rootmatch', sys.argv[1]]\n"
            "try:\n    main()\nexcept SystemExit as stop:\n    assert stop.code == 0\n"
            "heavy = {'matplotlib', 'dask', 'sympy', 'poselib'} & set(sys.modules)\nassert not heavy, heavy\n"
        )
        for option, words in (("--help", "simulate"), ("--version", "rootmatch ")):
            result = subprocess.run([sys.executable, "-c", code, option], capture_output=True, text=True, check=False)
            assert result.returncode == 0, result.stderr
            assert words in result.stdout

    def test_python_runs_the_package(self) -> None:
        command = [sys.executable, "-m", "rootmatch", "--version"]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (result.returncode, result.stderr) == (0, "")
        assert result.stdout.startswith("rootmatch ")

    @pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
    def test_a_mistake_shows_no_traceback(self, tmp_path: Path) -> None:
        words = ["match", "a.csv", "b.csv", "--problem", "p3p", "--camera", CAMERA]
        child = started(words, tmp_path, tmp_path / "logs")
        assert child.ended(60.0)
        assert (child.code, child.stdout) == (2, "")
        assert child.stderr == "rootmatch: a.csv: there is no such file; check the name\n"

    @pytest.mark.skipif(os.name == "nt", reason="pipes end otherwise there")
    def test_a_reader_that_leaves_early_sees_no_traceback(self) -> None:
        with subprocess.Popen([*PROGRAM, "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stderr is not None
            process.stdout.close()
            assert process.stderr.read() == b""


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("source: too few", "a=b.csv: too few"),
        ("n is 0; expected more", "--points is 0; expected more"),
        (
            'use sampler="random" with samples=…, or raise max_evaluations=',
            "use --sampler random with --samples, or raise --max-evaluations",
        ),
        ("raise max_hyperedges= now", "raise --max-hyperedges now"),
        ("all is well: a == b", "all is well: a == b"),
    ],
)
def test_errors_speak_of_files_and_options(text: str, expected: str) -> None:
    assert translate_to_options(text, {"source": "a=b.csv", "n": "--points"}) == expected


def test_a_report_of_numbers_that_json_cannot_hold(capsys: pytest.CaptureFixture[str]) -> None:
    from rich.console import Console

    from rootmatch.report.json_record import match_record
    from rootmatch.report.text import print_match
    from rootmatch.result import Status

    make: Callable[..., Any] = SimpleNamespace
    found = make(
        assignment=np.array([1, -1, 0]),
        score=np.float64("nan"),
        noise_factor=np.float64("nan"),
        point_error=0.0,
        margin=0.0,
        probability=None,
        confidence=np.array([0.5, np.nan, 1.0]),
        converged=False,
        motion_labels=np.array([0, -1, 1]),
        log_odds=None,
        alternatives=[(np.array([0, -1, 1]), np.inf)],
        soft_assignment=np.array([[0.0, 0.5], [0.0, 0.0], [0.25, 0.0]]),
        status=Status.AMBIGUOUS,
        advice=str(Status.AMBIGUOUS),
        seconds=0.5,
        evaluated=1234567,
        noise=np.array([0.5, 1.0]),
        stopped_early=False,
        prior_holds=None,
        sightings=None,
        bodies=None,
        problem=make(min_for_pose=0),
    )
    record = match_record(found)
    assert record["score"] is None
    assert record["noise"] is None
    assert record["probability"] is None
    assert record["converged"] is False
    assert record["alternatives"] == [{"assignment": [0, -1, 1], "score": None, "poses": None}]
    json.dumps(record, allow_nan=False)
    print_match(found, Console(width=80), truth=np.array([1, 0, -1]), source_names=["a", "b", "c"])
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "a 1 0.500 0.50 0 right" in lines
    assert "c 0 0.250 > 0.9999 1 WRONG, has no image" in lines
    assert "unmatched source points: b" in lines
    assert "truth: 1 of 2 right, 1 wrong, 1 missed" in lines
    assert "alternative 1, score inf: a→0, c→1" in lines
    assert any("1,234,567 hyper-edges" in line for line in lines)


def test_every_option_is_documented() -> None:
    pages = Path(__file__).parents[1] / "docs"
    text = (pages / "cli.md").read_text(encoding="utf-8")
    for command in ("match", "track", "simulate", "benchmark", "reproduce"):
        section = (pages / "reproduction.md").read_text(encoding="utf-8")
        if command != "reproduce":
            section = text.split(f"## rootmatch {command}\n")[1].split("\n## ")[0]
        screen = CliRunner(env={"COLUMNS": "200", "NO_COLOR": "1"}).invoke(app, [command, "--help"]).stdout
        options = set(re.findall(r"--[a-z][a-z0-9-]*", screen)) - {"--help"}
        assert len(options) > 5
        assert not {option for option in options if f"`{option}" not in section}


@pytest.mark.parametrize("command", ["match", "track"])
def test_help_has_room_in_a_narrow_terminal(command: str) -> None:
    """What a value looks like is said in the text: a wide column for it leaves none for the text."""
    screen = CliRunner(env={"COLUMNS": "80", "NO_COLOR": "1"}).invoke(app, [command, "--help"]).stdout
    assert "…" not in screen
    narrow = screen.split("Points and cameras")[1].split("Method")[0]
    assert re.search(r"--noise +SIGMA +Standard deviation of a ", narrow)
    assert "frame after S seconds" in " ".join(screen.replace("│", " ").split())
