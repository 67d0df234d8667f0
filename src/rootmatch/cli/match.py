"""The command ``rootmatch match``: two files of points in, their matches out."""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from rootmatch.cli import match_options as option
from rootmatch.cli.cold import compiled_beside
from rootmatch.cli.error_messages import option_names_in_errors
from rootmatch.cli.exit_codes import NOT_TRUSTED
from rootmatch.cli.problem_options import build_problem, flag
from rootmatch.cli.progress import progress_bar
from rootmatch.errors import InputError, quoted

if TYPE_CHECKING:
    from rootmatch.io import PointSet
    from rootmatch.result import Match


def match(
    model: option.Model,
    image: option.Image,
    problem: option.Problem,
    camera: option.Camera = None,
    noise: option.Noise = "1",
    vertical_camera: option.VerticalCamera = None,
    vertical_world: option.VerticalWorld = None,
    vertical_noise: option.VerticalNoise = None,
    camera2: option.Camera2 = None,
    axis: option.Axis = None,
    axis2: option.Axis2 = None,
    axis_noise: option.AxisNoise = None,
    centre: option.Centre = None,
    dimension: option.Dimension = None,
    normals: option.Normals = True,
    view_angle: option.ViewAngle = None,
    detection: option.Detection = None,
    candidates: option.Candidates = None,
    motions: option.Motions = "1",
    preset: option.Preset = None,
    hyperedges: option.Hyperedges = None,
    samples: option.Samples = None,
    residual: option.Residual = None,
    rho: option.Rho = None,
    solver: option.Solver = None,
    limit: option.Limit = None,
    max_hyperedges: option.MaxHyperedges = None,
    max_seconds: option.MaxSeconds = None,
    backend: option.Backend = None,
    scheduler: option.Scheduler = None,
    seed: option.Seed = 0,
    output: option.Output = None,
    plot: option.Plot = None,
    as_json: option.AsJson = False,
    truth: option.Truth = None,
    progress: option.Progress = None,
) -> None:
    """Match points to image detections by geometry alone.

    Image x points right and y down; points are raw pixels where the camera file has the lens. The camera looks along z.

    Exit code 0: matched; 1: no trustworthy match, or an ambiguous one (the best one is printed all the same); 2: bad
    input; 130: interrupted.
    """
    problem_options: dict[str, str | float | int | None] = {
        "camera": camera,
        "vertical_camera": vertical_camera,
        "vertical_world": vertical_world,
        "vertical_noise": vertical_noise,
        "camera2": camera2,
        "axis": axis,
        "axis2": axis2,
        "axis_noise": axis_noise,
        "centre": centre,
        "dimension": dimension,
    }
    _check_outputs(output, plot, [model, image, *(path for path in (truth, candidates) if path)])
    posed = build_problem(str(problem), problem_options)
    from rootmatch import io

    source = io.read_points(model, posed.source_dimension, posed.order)
    target = io.read_points(image, posed.target_dimension, posed.order)
    true = io.read_truth(truth, source, target) if truth else None
    options: dict[str, Any] = {
        "view_angle": view_angle,
        "detection": detection,
        "hyperedges": hyperedges,
        "samples": samples,
        "residual": residual,
        "rho": rho,
        "solver": solver,
        "limit": limit,
        "max_hyperedges": max_hyperedges,
        "max_seconds": max_seconds,
        "backend": backend,
        "scheduler": scheduler,
        "candidates": io.read_candidates(candidates, source, target) if candidates else None,
        "preset": preset.value if preset else None,
    }
    options = {name: value for name, value in options.items() if value is not None}
    subjects = {name: flag(name) for name in (*options, "noise", "motions", "seed")}
    with (
        option_names_in_errors({"source": str(model), "target": str(image), **subjects}),
        progress_bar("hyper-edges", progress) as show,
        ExitStack() as beside,
    ):
        from rootmatch.match import match as find

        if solver is None and preset is None:
            waiting = beside.enter_context(compiled_beside(posed, _motions(motions) != 1))
            options |= {"solver": waiting} if waiting else {}
        found = find(
            source.points,
            target.points,
            posed,
            noise=_noise(noise),
            seed=seed,
            motions=_motions(motions),
            normals=source.normals if normals else None,
            progress=show,
            **options,
        )
    _write(found=found, source=source, target=target, true=true, output=output, plot=plot)
    _print(found=found, source=source, target=target, true=true, as_json=as_json, estimated=noise == "auto")
    if found.status.name != "MATCHED":
        raise typer.Exit(NOT_TRUSTED)


def _check_outputs(output: Path | None, plot: Path | None, inputs: list[Path]) -> None:
    """Refuse unwritable outputs before any work is done."""
    from rootmatch.io import check_output

    if output is not None:
        check_output(output, "--output", inputs)
    if plot is not None:
        from rootmatch.report.pictures import check_picture

        check_picture(plot)
        check_output(plot, "--plot", [*inputs, *([output] if output else [])])


def _motions(text: str) -> Any:
    """A number, or "auto"."""
    if text == "auto":
        return text
    try:
        return int(text)
    except ValueError:
        raise InputError(f"motions: {quoted(text)} given; give a whole number of at least 1, or auto") from None


def _noise(text: str) -> Any:
    """A number of pixels, or "auto"."""
    if text == "auto":
        return text
    try:
        return float(text)
    except ValueError:
        raise InputError(f"noise: {quoted(text)} given; give a number of pixels, or auto") from None


def _write(found: Match, source: PointSet, target: PointSet, true: Any, output: Path | None, plot: Path | None) -> None:
    """Write the requested files: all of them or none."""
    from rootmatch import io
    from rootmatch.report import text

    with ExitStack() as moves:
        places = {path: moves.enter_context(io.written_whole(path)) for path in (output, plot) if path is not None}
        if output is not None:
            weights = text.match_weights(found)
            io.write_matches(
                path=places[output],
                assignment=found.assignment,
                weights=weights,
                motions=found.motions,
                source=source,
                target=target,
            )
        if plot is not None:
            from rootmatch.report import pictures

            figure = pictures.match_figure(
                source.points,
                target.points,
                found.assignment,
                motions=found.motions,
                truth=true,
                source_names=source.names,
                target_names=target.names,
                title=f"{text.summary(found)} ({found.status.name.lower()})",
            )
            pictures.save_figure(figure, places[plot])


def _print(found: Match, source: PointSet, target: PointSet, true: Any, as_json: bool, estimated: bool) -> None:
    """Print the match on standard output: a table, or one JSON object with the advice on standard error."""
    from rootmatch.report import text

    if as_json:
        from rootmatch.report.json_record import match_record

        print(json.dumps(match_record(found), allow_nan=False))
        print(f"rootmatch: {found.advice}", file=sys.stderr)
        return
    from rich.console import Console

    names = {"source_names": source.names, "target_names": target.names}
    console = Console()
    with console.capture() as captured:  # printed by itself, rich ends a program whose reader has gone with 1
        text.print_match(found, console, **names, truth=true, estimated=estimated)
    sys.stdout.write(captured.get())
