"""The report in the browser: what it holds, and, where there is Chromium, what it does."""

import json
import re
import shutil
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.errors import InputError
from rootmatch.simulation import p3p_scene

pytest.importorskip("plotly")
HOSTILE = "<script>document.title='obeyed'</script>&<b>"


@pytest.fixture(scope="module")
def scene() -> Any:
    return p3p_scene(n=8, outliers=3, noise=0.5, seed=1, hidden=1)


@pytest.fixture(scope="module")
def match(scene: Any) -> rm.Match:
    return rm.match(scene.source, scene.target, scene.problem, noise=0.5)


@pytest.fixture(scope="module")
def ambiguous() -> rm.Match:
    angles = np.deg2rad(60.0 * np.arange(6))
    hexagon = np.column_stack([0.1 * np.cos(angles), 0.1 * np.sin(angles), np.zeros(6)])
    tilt = np.array([[1, 0, 0], [0, 0.82, -0.57], [0, 0.57, 0.82]])
    camera = rm.Camera(900, 900, 320, 240)
    pixels = camera.project(hexagon @ np.linalg.qr(tilt)[0].T + (0.02, -0.01, 0.8))
    noisy = pixels + 0.3 * np.random.default_rng(0).normal(size=(6, 2))
    return rm.match(hexagon, noisy, rm.P3P(camera), noise=0.3)


def content_of(page: Path) -> dict[str, Any]:
    text = page.read_text(encoding="utf-8")
    found = re.search(r'<script type="application/json" id="content">(.*?)</script>', text, re.DOTALL)
    return json.loads(found.group(1))


