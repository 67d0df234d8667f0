"""Draw docs/headset.png, the picture of the README: what examples/gallery/plot_1_headset.py finds.

python docs/make_headset_picture.py
"""

from __future__ import annotations

import os
import runpy
from pathlib import Path

os.environ["MPLBACKEND"] = "agg"
HERE = Path(__file__).resolve().parent

from rootmatch.report.pictures import match_figure, save_figure  # noqa: E402

if __name__ == "__main__":
    found = runpy.run_path(str(HERE.parent / "examples" / "gallery" / "plot_1_headset.py"))
    match = found["match"]
    figure = match_figure(
        found["model"],
        found["image"],
        match.assignment,
        truth=found["truth"],
        poses=match.poses,
        camera=found["camera"],
        title="32 LEDs, 8 of them visible among 6 reflections: which is which",
        unit="m",
    )
    save_figure(figure, HERE / "headset.png")
