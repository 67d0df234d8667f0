"""Record what matching returns on fixed scenes and compare two recordings, to check that a refactoring loses nothing.

    python benchmarks/record.py record before.record     # with the old revision on PYTHONPATH
    python benchmarks/record.py record after.record      # with the new one
    python benchmarks/record.py compare before.record after.record
    python benchmarks/record.py compare before.record after.record --tier same-answer

The cases are those of `record_cases.py`: every problem and every feature of the public interface, on scenes made from
NumPy alone. ``--quick`` records the first of each family.

Tiers:

* ``same-bits``: every field equal, to the last bit.
* ``same-answer``: assignments, statuses, labels of motions, sightings, `prior_holds` and the states of trackers equal;
  probability, confidence and estimated noise to 1e-6; poses to 1e-9 of their standard deviation and covariances to
  1e-6 of theirs, on top of rounding. Counts, scores, margins, alternatives and tensors may differ.

``--expected FILE`` names what changes on purpose, a line each: ``case glob | field glob | reason``. Such differences
are counted under their reason. Every other one is printed with its case and its field; the exit status is 1 when there
is one, or when a case is in one recording only.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from record_cases import Frame, cases

import rootmatch as rm

ABSENT = "absent"
TIERS = ("same-bits", "same-answer")
CLOSE = 1e-6
"""Difference of a probability or a confidence, and of a covariance over its standard deviations."""
DEVIATIONS = 1e-9
"""Difference of a pose over its standard deviation."""
ROUNDING = 1e-13
"""Rounding of a pose, over the size of its translation or over 1: exact data have next to no standard deviation."""
SHOWN = 3
"""Values of one difference that are printed."""

Entry = dict[str, Any]


def digest(*arrays: ArrayLike) -> str:
    """A few letters that stand for the bits of arrays."""
    found = hashlib.sha256()
    for one in arrays:
        array = np.ascontiguousarray(one)
        found.update(f"{array.dtype.str} {array.shape}".encode() + array.tobytes())
    return found.hexdigest()[:16]


def plain(value: Any) -> Any:
    """A value as JSON holds it."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, tuple | list):
        return [plain(one) for one in value]
    return value


def attempt(make: Callable[[], Any]) -> Any:
    """What a function returns, or the name of the package's error that it raises."""
    try:
        return make()
    except rm.RootmatchError as error:
        return f"raises {type(error).__name__}"


def described_pose(pose: Any) -> Any:
    """The parts of a pose that are compared."""
    if not isinstance(pose, rm.Pose):
        return pose
    names = ("R", "t", "covariance", "scale", "focal", "chi2", "dof", "points")
    return {name: plain(getattr(pose, name)) for name in names}


def described(match: rm.Match) -> Entry:
    """The parts of a match that are compared, by their names; those of a body by its label and their names."""
    poses = attempt(lambda: match.poses)
    tensor = match.tensor
    found = {
        "points": digest(match.source, match.target),
        "assignment": plain(match.assignment),
        "status": match.status.name,
        "motion_labels": plain(match.motion_labels),
        "probability": plain(attempt(lambda: match.probability)),
        "confidence": plain(attempt(lambda: match.confidence)),
        "poses": [described_pose(pose) for pose in poses] if isinstance(poses, list) else poses,
        "fused_pose": described_pose(match.fused_pose),
        "prior_holds": plain(match.prior_holds),
        "evaluated": plain(match.evaluated),
        "score": plain(match.score),
        "margin": plain(match.margin),
        "alternatives": [[plain(other), plain(score)] for other, score in match.alternatives],
        "noise": plain(match.noise),
        "noise_factor": plain(match.noise_factor),
        "converged": plain(match.converged),
        "stopped_early": plain(match.stopped_early),
        "tensor": [len(tensor.weights), digest(tensor.indices, tensor.weights)],
        "soft_assignment": digest(match.soft_assignment),
        "log_odds": plain(attempt(lambda: match.log_odds)),
    }
    sightings = match.sightings
    if sightings is not None:
        found["sightings"] = plain(sightings.assignment)
        found["sightings_alternatives"] = [plain(other) for other in sightings.alternatives]
    for label, body in (match.bodies or {}).items():
        found |= {f"bodies[{label}].{name}": value for name, value in described(body).items()}
    return found


