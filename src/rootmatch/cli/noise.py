"""``--noise`` and the columns ``sigma`` of the files of points: the one or the other says how noisy a point is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rootmatch.errors import InputError, quoted

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

DEFAULT = 1.0
"""Pixels, as of `rootmatch.match`."""


@dataclass(frozen=True)
class Noise:
    """What a command line says of the noise.

    Parameters
    ----------
    given : number, pair or "auto", optional
        What ``--noise`` says, see `noise_option`.
    source_sigma : (n,) array, optional
        The column of the model.
    model, image : path
        For the messages.
    noisy_source : bool
        Whether the problem has a noisy source.
    problem : str
        Its name.
    """

    given: Any
    source_sigma: Floats | None
    model: Path
    image: Path
    noisy_source: bool
    problem: str

    def of(self, target_sigma: Floats | None) -> Any:
        """The argument ``noise`` of `rootmatch.match` for detections with such a column, or without.

        Raises
        ------
        InputError
            If both say it, or the problem has exact source points and the model a column.
        """
        if self.source_sigma is not None and not self.noisy_source:
            raise InputError(f"{self.model}: a column sigma, and {self.problem} has exact points there; leave it out")
        given = self.given
        columns = [
            path for path, sigma in ((self.model, self.source_sigma), (self.image, target_sigma)) if sigma is not None
        ]
        if not columns:
            return DEFAULT if given is None else given
        said = given is not None and (len(columns) == 2 or not self.noisy_source)
        if said or given == "auto":
            raise InputError(f"--noise: {columns[0]} has a column sigma, which says it; leave one of them out")
        source, target = given if isinstance(given, tuple) else (given or DEFAULT,) * 2
        if target_sigma is not None:
            target = target_sigma
        if not self.noisy_source:
            return target
        return source if self.source_sigma is None else self.source_sigma, target


def noise_option(text: str | None) -> Any:
    """A number of pixels, two of them (source and target), or "auto"; None if nothing is given."""
    if text is None or text == "auto":
        return text
    try:
        source, *target = (float(part) for part in text.split(",", maxsplit=1))
        return (source, target[0]) if target else source
    except ValueError:
        raise InputError(
            f"--noise: {quoted(text)} given; give a number of pixels, SOURCE,TARGET where both are noisy, or auto"
        ) from None
