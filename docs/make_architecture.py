"""Draw docs/architecture.svg: the packages of rootmatch, a row per layer, and the imports between them.

    python docs/make_architecture.py            # rewrites docs/architecture.svg
    python docs/make_architecture.py --check    # exit code 1 if the committed file is out of date

Rows are the layers of `pyproject.toml`; arrows are read from the import statements of `src`. An import that others
imply (A → C given A → B → C) is left out, and so are `arrays`, `frozen`, `deadline`, `errors`, `options` and
`_version`, open to every package.
"""

from __future__ import annotations

import argparse
import ast
import itertools
import sys
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "rootmatch"
PICTURE = ROOT / "docs" / "architecture.svg"
HIDDEN = {"__main__", "__init__", "_version", "arrays", "frozen", "deadline", "errors", "options"}

GROUPS = {
    "interface": ("cli", "io", "report"),
    "measurements": ("research",),
    "matching": ("precompile", "tracking", "api", "matcher", "result", "sightings", "explain", "model"),
    "hypergraph": ("samplers", "solvers", "backends", "hypergraph"),
    "geometry": ("derivation", "simulation", "problems", "cameras", "algebra"),
    "foundation": ("jit",),
}
CAPTIONS = {
    "cli": "commands, options, exit codes",
    "io": "CSV points, camera files",
    "report": "text, JSON, pictures",
    "research": "experiments, benchmarks",
    "precompile": "kernels ahead of need",
    "matcher": "frame after frame",
    "api": "match(), residuals()",
    "tracking": "poses from frame to frame",
    "result": "Match",
    "sightings": "what each camera sees",
    "explain": "a task to what was found",
    "model": "evidence, posterior",
    "samplers": "which hyper-edges to evaluate",
    "solvers": "tensor to assignment",
    "backends": "CPU, CUDA, Dask",
    "derivation": "SymPy equations to a problem",
    "simulation": "scenes with ground truth",
    "hypergraph": "tensor, affinity, support",
    "problems": "a folder per problem",
    "cameras": "lenses, bearings, rigs",
    "algebra": "polynomials, resultants",
    "jit": "all that knows Numba's internals",
}
LIGHT = {
    "interface": ("#e8eefc", "#4a6fd0"),
    "measurements": ("#f3eafc", "#8a56c8"),
    "matching": ("#fdeee2", "#cf6a1e"),
    "hypergraph": ("#e3f5ee", "#1f8f68"),
    "geometry": ("#fdf6dc", "#a98408"),
    "foundation": ("#eceef1", "#6b7380"),
}
DARK = {
    "interface": ("#1b2745", "#86a6f5"),
    "measurements": ("#2c1f3f", "#bd93ee"),
    "matching": ("#3b2413", "#f0a062"),
    "hypergraph": ("#11332a", "#5ccba2"),
    "geometry": ("#352c0b", "#dfc05a"),
    "foundation": ("#262b33", "#a5aebb"),
}

BOX_HEIGHT, ROW_HEIGHT, GAP, MARGIN, LEGEND = 46, 80, 34, 28, 44
LANE = 14
"""Width kept free for an arrow that passes a row."""
SWEEPS = 24


@dataclass
class Node:
    """A package in its row, or (without a name) the place where an arrow passes a row."""

    name: str
    row: int
    width: float
    x: float = 0.0


def layers() -> list[list[str]]:
    """The layers of the import contract, highest first."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        contracts = tomllib.load(file)["tool"]["importlinter"]["contracts"]
    contract = next(one for one in contracts if one["type"] == "layers")
    rows = [[name.strip(" ()") for name in layer.replace("|", ":").split(":")] for layer in contract["layers"]]
    return [names for row in rows if (names := [name for name in row if name not in HIDDEN])]


def run(tree: ast.AST) -> Iterable[ast.AST]:
    """The nodes of a module, but for what only type checkers read: a report names the type of what it reports."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        skipped = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        waiting += node.orelse if skipped else ast.iter_child_nodes(node)