def test_the_page_holds_the_match(scene: Any, match: rm.Match, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    match.report(page, truth=scene.truth, title="eight points")
    content = content_of(page)
    view = content["views"][0]
    assert view["assignment"] == match.assignment.tolist()
    assert view["wrong"] == ((match.assignment >= 0) & (match.assignment != scene.truth)).tolist()
    assert content["status"] == match.status.name.lower()
    pose = match.poses[0]
    for point, where in zip(pose.points, pose.predicted, strict=True):
        np.testing.assert_allclose(view["predicted"][point], where)
    # the camera's centre, and a corner that lies straight in front of it
    centre, *corners = np.array(view["poses"][0]["frustum"])
    np.testing.assert_allclose(centre, -pose.R.T @ pose.t)
    assert np.all(pose.transform(corners)[:, 2] > 0.0)
    # a ray from the centre through a detection on the drawn image ends at its point
    seen = view["poses"][0]["seen"]
    for point, detection in match.pairs:
        sight, there = np.array(seen[detection]) - centre, scene.source[point] - centre
        off = np.linalg.norm(there - sight * (there @ sight) / (sight @ sight)) / np.linalg.norm(there)
        assert off < 5 * 0.5 / 1000  # five σ over the focal length
        assert np.linalg.norm(sight) < np.linalg.norm(there)
    assert "<title>eight points</title>" in page.read_text(encoding="utf-8")


def test_the_page_needs_no_network(match: rm.Match, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    match.report(page)
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"<(script|link|img|iframe)[^>]+(src|href)=", text)
    assert "default-src 'none'" in text


def test_names_are_text(match: rm.Match, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    match.report(page, source_names=[HOSTILE] * 9, target_names=[f"{HOSTILE}{j}" for j in range(11)], title=HOSTILE)
    text = page.read_text(encoding="utf-8")
    assert HOSTILE not in text
    assert content_of(page)["sourceNames"] == [HOSTILE] * 9
    assert unescape(re.search("<h1>(.*?)</h1>", text).group(1)) == HOSTILE


def test_alternatives_say_what_differs(ambiguous: rm.Match, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    ambiguous.report(page)
    views = content_of(page)["views"]
    assert len(views) > 1
    for view, (other, _) in zip(views[1:], ambiguous.alternatives, strict=False):
        assert view["assignment"] == other.tolist()
        first = int(np.flatnonzero(other != ambiguous.assignment)[0])
        assert f"{first} → " in view["differs"]
    # one of twelve is right, and each explains the image as well: six turns, seen from both sides
    assert 0.0 < views[1]["probability"] <= views[0]["probability"]
    assert sum(view["probability"] for view in views) <= 1.0 + 1e-9


def test_every_kind_of_problem_is_drawn(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    model = rng.uniform(-1.0, 1.0, (6, 3))
    moved = rm.match(model, model + 0.001 * rng.normal(size=(6, 3)), rm.Rigid(3), noise=(0.0, 0.001))
    moved.report(tmp_path / "moved.html")
    content = content_of(tmp_path / "moved.html")
    assert (content["sourceSide"]["title"], content["targetSide"]["title"]) == ("Source", "Target")
    assert len(content["views"][0]["predicted"][0]) == 3


def test_a_photograph_lies_behind_the_image(match: rm.Match, tmp_path: Path) -> None:
    from PIL import Image

    Image.new("RGB", (640, 480), (10, 20, 30)).save(tmp_path / "photo.png")
    match.report(tmp_path / "report.html", photo=tmp_path / "photo.png")
    side = content_of(tmp_path / "report.html")["targetSide"]
    assert side["photo"].startswith("data:image/png;base64,")
    assert side["photoSize"] == [640, 480]
    low, high = side["extent"][:2], side["extent"][2:]
    assert low[0] <= -0.5
    assert high[0] >= 639.5


@pytest.mark.parametrize(
    ("name", "content", "says"), [("x.gif", b"", "give a .png"), ("x.png", b"no picture", "cannot be read")]
)
def test_what_is_no_photograph_is_refused(
    match: rm.Match, tmp_path: Path, name: str, content: bytes, says: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=says):
        match.report(tmp_path / "report.html", photo=tmp_path / name)
    assert not (tmp_path / "report.html").exists()


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("truth", "x", "truth: 'x' given; give the index"),
        ("truth", [0.5] * 3, "truth: .* given; give the index"),
        ("truth", None, "truth: an index beyond"),
        ("truth", [[1], [2, 3]], "truth: .* given; give the index"),
        ("source_names", ["a"], "source_names: 1 given; give the names of all"),
        ("target_names", [], "target_names: 0 given"),
    ],
)
def test_what_is_said_of_the_points_is_checked(
    match: rm.Match, tmp_path: Path, option: str, value: Any, says: str
) -> None:
    if value is None:
        value = [len(match.target)] * len(match.source)
    with pytest.raises(InputError, match=says):
        match.report(tmp_path / "report.html", **{option: value})
    assert list(tmp_path.iterdir()) == []


def test_a_title_that_is_no_text_is_shown_as_its_escape(match: rm.Match, tmp_path: Path) -> None:
    match.report(tmp_path / "report.html", title="a \udcff b")
    assert "a \\udcff b" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_what_is_no_page_is_refused(match: rm.Match, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"ends in \.html"):
        match.report(tmp_path / "report.pdf")
    with pytest.raises(InputError, match="does not exist"):
        match.report(tmp_path / "nowhere" / "report.html")


# In a browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    chromedriver = shutil.which("chromedriver")
    if not chromium or not chromedriver:
        pytest.skip("no Chromium with chromedriver on this machine")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for argument in ("--headless=new", "--no-sandbox", "--disable-background-networking", "--window-size=1300,1000"):
        options.add_argument(argument)
    options.add_argument("--enable-unsafe-swiftshader")  # WebGL without a graphics card
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(chromedriver))
    yield driver
    driver.quit()


def opened(browser: Any, page: Path) -> None:
    browser.get(page.as_uri())
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(browser, 60).until(
        lambda driver: driver.execute_script("return document.body.dataset.ready") == "true"
    )


def errors(browser: Any) -> list[str]:
    return [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


def test_tabs_change_the_assignment(browser: Any, ambiguous: rm.Match, tmp_path: Path) -> None:
    ambiguous.report(tmp_path / "report.html")
    opened(browser, tmp_path / "report.html")
    read = "return [...document.querySelectorAll('#table tbody tr')].map((row) => Number(row.dataset.target))"
    assert browser.execute_script(read) == ambiguous.assignment.tolist()
    browser.find_elements("css selector", "#tabs button")[1].click()
    assert browser.execute_script(read) == ambiguous.alternatives[0][0].tolist()
    assert errors(browser) == []


def test_hovering_a_point_lights_its_partner(browser: Any, match: rm.Match, tmp_path: Path) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.support.ui import WebDriverWait

    match.report(tmp_path / "report.html", source_names=[HOSTILE] * 9)
    opened(browser, tmp_path / "report.html")
    # where the first matched detection is drawn, from the middle of the plot
    pair, right, down = browser.execute_script(
        "const plot = document.getElementById('target'), trace = plot.data.at(-1);"
        "const k = trace.customdata.findIndex(([i]) => i >= 0), { xaxis, yaxis } = plot._fullLayout;"
        "const box = plot.getBoundingClientRect();"
        "return [trace.customdata[k], xaxis._offset + xaxis.d2p(trace.x[k]) - box.width / 2,"
        " yaxis._offset + yaxis.d2p(trace.y[k]) - box.height / 2]"
    )
    plot = browser.find_element("id", "target")
    ActionChains(browser).move_to_element(plot).move_by_offset(round(right), round(down)).perform()
    lit = (
        "return [...document.querySelectorAll('tr.lit')]"
        ".map((row) => [Number(row.dataset.source), Number(row.dataset.target)])"
    )
    WebDriverWait(browser, 20).until(lambda driver: driver.execute_script(lit))
    assert browser.execute_script(lit) == [pair]
    (line,) = browser.execute_script(
        "return document.getElementById('source').data"
        ".filter((trace) => trace.line && trace.line.color === '#ff2d8a').map((trace) => trace.x)"
    )
    assert line[1] == pytest.approx(match.source[pair[0], 0])
    assert browser.title == "rootmatch report"  # nothing in a name was obeyed
    assert errors(browser) == []


def test_points_fill_the_view_however_far_the_camera(browser: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    points, camera = rng.uniform(-0.1, 0.1, (8, 3)), rm.Camera(20000, 20000, 320, 240)
    pixels = camera.project(points + np.array([0.0, 0.0, 10.0])) + rng.normal(0.0, 0.3, (8, 2))
    rm.match(points, pixels, rm.P3P(camera), noise=0.3).report(tmp_path / "report.html")
    opened(browser, tmp_path / "report.html")
    span = "const z = document.getElementById('source').layout.scene.zaxis.range; return z[1] - z[0]"
    assert browser.execute_script(span) < 1.0
    browser.find_element("id", "whole").click()
    assert browser.execute_script(span) > 10.0
    keys = browser.find_element("id", "target-key").text
    assert "predicted by the pose" in keys
    assert errors(browser) == []


def test_two_hundred_points_are_drawn(browser: Any, match: rm.Match, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    model, many = rng.normal(size=(200, 3)), rm.Camera(800, 800, 320, 240)
    pixels = many.project(model + np.array([0.0, 0.0, 9.0]))
    import dataclasses

    from rootmatch.problems.points import PointSets

    points = PointSets(model, pixels, np.zeros(200), np.full(200, 0.5), None)
    task = dataclasses.replace(match.task, points=points)
    finding = dataclasses.replace(
        match.finding,
        task=task,
        assignment=np.arange(200),
        labels=np.zeros(200, np.int64),
        soft=np.eye(200),
        others=[],
        scores=[200.0],
        confidence=np.ones(200),
    )
    dataclasses.replace(match, finding=finding).report(tmp_path / "report.html")
    opened(browser, tmp_path / "report.html")
    for row in range(5):
        browser.execute_script(
            f"document.querySelectorAll('#table tbody tr')[{row}].dispatchEvent(new Event('mouseenter'))"
        )
    assert len(browser.find_elements("css selector", "#table tbody tr")) == 200
    assert errors(browser) == []
