"""The command ``rootmatch simulate``: a scene of the paper as the files that ``rootmatch match`` reads."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rootmatch.cli.error_messages import rename_to_options
from rootmatch.errors import InputError

if TYPE_CHECKING:
    from rootmatch.simulation import Scene


FILES = ("model.csv", "image.csv", "truth.csv", "camera.json")
NOISE_OF_EXACT_SCENES = 0.1
"""Noise in pixels of the printed command for a noise-free scene: with 0, residuals would measure rounding errors."""


def simulate(
    problem: Annotated[
        Literal["p3p", "up2p", "3p1"],
        typer.Argument(help="The problem whose scene is simulated.", case_sensitive=False),
    ],
    output: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write.")],
    points: Annotated[int, typer.Option(metavar="N", help="Source points with an image.")] = 10,
    outliers: Annotated[int, typer.Option(metavar="N", help="Image points without a source point.")] = 0,
    hidden: Annotated[int, typer.Option(metavar="N", help="Additional source points without an image.")] = 0,
    noise: Annotated[float, typer.Option(metavar="PX", help="Standard deviation of a pixel coordinate.")] = 0.0,
    motions: Annotated[
        int | None, typer.Option(metavar="K", help="p3p, up2p: number of rigid motions.", show_default="1")
    ] = None,
    baseline: Annotated[
        float | None,
        typer.Option(metavar="B", help="3p1: distance between the cameras; the cube is 4 wide.", show_default="1"),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="FX,FY,CX,CY|FILE",
            help="A camera other than the paper's, with or without a lens.",
            show_default="1000,1000,320,240",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="The same seed gives the same files.")] = 0,
    force: Annotated[bool, typer.Option("--force", help="Replace the files of a folder that is not empty.")] = False,
) -> None:
    """Write model.csv, image.csv, truth.csv and camera.json of a simulated scene.

    The command that matches them is printed. Exit code 0: written; 2: bad input, nothing is written.
    """
    from rootmatch.io import check_output, check_output_folder, parse_camera, path_of_camera_text

    check_output_folder(output, force)
    options: dict[str, Any] = {"outliers": outliers, "noise": noise, "seed": seed, "hidden": hidden}
    if camera is not None:
        options["camera"] = parse_camera(camera, "--camera").camera
        file = path_of_camera_text(camera)
        if file is not None and output.is_dir():
            for name in FILES:
                check_output(output / name, "--output", [file])
    own = {"motions": motions, "baseline": baseline}
    allowed = "baseline" if problem == "3p1" else "motions"
    for name, value in own.items():
        if value is not None:
            if name != allowed:
                raise InputError(f"--{name}: a scene of {problem} has no such option; leave it out")
            options[name] = value
    with rename_to_options({"n": "--points", **{name: f"--{name}" for name in (*options, *own)}}):
        from rootmatch.simulation import SCENES

        scene = SCENES[problem](points, **options)
    _write(scene, output, force)
    typer.echo(f"{output}: {len(scene.source)} source points, {len(scene.target)} target points")
    folder = str(output)
    match = ["rootmatch", "match", f"{folder}/model.csv", f"{folder}/image.csv", "--problem", problem]
    match += ["--camera", f"{folder}/camera.json", "--noise", f"{noise or NOISE_OF_EXACT_SCENES:g}"]
    match += ["--truth", f"{folder}/truth.csv"]
    match += ["--motions", str(motions)] if motions and motions > 1 else []
    typer.echo(shlex.join(match))


def _write(scene: Scene, output: Path, force: bool) -> None:
    """Write the four files of a scene, all of them or none."""
    from rootmatch import io
    from rootmatch.io.calibrations.native import DIRECTIONS

    settings = {name: getattr(scene.problem, name, None) for name in ("camera2", *DIRECTIONS)}
    with io.write_folder_atomically(output, force) as folder:
        io.write_points(folder / "model.csv", io.PointSet(scene.source))
        io.write_points(folder / "image.csv", io.PointSet(scene.target))
        visible = [(i, j, k) for i, (j, k) in enumerate(zip(scene.truth, scene.motions, strict=True)) if j >= 0]
        io.write_table(folder / "truth.csv", ("source", "target", "motion"), visible)
        io.write_camera(folder / "camera.json", io.Calibration(scene.cameras[0], **settings))
