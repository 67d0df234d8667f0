"""``--noise``, ``--source-noise`` and columns of the files of points: one of them says how noisy each point is."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rootmatch.cli.error_messages import rename_to_options
from rootmatch.errors import InputError, quote_value

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from rootmatch.problems.base import Problem

    Floats = NDArray[np.float64]

DEFAULT = 1.0
"""Pixels, as of `rootmatch.match`."""
COLUMNS = {1: "column sigma", 2: "columns sx,sy,sz", 3: "columns sxx,sxy,syy"}
"""How an error names the columns that state noise, by the dimension of the array that holds them."""


@dataclass(frozen=True)
class Noise:
    """The noise as stated on a command line."""

    given: Any
    """What ``--noise`` says, see `noise_option`."""
    source_sigma: Floats | None
    """(n,) or (n, 3). The column of the model, or its three."""
    model: Path
    image: Path
    """For the messages."""
    problem: Problem
    given_source: float | None = None
    """What ``--source-noise`` says."""

    @property
    def source_argument(self) -> Any:
        """The argument ``source_noise`` of `rootmatch.match`; None if nothing says it."""
        if self.source_sigma is None:
            return self.given_source
        name = "sigma" if self.source_sigma.ndim == 1 else "sx"
        if self.given_source is not None:
            raise InputError(
                f"--source-noise: {self.model} has a column {name}, which states it; leave one of them out"
            )
        if not self.problem.noisy_source and not self.problem.takes_prior:
            exact = f"{self.problem.name} takes its points as exact"
            raise InputError(f"{self.model}: it has a column {name}, but {exact}; leave the column out")
        return self.source_sigma

    def naming(self, target_sigma: Floats | None) -> AbstractContextManager[None]:
        """A block whose errors about the noise name the columns of the detections, if those state it."""
        if target_sigma is None:
            return nullcontext()
        return rename_to_options({"noise": f"{self.image}: {COLUMNS[target_sigma.ndim]}"})

    @property
    def source_subject(self) -> str:
        """What an error about the noise of the model begins with."""
        if self.source_sigma is None:
            return "--source-noise"
        return f"{self.model}: {COLUMNS[self.source_sigma.ndim]}"

    def of(self, target_sigma: Floats | None) -> Any:
        """The argument ``noise`` of `rootmatch.match` for detections with such a column, or without."""
        given = self.given
        sides = ((self.model, self.source_sigma if self.problem.noisy_source else None), (self.image, target_sigma))
        columns = [path for path, sigma in sides if sigma is not None]
        if not columns:
            return DEFAULT if given is None else given
        said = given is not None and (len(columns) == 2 or not self.problem.noisy_source)
        if said or given == "auto":
            raise InputError(f"--noise: {columns[0]} has a column that states the noise; leave one of them out")
        source, target = given if isinstance(given, tuple) else (given or DEFAULT,) * 2
        if target_sigma is not None:
            target = target_sigma
        return (source, target) if self.problem.noisy_source and self.source_argument is None else target


def noise_option(text: str | None) -> Any:
    """A number of pixels, two of them (source and target), or "auto"; None if nothing is given."""
    if text is None or text == "auto":
        return text
    try:
        source, *target = (float(part) for part in text.split(",", maxsplit=1))
        return (source, target[0]) if target else source
    except ValueError:
        raise InputError(
            f"--noise: {quote_value(text)} given; give a number of pixels, SOURCE,TARGET where both are noisy, or auto"
        ) from None