def imported(tree: ast.AST) -> Iterable[str]:
    """Packages below `rootmatch` that a module imports, wherever the statement stands."""
    for node in run(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            first, _, rest = name.partition(".")
            if first == "rootmatch" and rest:
                yield rest.split(".")[0]


def imports(packages: set[str]) -> dict[str, set[str]]:
    """The other packages that each package imports."""
    found: dict[str, set[str]] = {name: set() for name in packages}
    for path in sorted(SOURCE.rglob("*.py")):
        owner = path.relative_to(SOURCE).with_suffix("").parts[0]
        if owner in packages:
            tree = ast.parse(path.read_text(encoding="utf-8"))
            found[owner] |= (set(imported(tree)) & packages) - {owner}
    return found


def thinned(graph: dict[str, set[str]]) -> list[tuple[str, str]]:
    """The edges that do not follow from others (transitive reduction)."""

    def reachable(name: str) -> set[str]:
        return graph[name].union(*(reachable(other) for other in graph[name]))

    return sorted(
        (name, other)
        for name, others in graph.items()
        for other in others
        if not any(other in reachable(between) for between in others - {other})
    )


def placed(rows: list[list[str]], edges: list[tuple[str, str]]) -> tuple[list[list[Node]], list[list[Node]]]:
    """Rows of nodes in an order with few crossings, their x set, and the chain of nodes of each arrow."""
    grid = [[Node(name, number, 30 + max(8.6 * len(name), 6.15 * len(CAPTIONS[name]))) for name in row]
            for number, row in enumerate(rows)]  # fmt: skip
    of_name = {node.name: node for row in grid for node in row}
    chains = []
    for upper, lower in edges:
        first, last = of_name[upper], of_name[lower]
        passed = [Node("", number, LANE) for number in range(first.row + 1, last.row)]
        for node in passed:
            grid[node.row].append(node)
        chains.append([first, *passed, last])
    above: dict[int, list[Node]] = {id(node): [] for row in grid for node in row}
    below: dict[int, list[Node]] = {id(node): [] for row in grid for node in row}
    for chain in chains:
        for upper_node, lower_node in itertools.pairwise(chain):
            above[id(lower_node)].append(upper_node)
            (below if upper_node.row < lower_node.row else above)[id(upper_node)].append(lower_node)
    for row in grid:
        spread(row, [float(k) for k in range(len(row))])
    for sweep in range(SWEEPS):
        down = sweep % 2 == 0
        for row in grid if down else grid[::-1]:
            sides = above if down else below
            wanted = []
            for node in row:
                near = sides[id(node)] or [node]
                wanted.append(sum(other.x for other in near) / len(near))
            order = sorted(range(len(row)), key=lambda k: wanted[k])
            row[:] = [row[k] for k in order]
            spread(row, [wanted[k] for k in order])
    for _ in range(SWEEPS):  # an arrow that passes several rows does so in a straight line
        wish = {id(node): node.x for row in grid for node in row}
        for chain in chains:
            if passed := chain[1:-1]:
                wish.update((id(node), sum(each.x for each in passed) / len(passed)) for node in passed)
        for row in grid:
            spread(row, [wish[id(node)] for node in row])
    return grid, chains


def spread(row: list[Node], wanted: list[float]) -> None:
    """Set the x of the nodes of a row, near `wanted`, in their order and without overlap."""
    blocks: list[list[float]] = []  # least squares under separations: pool adjacent violators
    offsets, offset = [], 0.0
    for k, node in enumerate(row):
        if k:
            offset += (row[k - 1].width + node.width) / 2 + GAP
        offsets.append(offset)
        blocks.append([wanted[k] - offset, 1.0])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            (a, m), (b, n) = blocks[-2], blocks.pop()
            blocks[-1] = [(a * m + b * n) / (m + n), m + n]
    positions = [value for value, count in blocks for _ in range(int(count))]
    for node, position, offset in zip(row, positions, offsets, strict=True):
        node.x = position + offset


def ports(chains: list[list[Node]]) -> list[tuple[float, float]]:
    """Where each arrow leaves and enters its boxes: spread along their edges, in the order of the other ends."""
    leave, enter = [0.0] * len(chains), [0.0] * len(chains)
    for ends, end, other in ((leave, 0, 1), (enter, -1, -2)):
        groups: dict[int, list[int]] = {}
        for k, chain in enumerate(chains):
            if chain[0].row == chain[-1].row:
                continue
            groups.setdefault(id(chain[end]), []).append(k)
        for numbers in groups.values():
            numbers.sort(key=lambda k: chains[k][other].x)
            box = chains[numbers[0]][end]
            step = min(26.0, 0.7 * box.width / len(numbers))
            for place, k in enumerate(numbers):
                ends[k] = box.x + step * (place - (len(numbers) - 1) / 2)
    return list(zip(leave, enter, strict=True))


def svg() -> str:
    """The picture."""
    rows = layers()
    packages = {name for row in rows for name in row}
    group = {name: key for key, names in GROUPS.items() for name in names}
    if missing := packages - (CAPTIONS.keys() & group.keys()):
        raise SystemExit(f"{', '.join(sorted(missing))}: give it a caption and a group in {Path(__file__).name}")
    graph = imports(packages)
    for number, row in enumerate(rows):
        if upward := {(name, above) for name in row for higher in rows[:number] for above in graph[name] & set(higher)}:
            raise SystemExit(f"imports go up the layers: {sorted(upward)}; run lint-imports")
    edges = thinned(graph)
    grid, chains = placed(rows, edges)
    left = min(node.x - node.width / 2 for row in grid for node in row)
    right = max(node.x + node.width / 2 for row in grid for node in row)
    for node in (node for row in grid for node in row):
        node.x += MARGIN - left
    width = right - left + 2 * MARGIN
    height = 2 * MARGIN + LEGEND + (len(grid) - 1) * ROW_HEIGHT + BOX_HEIGHT

    def top(row: int) -> float:
        return MARGIN + LEGEND + row * ROW_HEIGHT

    arrows, boxes = [], []
    for chain, (start, end) in zip(chains, ports(chains), strict=True):
        key = group[chain[0].name]
        if chain[0].row == chain[-1].row:  # neighbours
            y, side = top(chain[0].row) + BOX_HEIGHT / 2, 1 if chain[-1].x > chain[0].x else -1
            x0, x1 = chain[0].x + side * chain[0].width / 2, chain[-1].x - side * (chain[-1].width / 2 + 7)
            arrows.append(
                f'<path class="arrow {key}" d="M{x0:.0f} {y:.0f}L{x1:.0f} {y:.0f}" marker-end="url(#{key})"/>'
            )
            continue
        points = [(start, top(chain[0].row) + BOX_HEIGHT)]
        for node in chain[1:-1]:
            points += [(node.x, top(node.row)), (node.x, top(node.row) + BOX_HEIGHT)]
        points.append((end, top(chain[-1].row) - 7))
        path = f"M{points[0][0]:.0f} {points[0][1]:.0f}"
        for (x0, y0), (x1, y1) in zip(points[::2], points[1::2], strict=True):
            middle = (y0 + y1) / 2
            path += f"C{x0:.0f} {middle:.0f} {x1:.0f} {middle:.0f} {x1:.0f} {y1:.0f}"
            following = points.index((x1, y1)) + 1
            if following < len(points):
                path += f"L{points[following][0]:.0f} {points[following][1]:.0f}"
        arrows.append(f'<path class="arrow {key}" d="{path}" marker-end="url(#{key})"/>')
    for node in (node for row in grid for node in row if node.name):
        x, y, key = node.x - node.width / 2, top(node.row), group[node.name]
        boxes.append(
            f'<rect class="box {key}" x="{x:.0f}" y="{y:.0f}" width="{node.width:.0f}" height="{BOX_HEIGHT}" rx="8"/>'
            f'<text class="name" x="{node.x:.0f}" y="{y + 20:.0f}">{node.name}</text>'
            f'<text class="caption" x="{node.x:.0f}" y="{y + 36:.0f}">{escape(CAPTIONS[node.name])}</text>'
        )
    used = [key for key in GROUPS if any(name in packages for name in GROUPS[key])]
    x = float(MARGIN)
    legend = []
    for key in used:
        legend.append(f'<rect class="box {key}" x="{x:.0f}" y="{MARGIN - 8}" width="16" height="16" rx="4"/>')
        legend.append(f'<text class="legend" x="{x + 22:.0f}" y="{MARGIN + 4}">{key}</text>')
        x += 22 + 7.6 * len(key) + 18
    width = max(width, x + MARGIN)
    markers = "".join(
        f'<marker id="{key}" viewBox="0 0 8 8" refX="1" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        f'<path class="head {key}" d="M0 0L8 4L0 8z"/></marker>'
        for key in used
    )
    bands = "".join(
        f'<rect class="band" x="0" y="{top(row) - (ROW_HEIGHT - BOX_HEIGHT) / 2:.0f}" width="{width:.0f}" '
        f'height="{ROW_HEIGHT}"/>'
        for row in range(0, len(grid), 2)
    )
    body = "\n".join([*arrows, *boxes, *legend])
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" '
        f'height="{height:.0f}" role="img" aria-label="Packages of rootmatch by layer, and their imports">\n'
        f"<style>{style(used)}</style>\n<defs>{markers}</defs>\n"
        f'<rect class="page" width="100%" height="100%" rx="10"/>\n{bands}\n{body}\n</svg>\n'
    )


