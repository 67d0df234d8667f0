"""Options and arguments of ``rootmatch match`` and ``track``: types, help texts and panels; defaults are there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rootmatch.cli.noise import Noise as StatedNoise
from rootmatch.cli.problem_options import ProblemName, angle

if TYPE_CHECKING:
    from rootmatch.io import PointSet

INPUT, OUTPUT, METHOD = "Points and cameras", "Output", "Method"


def option_factory(panel: str) -> Callable[..., Any]:
    """`typer.Option` for a panel of the help: flags if any, the help, a metavar and the default in words."""

    def option(*flags_and_help: str, metavar: str | None = None, default: str | bool = True) -> Any:
        *flags, text = flags_and_help
        return typer.Option(
            *flags, help=text, metavar=metavar, show_default=default, rich_help_panel=panel, case_sensitive=False
        )

    return option


points, method, output = map(option_factory, (INPUT, METHOD, OUTPUT))


OF_MATCHER = (
    "detection_rate", "resolution", "min_probability", "sampler", "samples", "residual", "rho", "solver",
    "max_evaluations", "max_hyperedges", "max_seconds", "backend", "preset",
)  # fmt: skip
"""Options that go to `rootmatch.Matcher` as they are."""


def given_options(source: PointSet, noise: StatedNoise, given: Mapping[str, Any]) -> dict[str, Any]:
    """The options of `rootmatch.Matcher` that are given: ``view_angle`` in radians, and those of the model's file."""
    view_angle = given["view_angle"]
    options = {
        "view_angle": None if view_angle is None else angle("view_angle", view_angle, 180.0),
        "bodies": source.bodies,
        "source_noise": noise.source_argument,
        **{name: given.get(name) for name in OF_MATCHER},
    }
    return {name: value for name, value in options.items() if value is not None}


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
Problem = Annotated[
    ProblemName, points("What is known: p3p, up2p, 3p1, planar, up2pf, similarity or rigid.", metavar="PROBLEM")
]
Camera = Annotated[
    str | None,
    points(
        "p3p, up2p, 3p1, planar: FX,FY,CX,CY in pixels, or a calibration file (OpenCV, COLMAP, Kalibr, ROS, our JSON).",
        metavar="CAMERA",
    ),
]
Noise = Annotated[
    str | None,
    points(
        "Standard deviation of a coordinate, in pixels (similarity, rigid: in the points' unit), or auto. "
        "SOURCE,TARGET if both sets are noisy (3p1, planar, similarity, rigid).",
        metavar="SIGMA",
        default="1, or the columns sigma or sxx,sxy,syy",
    ),
]
SourceNoise = Annotated[
    float | None,
    points(
        "Standard deviation of a coordinate of the model's points, in their unit.",
        metavar="UNIT",
        default="0, or the columns sigma or sx,sy,sz",
    ),
]
VerticalCamera = Annotated[
    str | None,
    points(
        "With a known vertical: the direction 'down' in the camera frame (x right, y down, z forward).",
        metavar="X,Y,Z",
        default="that of the camera file",
    ),
]
VerticalWorld = Annotated[
    str | None,
    points(
        "With a known vertical: the direction 'down' in the model's frame.",
        metavar="X,Y,Z",
        default="that of the camera file",
    ),
]
VerticalNoise = Annotated[
    float | None,
    points(
        "up2p: standard deviation of the measured vertical, in degrees on each of two axes.", metavar="DEG", default="0"
    ),
]
Camera2 = Annotated[str | None, points("3p1, planar: the second camera.", metavar="CAMERA", default="as the first")]
Axis = Annotated[
    str | None,
    points("3p1, planar: the common direction in the first camera's frame.", metavar="X,Y,Z", default="none"),
]
Axis2 = Annotated[
    str | None,
    points(
        "3p1, planar: the same direction in the second camera's frame.", metavar="X,Y,Z", default="planar: as the first"
    ),
]
AxisNoise = Annotated[
    float | None,
    points(
        "3p1: standard deviation of the measured directions, in degrees on each of two axes.",
        metavar="DEG",
        default="0",
    ),
]
Centre = Annotated[str | None, points("up2pf: principal point in pixels.", metavar="CX,CY")]
Dimension = Annotated[
    int | None, points("similarity, rigid: dimension of the points.", metavar="2|3", default="3 with a column z")
]
Normals = Annotated[bool, points("Use the columns nx,ny,nz if the model has them.")]
ViewAngle = Annotated[
    float | None,
    points(
        "A point is visible up to about this angle from its normal, in degrees; visibility fades over a few degrees.",
        metavar="DEG",
        default="90",
    ),
]
MinProbability = Annotated[
    float | None, points("Posterior probability from which a match is trusted.", metavar="P", default="0.95")
]
Resolution = Annotated[
    float | None, points("Two points of a body whose images are nearer than this give one detection.", metavar="PX")
]
DetectionRate = Annotated[
    float | None, points("Probability that a visible point is detected.", metavar="P", default="estimated")
]
Prior = Annotated[
    Path | None,
    points(
        "p3p, up2p, rigid, similarity: predicted pose x_camera = R X + t with its covariance, as --poses writes "
        "it; with several bodies, by label.",
        metavar="JSON",
    ),
]
Known = Annotated[
    Path | None,
    points(
        "p3p, up2p, rigid, similarity: known rotation, position or vertical of each frame and body; σ of angles "
        "in degrees, of positions in the model's unit.",
        metavar="CSV",
    ),
]
Jobs = Annotated[int | None, method("Many frames: number of processes, -1 for all cores.", metavar="N", default="1")]
Resume = Annotated[
    bool, output("--resume", "Many frames: continue the files of an interrupted run; without it, they must not exist.")
]
Candidates = Annotated[
    Path | None, points("Possible source,target pairs, optionally with a prior weight.", metavar="CSV")
]
Motions = Annotated[str, method("Number of rigid motions to find.", metavar="K|auto")]
Preset = Annotated[Literal["paper"] | None, method("The method as published; other options override it.")]
Sampler = Annotated[
    str | None,
    method("Which hyper-edges to evaluate: auto, exhaustive, random, or guided.", metavar="WHICH", default="auto"),
]
Samples = Annotated[int | None, method("Number of random hyper-edges.", metavar="N", default="100000 if random")]
Residual = Annotated[
    str | None,
    method("joint or normalised (in units of the noise), svd, qr or qr-both.", metavar="KIND", default="joint"),
]
Rho = Annotated[
    float | None,
    method(
        "Spread ρ of the affinity, in units of the residual.",
        metavar="R",
        default="1 for joint and normalised, else per problem",
    ),
]
Solver = Annotated[
    str | None,
    method(
        "ascent, power-l1, power-dense and others; an unknown name lists them all.", metavar="NAME", default="ascent"
    ),
]
MaxEvaluations = Annotated[
    int | None,
    method(
        "Maximum number of hyper-edges that an exhaustive search may evaluate.",
        metavar="N",
        default="4e9, on a GPU 1e11",
    ),
]
MaxHyperedges = Annotated[
    int | None, method("Keep at most the N strongest hyper-edges in memory.", metavar="N", default="5000000")
]
MaxSeconds = Annotated[
    float | None,
    method("Stop each image or frame after S seconds, with the best match so far.", metavar="S", default="none"),
]
Backend = Annotated[
    str | None, method("Where to compute: auto, cpu, cuda or cuda-float32.", metavar="NAME", default="auto")
]
Scheduler = Annotated[
    str | None,
    method(
        "Evaluate on the workers of a Dask scheduler, tcp://HOST:PORT; many frames are matched there.",
        metavar="ADDRESS",
    ),
]
Seed = Annotated[int, method("Random seed; the same seed gives the same match.")]
Output = Annotated[Path | None, output("Write source, target, weight, motion, residual, confidence.", metavar="CSV")]
Poses = Annotated[Path | None, output("Write the pose of each motion with its covariance.", metavar="FILE")]
PoseFormat = Annotated[
    str | None, output("csv, json, ros, openxr or colmap (a folder).", metavar="FORMAT", default="by the suffix")
]
Photo = Annotated[Path | None, output("Photograph behind the image points of --plot and --report.", metavar="IMAGE")]
Plot = Annotated[Path | None, output("Draw the match: .png, .svg or .pdf.", metavar="PICTURE")]
Report = Annotated[Path | None, output("Write the match as a page for the browser: .html.", metavar="PAGE")]
Diagnose = Annotated[
    bool,
    output(
        "--diagnose",
        "If the points are not matched, try the usual mistakes, for up to 20 s; of many frames for the first one.",
    ),
]
AsJson = Annotated[bool, output("--json", "Print one JSON object instead of the table.")]
Truth = Annotated[
    Path | None, output("Ground truth source,target; each match is marked right or wrong.", metavar="CSV")
]
Progress = Annotated[bool | None, output("Show progress.", default="for long work in a terminal")]
