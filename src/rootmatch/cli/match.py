"""The command ``rootmatch match``: two files of points in, their matches out."""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rootmatch.cli.cold import compiled_beside
from rootmatch.cli.error_messages import option_names_in_errors
from rootmatch.cli.exit_codes import NOT_TRUSTED
from rootmatch.cli.problem_options import ProblemName, build_problem, flag
from rootmatch.cli.progress import progress_bar
from rootmatch.errors import InputError

if TYPE_CHECKING:
    from rootmatch.io import PointSet
    from rootmatch.match import Match


class Preset(StrEnum):
    """Named sets of options."""

    PAPER = "paper"


INPUT, OUTPUT, METHOD = "Points and cameras", "Output", "Method"


def match(
    model: Annotated[
        Path,
        typer.Argument(metavar="MODEL.csv", help="Points x,y,z in space; for 3p1 and planar x,y of the first image."),
    ],
    image: Annotated[Path, typer.Argument(metavar="IMAGE.csv", help="Points x,y of the (second) image, in pixels.")],
    problem: Annotated[ProblemName, typer.Option(help="Which minimal problem.", rich_help_panel=INPUT)],
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="FX,FY,CX,CY",
            help="p3p, up2p, 3p1, planar: camera in pixels, or a camera file (JSON).",
            rich_help_panel=INPUT,
        ),
    ] = None,
    noise: Annotated[
        str,
        typer.Option(
            metavar="PX|auto",
            help="Standard deviation of a pixel coordinate, or auto to estimate it.",
            rich_help_panel=INPUT,
        ),
    ] = "1",
    vertical_camera: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z", help="up2p, up2pf: down in the camera frame.", show_default="0,1,0", rich_help_panel=INPUT
        ),
    ] = None,
    vertical_world: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z", help="up2p, up2pf: down in the model's frame.", show_default="0,1,0", rich_help_panel=INPUT
        ),
    ] = None,
    vertical_noise: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            help="up2p: standard deviation of the measured vertical.",
            show_default="0",
            rich_help_panel=INPUT,
        ),
    ] = None,
    camera2: Annotated[
        str | None,
        typer.Option(
            metavar="FX,FY,CX,CY",
            help="3p1, planar: the second camera.",
            show_default="as the first",
            rich_help_panel=INPUT,
        ),
    ] = None,
    axis: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="3p1, planar: the common direction in the first camera.",
            show_default="0,1,0",
            rich_help_panel=INPUT,
        ),
    ] = None,
    axis2: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="3p1, planar: the same direction in the second camera.",
            show_default="0,1,0",
            rich_help_panel=INPUT,
        ),
    ] = None,
    axis_noise: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            help="3p1: standard deviation of the measured directions.",
            show_default="0",
            rich_help_panel=INPUT,
        ),
    ] = None,
    centre: Annotated[
        str | None, typer.Option(metavar="CX,CY", help="up2pf: principal point in pixels.", rich_help_panel=INPUT)
    ] = None,
    dimension: Annotated[
        int | None,
        typer.Option(
            metavar="2|3", help="similarity, rigid: dimension of the points.", show_default="2", rich_help_panel=INPUT
        ),
    ] = None,
    normals: Annotated[
        bool, typer.Option(help="Use the columns nx,ny,nz where the model has them.", rich_help_panel=INPUT)
    ] = True,
    candidates: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV",
            help="The possible source,target pairs, optionally with a prior weight.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    motions: Annotated[
        str,
        typer.Option(metavar="K|auto", help="Number of rigid motions to find.", rich_help_panel=METHOD),
    ] = "1",
    preset: Annotated[
        Preset | None,
        typer.Option(help="The method as published; other options override it.", rich_help_panel=METHOD),
    ] = None,
    hyperedges: Annotated[
        str | None,
        typer.Option(
            metavar="WHICH",
            help="Which to evaluate: auto, exhaustive, random, or (p3p, up2p) guided.",
            show_default="auto",
            rich_help_panel=METHOD,
        ),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Number of random hyper-edges.", show_default="100000 if random", rich_help_panel=METHOD
        ),
    ] = None,
    residual: Annotated[
        str | None,
        typer.Option(
            metavar="KIND", help="joint, normalised, svd, qr or qr-both.", show_default="joint", rich_help_panel=METHOD
        ),
    ] = None,
    rho: Annotated[
        float | None,
        typer.Option(
            metavar="R",
            help="Spread of the affinity, in units of the residual.",
            show_default="1 for joint and normalised, else per problem",
            rich_help_panel=METHOD,
        ),
    ] = None,
    solver: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="ascent, power-l1, power-dense and others.",
            show_default="ascent",
            rich_help_panel=METHOD,
        ),
    ] = None,
    limit: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Most hyper-edges that an exhaustive search may evaluate.",
            show_default="4e9, on a card 1e11",
            rich_help_panel=METHOD,
        ),
    ] = None,
    max_hyperedges: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Keep at most the N strongest hyper-edges in memory.",
            show_default="5000000",
            rich_help_panel=METHOD,
        ),
    ] = None,
    backend: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Where to compute: auto, cpu, cuda or cuda-float32.",
            show_default="auto",
            rich_help_panel=METHOD,
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Evaluate on the workers of a Dask scheduler, tcp://HOST:PORT.",
            rich_help_panel=METHOD,
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(help="Random seed; the same seed gives the same match.", rich_help_panel=METHOD)
    ] = 0,
    output: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Write source,target,weight,motion.", rich_help_panel=OUTPUT)
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="PICTURE", help="Draw the match: .png, .svg or .pdf.", rich_help_panel=OUTPUT)
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object instead of the table.", rich_help_panel=OUTPUT)
    ] = False,
    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV", help="Ground truth source,target to compare the matches with.", rich_help_panel=OUTPUT
        ),
    ] = None,
    progress: Annotated[
        bool | None,
        typer.Option(help="Show progress.", show_default="for long work in a terminal", rich_help_panel=OUTPUT),
    ] = None,
) -> None:
    """Match points to image detections by geometry alone.

    Image x points right and y down, lens distortion removed; the camera looks along z.

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
        "hyperedges": hyperedges,
        "samples": samples,
        "residual": residual,
        "rho": rho,
        "solver": solver,
        "limit": limit,
        "max_hyperedges": max_hyperedges,
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
    _write(found, source, target, true, output, plot)
    _print(found, source, target, true, as_json, noise == "auto")
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
        raise InputError(f"motions: {text!r} given; give a whole number of at least 1, or auto") from None


def _noise(text: str) -> Any:
    """A number of pixels, or "auto"."""
    if text == "auto":
        return text
    try:
        return float(text)
    except ValueError:
        raise InputError(f"noise: {text!r} given; give a number of pixels, or auto") from None


def _write(found: Match, source: PointSet, target: PointSet, true: Any, output: Path | None, plot: Path | None) -> None:
    """Write the requested files: all of them or none."""
    from rootmatch import io
    from rootmatch.report import text

    with ExitStack() as moves:
        places = {path: moves.enter_context(io.written_whole(path)) for path in (output, plot) if path is not None}
        if output is not None:
            weights = text.match_weights(found)
            io.write_matches(places[output], found.assignment, weights, found.motions, source, target)
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
        print(json.dumps(text.match_record(found), allow_nan=False))
        print(f"rootmatch: {found.advice}", file=sys.stderr)
        return
    from rich.console import Console

    names = {"source_names": source.names, "target_names": target.names}
    text.print_match(found, Console(), **names, truth=true, estimated=estimated)
