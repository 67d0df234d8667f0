"""Outputs of ``rootmatch match``: files, all of them or none, and a table or JSON on standard output."""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from rootmatch.cli.error_messages import rephrase_advice
from rootmatch.cli.problem_options import flag
from rootmatch.cli.surroundings import render_text
from rootmatch.errors import InputError

if TYPE_CHECKING:
    from rootmatch.explain.diagnosis import Diagnosis
    from rootmatch.io import PointSet
    from rootmatch.result import Match


@dataclass(frozen=True)
class Outputs:
    """The files that were asked for, and the photograph behind the picture."""

    output: Path | None
    poses: Path | None
    pose_format: str | None
    plot: Path | None
    report: Path | None
    photo: Path | None

    @property
    def paths(self) -> dict[str, Path]:
        """The files to write, by option."""
        names = ("output", "plot", "report") if self.pose_format == "colmap" else ("output", "poses", "plot", "report")
        return {name: path for name in names if (path := getattr(self, name)) is not None}

    @property
    def printed(self) -> bool:
        """Whether one of them is standard output, which then holds nothing else."""
        from rootmatch.io import is_standard_output

        return any(map(is_standard_output, self.paths.values()))

    def check(self, problem: str, inputs: list[Path], as_json: bool) -> None:
        """Refuse before any work what could not be written.

        Raises `InputError` for a file that is an input or named twice, in a folder that does not exist, of an unknown
        format; for poses of a problem that fits none.
        """
        from rootmatch.io import check_output, check_output_folder, pose_format
        from rootmatch.problems import problem_class
        from rootmatch.problems.capabilities import Capability

        taken = list(inputs)
        for name, path in self.paths.items():
            check_output(path, flag(name), taken)
            taken.append(path)
        if as_json and self.printed:
            raise InputError("--json: another output goes to standard output too; give that one a file")
        if self.poses is not None:
            Capability.POSE.require(problem_class(problem).min_for_pose, problem)
            if pose_format(self.poses, self.pose_format) == "colmap":
                check_output_folder(self.poses, force=True)
        elif self.pose_format is not None:
            raise InputError("--pose-format: without --poses there is nothing to write; give --poses FILE")
        if self.photo is not None and self.plot is None and self.report is None:
            raise InputError(
                "--photo: it is drawn behind the points of --plot or --report; give --plot PICTURE or --report PAGE"
            )
        if self.report is not None:
            from rootmatch.report.html import check_report

            check_report(self.report)
        if self.plot is not None:
            from rootmatch.report.pictures import check_picture

            check_picture(self.plot)
        if self.photo is not None:
            from rootmatch.report.pictures import read_photo

            read_photo(self.photo)

    def write(self, found: Match, source: PointSet, target: PointSet, true: Any) -> None:
        """Write the files: all of them or none."""
        from rootmatch import io
        from rootmatch.report import text

        with ExitStack() as moves:
            places = {name: moves.enter_context(io.write_atomically(path)) for name, path in self.paths.items()}
            if "output" in places:
                io.write_matches(
                    path=places["output"],
                    assignment=found.assignment,
                    weights=text.match_weights(found),
                    motions=found.motion_labels,
                    confidence=found.confidence,
                    residuals=text.match_residuals(found),
                    source=source,
                    target=target,
                )
            if "poses" in places and self.poses is not None:
                io.write_poses(places["poses"], found.poses, io.pose_format(self.poses, self.pose_format))
            if "plot" in places:
                from rootmatch.report import pictures

                figure = pictures.match_figure(
                    source.points,
                    target.points,
                    found.assignment,
                    motions=found.motion_labels,
                    motion_names=None if found.bodies is None else [f"body {label}" for label in found.bodies],
                    truth=true,
                    poses=found.poses if found.problem.min_for_pose else None,
                    camera=getattr(found.problem, "camera", None) if found.problem.source_dimension == 3 else None,
                    photo=self.photo,
                    source_names=source.names,
                    target_names=target.names,
                    title=f"{text.summarise_match(found)} ({found.status.name.lower()})",
                )
                pictures.save_figure(figure, places["plot"])
            if "report" in places:
                found.report(
                    places["report"],
                    source_names=source.names,
                    target_names=target.names,
                    truth=true,
                    photo=self.photo,
                    title=f"{self.report.stem if self.report else ''}: {len(source.points)} points",
                )
            if self.poses is not None and self.pose_format == "colmap" and found.pose is not None:
                self._write_model(self.poses, found, source)

    def _write_model(self, folder: Path, found: Match, source: PointSet) -> None:
        """Write COLMAP's model: the ids of the points where all of them are numbers, else their rows from 1."""
        from rootmatch.report.colmap import write_colmap

        ids = source.ids or ("",)
        known = [int(one) for one in ids] if all(one.isdecimal() and len(one) < 19 for one in ids) else None
        name = "image.jpg" if self.photo is None else self.photo.name.replace(" ", "_")
        write_colmap(folder, {name: found}, ids=known)


def print_match(
    found: Match,
    source: PointSet,
    target: PointSet,
    true: Any,
    as_json: bool,
    estimated: bool,
    file: TextIO,
    diagnosis: Diagnosis | None = None,
) -> None:
    """Print the match: a table, or one JSON object; the advice is in the table, else on standard error."""
    from rootmatch.report import text

    advice = rephrase_advice(found.advice)
    if as_json:
        from rootmatch.report.json_record import diagnosis_record, match_record

        record = rephrase_record(match_record(found))
        if diagnosis is not None:
            record["diagnosis"] = diagnosis_record(diagnosis)
        print(json.dumps(record, allow_nan=False))
        print(f"rootmatch: {advice}", file=sys.stderr)
    else:
        names: dict[str, Any] = {"source_names": source.names, "target_names": target.names, "advice": advice}
        file.write(
            render_text(lambda console: text.print_match(found, console, **names, truth=true, estimated=estimated))
        )
    if diagnosis is not None:
        print(rephrase_advice(str(diagnosis)), file=sys.stderr)


def rephrase_record(record: dict[str, Any]) -> dict[str, Any]:
    """A record of a match with the advice about each body in terms of the command line."""
    for body in record.get("bodies", {}).values():
        body["advice"] = rephrase_advice(body["advice"])
    return record