def record(path: Path, quick: bool, only: str) -> None:
    """Write the result of every case, a line each."""
    started, families, count = time.process_time(), set(), 0
    statuses: Counter[str] = Counter()
    slow: list[tuple[float, str]] = []
    temporary = path.with_suffix(".partial")
    with temporary.open("w", buffering=1) as file:  # it shows how far a recording is
        for name, make in cases():
            family = name.rpartition("-")[0]
            if not fnmatchcase(name, only) or (quick and family in families):
                continue
            families.add(family)
            before = time.process_time()
            made = attempt(make)
            frames = made if isinstance(made, list) else [Frame(-1, made)]
            for frame in frames:
                raised = isinstance(frame.match, str)
                entry = {"error": frame.match} if raised else {**described(frame.match), "states": frame.states}
                shown = name if frame.number < 0 else f"{name}/{frame.number:02}"
                file.write(json.dumps({"case": shown, **entry}) + "\n")
                statuses[str(entry.get("status", "error"))] += 1
                count += 1
            slow.append((time.process_time() - before, name))
    temporary.replace(path)
    print(f"{count} matches of {len(slow)} cases in {time.process_time() - started:.0f} s of processor time: {path}")
    print(dict(statuses))
    print("longest:", ", ".join(f"{name} {seconds:.1f} s" for seconds, name in sorted(slow, reverse=True)[:8]))


def same(old: Any, new: Any) -> bool:
    """Whether two recorded values are equal, NaN to NaN."""
    if isinstance(old, list) and isinstance(new, list):
        return len(old) == len(new) and all(same(a, b) for a, b in zip(old, new, strict=True))
    if isinstance(old, dict) and isinstance(new, dict):
        return old.keys() == new.keys() and all(same(old[name], new[name]) for name in old)
    if isinstance(old, float) and isinstance(new, float) and math.isnan(old):
        return math.isnan(new)
    return type(old) is type(new) and bool(old == new)


def numbers(value: Any) -> NDArray[np.float64] | None:
    """A recorded number or array; None for anything else."""
    try:
        return np.array(value, np.float64)
    except (TypeError, ValueError):
        return None


def close(old: Any, new: Any) -> bool:
    """Whether two numbers or arrays are equal to `CLOSE`, NaN to NaN."""
    if old is None or new is None or isinstance(old, str) or isinstance(new, str):
        return same(old, new)
    a, b = numbers(old), numbers(new)
    return a is not None and b is not None and a.shape == b.shape and bool(
        np.allclose(a, b, rtol=0.0, atol=CLOSE, equal_nan=True)
    )  # fmt: skip


def vector(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """A small rotation as a vector, or as one angle in a plane."""
    skew = 0.5 * (rotation - rotation.T)
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]] if len(rotation) == 3 else [skew[1, 0]])


def deviation(old: Entry, new: Entry) -> float:
    """By how many times what is allowed two poses differ: their parameters, then their covariances."""
    R, t, R2, t2 = (np.array(one) for one in (old["R"], old["t"], new["R"], new["t"]))
    if R.shape != R2.shape or (old["covariance"] is None) != (new["covariance"] is None):
        return math.inf
    error = np.concatenate([vector(R2 @ R.T), t2 - t])
    size = max(1.0, float(np.abs(t).max()))
    if old["covariance"] is None:
        return float(np.abs(error).max() / (ROUNDING * size))
    covariance, other = np.array(old["covariance"]), np.array(new["covariance"])
    if covariance.shape != other.shape:
        return math.inf
    if len(covariance) > len(error):
        scaled = old["focal"] is None
        a, b = (old["scale"], new["scale"]) if scaled else (old["focal"], new["focal"])
        error, size = np.append(error, b - a), max(size, abs(a))
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.outer(spread, spread)
    far = np.abs(error) / (DEVIATIONS * spread + ROUNDING * size)
    apart = np.abs(other - covariance) / np.where(unit > 0.0, CLOSE * unit, ROUNDING)
    return float(max(far.max(), apart.max()))


def same_pose(old: Any, new: Any) -> bool:
    """Whether two poses are equal in the second tier."""
    if not isinstance(old, dict) or not isinstance(new, dict):
        return same(old, new)
    return all(same(old[name], new[name]) for name in ("dof", "points")) and deviation(old, new) <= 1.0


