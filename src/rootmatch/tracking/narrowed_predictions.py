"""Which frames narrow the predictions of a missing body that have become wide: in turn with searches elsewhere."""

from __future__ import annotations


class NarrowedPredictions:
    """The frames that did, for one of several bodies.

    A wide prediction is narrowed by single matches, which takes as long as a search. So a frame does one or the other,
    and of several predictions it narrows one.
    """

    def __init__(self) -> None:
        self.last = self.count = 0

    def of_frame(self, frame: int, predictions: int, *, searching: bool) -> tuple[int, ...]:
        """The number of the prediction that a frame narrows; none in every other frame while a search is under way."""
        if searching and self.last == frame - 1:
            return ()
        self.last, self.count = frame, self.count + 1
        return (self.count % predictions,)
