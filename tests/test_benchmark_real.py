"""The benchmark on real targets: judged by hand-made replies, on made-up data of the same form."""

import json
import shlex
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rootmatch.errors import InputError
from rootmatch.research.real import leaderboard
from rootmatch.research.real.run import judge_reply, run_real
from rootmatch.research.real.scenes import all_scenes, protocols

AWAY = np.array([0.0, 0.0, 6.0])


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A film of two frames: eight points, seven visible in the second."""
    folder = tmp_path / "data"
    folder.mkdir()
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (8, 3))
    K = np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]])
    pixels = (points + AWAY) @ K.T
    image = pixels[:, :2] / pixels[:, 2:] + 0.3 * rng.normal(size=(2, 8, 2))
    image[1, 3] = np.nan
    np.savez(folder / "tears_of_steel_01.npz", points3d=points, points2d=image, K=np.array([K, K]), rms_px=[0.3, 0.3])
    return folder


def answering(tmp_path: Path, body: str) -> str:
    """Command of a method whose reply to ``request`` is made by ``body``."""
    script = tmp_path / "method.py"
    lines = ["import json, sys, time", "for line in sys.stdin:", "    request = json.loads(line)"]
    script.write_text("\n".join([*lines, *(f"    {line}" for line in body.splitlines())]) + "\n")
    return f"{sys.executable} {shlex.quote(str(script))}"


def test_shuffled_scenes_keep_the_truth(data: Path) -> None:
    scenes = list(all_scenes(data))
    assert len(scenes) == 16
    for scene in scenes:
        K = np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]])
        source, target = np.array(scene.request["source"]), np.array(scene.request["target"])
        pixels = (source + AWAY) @ K.T
        seen = scene.truth >= 0
        assert seen.sum() == len(target) == 8 - scene.number % 2
        distance = (pixels[:, :2] / pixels[:, 2:])[seen] - target[scene.truth[seen]]
        assert np.abs(distance).max() < 2.0


def test_replies_are_judged(data: Path) -> None:
    scene = next(iter(all_scenes(data)))
    truth = scene.truth
    swapped = truth.copy()
    swapped[:2] = truth[[1, 0]]
    cases: list[tuple[Any, dict[str, Any]]] = [
        (truth.tolist(), {"right": 8, "wrong": 0, "full": True, "claimed": True, "misled": False, "error": None}),
        (swapped.tolist(), {"right": 6, "wrong": 2, "full": False, "claimed": True, "misled": True}),
        ([-1] * 8, {"right": 0, "wrong": 0, "full": False, "claimed": False, "misled": False}),
        ([0] * 8, {"right": 0, "claimed": False}),
        ([99] * 8, {"right": 0, "claimed": False}),
        ("nonsense", {"right": 0, "claimed": False}),
    ]
    for assignment, expected in cases:
        found = judge_reply(scene, {"assignment": assignment, "wall": 1.0})
        assert {key: found[key] for key in expected} == expected
    assert judge_reply(scene, {"assignment": [99] * 8, "wall": 1.0})["error"]
    assert not judge_reply(scene, {"assignment": truth.tolist(), "matched": False, "wall": 1.0})["claimed"]


def test_a_program_is_measured_and_a_run_resumes(data: Path, tmp_path: Path) -> None:
    method = answering(
        tmp_path, 'print(json.dumps({"assignment": [-1] * len(request["source"]), "seconds": 0.5}), flush=True)'
    )
    output = tmp_path / "out"
    (entry,) = run_real(data, output, [method])
    assert (entry["scenes"], entry["full"], entry["claimed"], entry["median_seconds"]) == (16, 0, 0, 0.5)
    rows = leaderboard.rows_file(output, method)
    lines = rows.read_bytes().splitlines(keepends=True)
    # cut off in the middle of the fourth row: the run goes on there
    rows.write_bytes(b"".join(lines[:3]) + lines[3][:20])
    calls = []
    (again,) = run_real(data, output, [method], progress=lambda done, total: calls.append((done, total)))
    assert again == entry
    assert calls[0] == (4, 16)
    assert len(calls) == 13
    assert json.loads((output / "leaderboard.json").read_text()) == [entry]
    assert "| film |" in (output / "leaderboard.md").read_text()


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("time.sleep(60)", "no reply within"),
        ("sys.exit(3)", "ended"),
        ('print("hello", flush=True)', "no reply in JSON"),
        ('sys.stdout.buffer.write(b"\\xff\\xfe{}\\n"); sys.stdout.flush()', "no reply in JSON: '\ufffd\ufffd{}'"),
        ('print("[" * 100000, flush=True)', "no reply in JSON"),
        ('print("{\\"error\\": \\"\\"}", flush=True)', "an error without words"),
        ('print("{\\"error\\": [1]}", flush=True)', "[1]"),
        *(
            (f'print(json.dumps({{"assignment": [-1] * 8, "seconds": {given}}}), flush=True)', "which is no time")
            for given in ('"abc"', "None", "float('nan')", "1e999", "-1.0", "True", "[]")
        ),
    ],
)
def test_a_program_that_fails_counts_as_failed(data: Path, tmp_path: Path, body: str, says: str) -> None:
    from rootmatch.research.real.program import Program

    scene = next(iter(all_scenes(data)))
    with closing(Program(answering(tmp_path, body), start_up=2.0)) as program:
        found = judge_reply(scene, program.ask(scene.request, 2.0))
    assert says in found["error"]
    assert (found["right"], found["claimed"]) == (0, False)


def test_bad_input_is_refused(data: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a folder"):
        run_real(tmp_path / "nowhere", tmp_path / "out", ["rootmatch"])
    with pytest.raises(InputError, match="protocol: 'x' given"):
        run_real(data, tmp_path / "out", ["rootmatch"], only=["x"])
    with pytest.raises(InputError, match="cannot be started"):
        run_real(data, tmp_path / "out", ["/no/such/program"])
    for method in ("", " ", "program 'x", "pro\0gram", "x" * 5000):
        with pytest.raises(InputError, match="method: ") as caught:
            run_real(data, tmp_path / "out", ["rootmatch", method])
        assert len(str(caught.value)) < 200
    for timeout in (0.0, -1.0, np.inf, np.nan, 1e300):
        with pytest.raises(InputError, match=r"timeout: .* given; give a number of seconds above 0"):
            run_real(data, tmp_path / "out", ["rootmatch"], timeout=timeout)


def test_damaged_data_are_one_error(data: Path, tmp_path: Path) -> None:
    file = data / "tears_of_steel_01.npz"
    whole = file.read_bytes()
    middle = len(whole) // 3
    flipped = whole[:middle] + bytes(255 - b for b in whole[middle : middle + 40]) + whole[middle + 40 :]
    for content in (b"", b"no zip", whole[:200], whole[:-30], flipped, b"PK\x03\x04" + b"\0" * 100):
        file.write_bytes(content)
        with pytest.raises(InputError, match=r"data: .*(cannot be read|does not hold)") as caught:
            run_real(data, tmp_path / "out", ["rootmatch"])
        assert len(str(caught.value)) < 300
    np.savez(file, points3d=np.array(3))
    with pytest.raises(InputError, match="does not hold what film needs"):
        run_real(data, tmp_path / "out", ["rootmatch"])


def test_methods_that_begin_alike_have_rows_of_their_own(data: Path, tmp_path: Path) -> None:
    method = answering(tmp_path, 'print(json.dumps({"assignment": [-1] * len(request["source"])}), flush=True)')
    alike = [f"{method} {'x' * 100} {k}" for k in range(2)]
    table = run_real(data, tmp_path / "out", alike)
    assert sorted((entry["method"], entry["scenes"]) for entry in table) == [(one, 16) for one in alike]
    assert len({leaderboard.rows_file(tmp_path, name) for name in ("a b", "a-b", "a  b", "é", "è", "rootmatch")}) == 6
    assert leaderboard.rows_file(tmp_path, "rootmatch").name == "rootmatch.jsonl"


@pytest.mark.parametrize("line", [b"{", b"\xff\xff", b"{}", b"[]", b"null", b"[" * 100_000, b'{"method": 1}'])
def test_a_damaged_row_is_named(tmp_path: Path, line: bytes) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_bytes(line + b"\n")
    with pytest.raises(InputError, match=r"rows\.jsonl, line 1: damaged; remove the file"):
        leaderboard.read_rows(path)
    path.write_bytes(line)  # cut off, and so left out
    assert leaderboard.read_rows(path) == []


def test_every_protocol_has_a_scene(load_shared: Any) -> None:
    for protocol in protocols():
        found = protocol.make(load_shared(protocol.file), 0)
        assert found.protocol == protocol.name
        json.dumps(found.request, allow_nan=False)


def test_this_library_replies() -> None:
    from rootmatch.research.real.methods import reply
    from rootmatch.simulation import p3p_scene

    scene = p3p_scene(n=8, outliers=3, noise=0.5, seed=1)
    camera = {"fx": 1000.0, "fy": 1000.0, "cx": 320.0, "cy": 240.0}
    request = {
        "source": scene.source.tolist(),
        "target": scene.target.tolist(),
        "problem": "p3p",
        "camera": camera,
        "noise": 0.5,
    }
    found = reply(request, "rootmatch")
    assert scene.accuracy(np.array(found["assignment"])) == 1.0
    assert found["matched"]
    assert "error" in reply({**request, "noise": -1.0}, "rootmatch")