def same_poses(old: Any, new: Any) -> bool:
    """Whether two lists of poses are."""
    if not isinstance(old, list) or not isinstance(new, list):
        return same(old, new)
    return len(old) == len(new) and all(same_pose(a, b) for a, b in zip(old, new, strict=True))


SAME_ANSWER: dict[str, Callable[[Any, Any], bool]] = {
    **dict.fromkeys(
        ("points", "assignment", "status", "motion_labels", "prior_holds", "sightings", "states", "error"), same
    ),
    **dict.fromkeys(("probability", "confidence", "noise", "log_odds"), close),
    "poses": same_poses,
    "fused_pose": same_pose,
}
"""How the fields of the second tier are compared; the others may differ."""


@dataclass
class Expected:
    """A difference that is on purpose."""

    case: str
    field: str
    reason: str
    met: int = 0

    @classmethod
    def read(cls, path: Path | None) -> list[Expected]:
        """Those of a file."""
        lines = [] if path is None else path.read_text().splitlines()
        rows = [line.split("|") for line in lines if line.strip() and not line.startswith("#")]
        for row in rows:
            if len(row) != 3:
                raise SystemExit(f"{path}: {'|'.join(row)!r}; give: case glob | field glob | reason")
        return [cls(*(part.strip() for part in row)) for row in rows]


def difference(field: str, old: Any, new: Any) -> str:
    """What is printed of one difference."""
    if field.rpartition(".")[2] in ("poses", "fused_pose"):
        pairs = [(old, new)] if isinstance(old, dict) else list(zip(old or [], new or [], strict=False))
        both = [(a, b) for a, b in pairs if isinstance(a, dict) and isinstance(b, dict)]
        if both:
            return f"{max(deviation(a, b) for a, b in both):.3g} times what same-answer allows"
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        places = [k for k in range(len(old)) if not same(old[k], new[k])]
        listed = [f"[{k}] {short(old[k])} -> {short(new[k])}" for k in places[:SHOWN]]
        return f"{len(places)} of {len(old)}: " + ", ".join(listed)
    return f"{short(old)} -> {short(new)}"


def short(value: Any) -> str:
    """A value in a few letters."""
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


def compare(before: Path, after: Path, tier: str, expected: list[Expected]) -> int:
    """Print the differences; returns 1 if there are any."""
    old, new = entries(before), entries(after)
    missing = sorted(set(old) ^ set(new))
    for name in missing:
        print(f"{name}: in {before if name in old else after} only")
    fields: Counter[str] = Counter()
    different, cases_changed = 0, 0
    for name in sorted(set(old) & set(new)):
        changed = False
        for field in sorted(set(old[name]) | set(new[name])):
            equal = same if tier == "same-bits" else SAME_ANSWER.get(field.rpartition(".")[2])
            a, b = old[name].get(field, ABSENT), new[name].get(field, ABSENT)
            if equal is None or equal(a, b):
                continue
            known = next((e for e in expected if fnmatchcase(name, e.case) and fnmatchcase(field, e.field)), None)
            if known is not None:
                known.met += 1
                continue
            print(f"{name}: {field}: {difference(field, a, b)}")
            fields[field.rpartition(".")[2]] += 1
            different, changed = different + 1, True
        cases_changed += changed
    for one in expected:
        print(f"expected, {one.met} times: {one.case} | {one.field} | {one.reason}")
    print(
        f"{tier}: {len(set(old) & set(new))} matches compared, {cases_changed} differ in {different} fields "
        f"{dict(fields)}; {len(missing)} in one recording only"
    )
    return int(bool(missing or different))


def entries(path: Path) -> dict[str, Entry]:
    """A recording by the names of its cases."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return {row.pop("case"): row for row in rows}


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("record")
    one.add_argument("path", type=Path)
    one.add_argument("--quick", action="store_true", help="the first case of each family")
    one.add_argument("--only", default="*", help="cases whose name matches this glob")
    two = commands.add_parser("compare")
    two.add_argument("before", type=Path)
    two.add_argument("after", type=Path)
    two.add_argument("--tier", choices=TIERS, default=TIERS[0])
    two.add_argument("--expected", type=Path, help="what changes on purpose")
    given = parser.parse_args()
    if given.command == "compare":
        return compare(given.before, given.after, given.tier, Expected.read(given.expected))
    record(given.path, given.quick, given.replace_points)
    return 0


if __name__ == "__main__":
    sys.exit(main())
