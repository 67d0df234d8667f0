"""Options and arguments of ``rootmatch match``: types, help texts and panels; defaults are in `match`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from rootmatch.cli.problem_options import ProblemName

INPUT, OUTPUT, METHOD = "Points and cameras", "Output", "Method"


class PresetName(StrEnum):
    """Named sets of options."""

    PAPER = "paper"


Model = Annotated[
    Path,
    typer.Argument(
        metavar="MODEL.csv", help="Points x,y,z in space; for 3p1 and planar, pixels x,y of the first image."
    ),
]
Image = Annotated[
    Path,
    typer.Argument(metavar="IMAGE.csv", help="Points x,y of the (second) image, in pixels; frame,x,y for many images."),
]
Problem = Annotated[ProblemName, typer.Option(help="What is known about cameras and points.", rich_help_panel=INPUT)]
Camera = Annotated[
    str | None,
    typer.Option(
        metavar="FX,FY,CX,CY|FILE",
        help="p3p, up2p, 3p1, planar: camera in pixels, or a calibration file (OpenCV, COLMAP, Kalibr, ROS, our JSON).",
        rich_help_panel=INPUT,
    ),
]
Noise = Annotated[
    str | None,
    typer.Option(
        metavar="PX|SOURCE,TARGET|auto",
        help="Standard deviation of a coordinate, in pixels (similarity, rigid: in the points' unit), or auto. Two "
        "numbers if both sets are noisy (3p1, planar, similarity, rigid).",
        show_default="1, or the columns sigma",
        rich_help_panel=INPUT,
    ),
]
SourceNoise = Annotated[
    float | None,
    typer.Option(
        metavar="UNIT",
        help="Standard deviation of a coordinate of the model's points, in their unit.",
        show_default="0, or the columns sigma or sx,sy,sz",
        rich_help_panel=INPUT,
    ),
]
VerticalCamera = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z",
        help="up2p, up2pf: the direction 'down' in the camera frame (x right, y down, z forward).",
        show_default="that of the camera file",
        rich_help_panel=INPUT,
    ),
]
VerticalWorld = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z",
        help="up2p, up2pf: the direction 'down' in the model's frame.",
        show_default="that of the camera file",
        rich_help_panel=INPUT,
    ),
]
VerticalNoise = Annotated[
    float | None,
    typer.Option(
        metavar="DEG",
        help="up2p: standard deviation of the measured vertical, in degrees on each of two axes.",
        show_default="0",
        rich_help_panel=INPUT,
    ),
]
Camera2 = Annotated[
    str | None,
    typer.Option(
        metavar="FX,FY,CX,CY|FILE",
        help="3p1, planar: the second camera.",
        show_default="as the first",
        rich_help_panel=INPUT,
    ),
]
Axis = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z",
        help="3p1, planar: the common direction in the first camera's frame.",
        show_default="none",
        rich_help_panel=INPUT,
    ),
]
Axis2 = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z",
        help="3p1, planar: the same direction in the second camera's frame.",
        show_default="planar: as the first",
        rich_help_panel=INPUT,
    ),
]
AxisNoise = Annotated[
    float | None,
    typer.Option(
        metavar="DEG",
        help="3p1: standard deviation of the measured directions, in degrees on each of two axes.",
        show_default="0",
        rich_help_panel=INPUT,
    ),
]
Centre = Annotated[
    str | None, typer.Option(metavar="CX,CY", help="up2pf: principal point in pixels.", rich_help_panel=INPUT)
]
Dimension = Annotated[
    int | None,
    typer.Option(
        metavar="2|3",
        help="similarity, rigid: dimension of the points.",
        show_default="3 with a column z",
        rich_help_panel=INPUT,
    ),
]
Normals = Annotated[bool, typer.Option(help="Use the columns nx,ny,nz if the model has them.", rich_help_panel=INPUT)]
ViewAngle = Annotated[
    float | None,
    typer.Option(
        metavar="DEG",
        help="A point is visible up to this angle from its normal, in degrees.",
        show_default="90",
        rich_help_panel=INPUT,
    ),
]
MinProbability = Annotated[
    float | None,
    typer.Option(
        metavar="P",
        help="Lowest posterior probability of a match that is trusted.",
        show_default="0.95",
        rich_help_panel=INPUT,
    ),
]
Resolution = Annotated[
    float | None,
    typer.Option(metavar="PX", help="Two points of a body nearer than this are one detection.", rich_help_panel=INPUT),
]
DetectionRate = Annotated[
    float | None,
    typer.Option(
        metavar="P",
        help="Probability that a visible point is detected.",
        show_default="estimated",
        rich_help_panel=INPUT,
    ),
]
Prior = Annotated[
    Path | None,
    typer.Option(
        metavar="JSON",
        help="p3p, up2p, rigid, similarity: predicted pose x_camera = R X + t with its covariance, as --poses writes "
        "it; with several bodies, by label.",
        rich_help_panel=INPUT,
    ),
]
Known = Annotated[
    Path | None,
    typer.Option(
        metavar="CSV",
        help="p3p, up2p, rigid, similarity: rotation, position or vertical that is known, of each frame and body.",
        rich_help_panel=INPUT,
    ),
]
Jobs = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="Many frames: number of processes, -1 for all cores.",
        show_default="1",
        rich_help_panel=METHOD,
    ),
]
Resume = Annotated[
    bool,
    typer.Option("--resume", help="Many frames: continue the files of an interrupted run.", rich_help_panel=OUTPUT),
]
Candidates = Annotated[
    Path | None,
    typer.Option(
        metavar="CSV",
        help="Possible source,target pairs, optionally with a prior weight.",
        rich_help_panel=INPUT,
    ),
]
Motions = Annotated[
    str,
    typer.Option(metavar="K|auto", help="Number of rigid motions to find.", rich_help_panel=METHOD),
]
Preset = Annotated[
    PresetName | None,
    typer.Option(help="The method as published; other options override it.", rich_help_panel=METHOD),
]
Sampler = Annotated[
    str | None,
    typer.Option(
        metavar="WHICH",
        help="Which hyper-edges to evaluate: auto, exhaustive, random, or guided.",
        show_default="auto",
        rich_help_panel=METHOD,
    ),
]
Samples = Annotated[
    int | None,
    typer.Option(
        metavar="N", help="Number of random hyper-edges.", show_default="100000 if random", rich_help_panel=METHOD
    ),
]
Residual = Annotated[
    str | None,
    typer.Option(
        metavar="KIND",
        help="joint or normalised (in units of the noise), svd, qr or qr-both.",
        show_default="joint",
        rich_help_panel=METHOD,
    ),
]
Rho = Annotated[
    float | None,
    typer.Option(
        metavar="R",
        help="Spread ρ of the affinity, in units of the residual.",
        show_default="1 for joint and normalised, else per problem",
        rich_help_panel=METHOD,
    ),
]
Solver = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="ascent, power-l1, power-dense and others; an unknown name lists them all.",
        show_default="ascent",
        rich_help_panel=METHOD,
    ),
]
MaxEvaluations = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="Maximum number of hyper-edges that an exhaustive search may evaluate.",
        show_default="4e9, on a GPU 1e11",
        rich_help_panel=METHOD,
    ),
]
MaxHyperedges = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="Keep at most the N strongest hyper-edges in memory.",
        show_default="5000000",
        rich_help_panel=METHOD,
    ),
]
MaxSeconds = Annotated[
    float | None,
    typer.Option(
        metavar="S",
        help="Stop after S seconds and return the best match so far.",
        show_default="none",
        rich_help_panel=METHOD,
    ),
]
Backend = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Where to compute: auto, cpu, cuda or cuda-float32.",
        show_default="auto",
        rich_help_panel=METHOD,
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Evaluate on the workers of a Dask scheduler, tcp://HOST:PORT; many frames are matched there.",
        rich_help_panel=METHOD,
    ),
]
Seed = Annotated[int, typer.Option(help="Random seed; the same seed gives the same match.", rich_help_panel=METHOD)]
Output = Annotated[
    Path | None,
    typer.Option(metavar="CSV", help="Write source,target,weight,motion,residual,confidence.", rich_help_panel=OUTPUT),
]
Poses = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Write the pose of each motion with its covariance.", rich_help_panel=OUTPUT),
]
PoseFormat = Annotated[
    str | None,
    typer.Option(
        metavar="csv|json|tum|ros|openxr|colmap",
        help="Format of --poses; colmap writes a folder.",
        show_default="by the suffix",
        rich_help_panel=OUTPUT,
    ),
]
Photo = Annotated[
    Path | None,
    typer.Option(
        metavar="IMAGE", help="Photograph behind the image points of --plot and --report.", rich_help_panel=OUTPUT
    ),
]
Plot = Annotated[
    Path | None, typer.Option(metavar="PICTURE", help="Draw the match: .png, .svg or .pdf.", rich_help_panel=OUTPUT)
]
Report = Annotated[
    Path | None,
    typer.Option(metavar="PAGE", help="Write the match as a page for the browser: .html.", rich_help_panel=OUTPUT),
]
Diagnose = Annotated[
    bool,
    typer.Option(
        "--diagnose",
        help="If the points are not matched, try the usual mistakes, for up to 20 s.",
        rich_help_panel=OUTPUT,
    ),
]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object instead of the table.", rich_help_panel=OUTPUT)
]
Truth = Annotated[
    Path | None,
    typer.Option(
        metavar="CSV", help="Ground truth source,target; each match is marked right or wrong.", rich_help_panel=OUTPUT
    ),
]
Progress = Annotated[
    bool | None,
    typer.Option(help="Show progress.", show_default="for long work in a terminal", rich_help_panel=OUTPUT),
]