def style(keys: list[str]) -> str:
    """Colours for a light page and, where the viewer says so, a dark one."""

    def colours(scheme: dict[str, tuple[str, str]], page: str, band: str, name: str, caption: str) -> str:
        rules = [f".page{{fill:{page}}}.band{{fill:{band}}}.name,.legend{{fill:{name}}}.caption{{fill:{caption}}}"]
        for key in keys:
            fill, line = scheme[key]
            rules.append(
                f".box.{key}{{fill:{fill};stroke:{line}}}.arrow.{key}{{stroke:{line}}}.head.{key}{{fill:{line}}}"
            )
        return "".join(rules)

    fixed = (
        "text{font-family:ui-sans-serif,system-ui,'Segoe UI',Helvetica,Arial,sans-serif;text-anchor:middle}"
        ".name{font-size:14px;font-weight:600}.caption{font-size:11.5px}"
        ".legend{font-size:12.5px;text-anchor:start}.box{stroke-width:1.4}"
        ".arrow{fill:none;stroke-width:1.5;stroke-opacity:.75}"
    )
    light = colours(LIGHT, "#ffffff", "#f6f7f9", "#1b1f24", "#545d68")
    dark = colours(DARK, "#0d1117", "#131922", "#f0f3f6", "#aab4c0")
    return f"{fixed}{light}@media (prefers-color-scheme:dark){{{dark}}}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="only compare with the committed picture")
    options = parser.parse_args()
    picture = svg()
    if not options.check:
        PICTURE.write_text(picture, encoding="utf-8")
    elif not PICTURE.is_file() or PICTURE.read_text(encoding="utf-8") != picture:
        print(f"{PICTURE.name} is out of date; run python docs/{Path(__file__).name}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
