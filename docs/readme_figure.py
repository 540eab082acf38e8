"""Renders the picture of README.md from a finished default study: python docs/readme_figure.py [results folder]"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from reports.colors import ERROR_COLORMAP
from reports.heads import HeadPages, render_heads
from reports.load import load

IMAGE = Path(__file__).parent / "images" / "readme_heads.png"
SHOWN = ("source", "truth", "gradient_transfer", "landmark_dt", "lbs", "plbs", "ebfr", "alm", "adt", "anacondar")


def main(results: Path) -> None:
    (study,) = load([results])
    with tempfile.TemporaryDirectory() as folder:
        pages = render_heads(study, Path(folder), "readme", expressions=2)
        if pages is None:
            sys.exit(f"{results}: expected a study that kept frames for figures; set study.figures.pairs=1.")
        draw(pages, Path(folder))


def draw(pages: HeadPages, folder: Path) -> None:
    rows = [
        {head.label.split(" person")[0]: head for head in row.heads if head.label.split(" person")[0] in SHOWN}
        for row in pages.pages[0].rows
    ]
    columns = len(rows[0])
    figure, axes = plt.subplots(len(rows), columns, figsize=(1.3 * columns, 1.85 * len(rows)), squeeze=False)
    figure.subplots_adjust(left=0.005, right=0.935, top=0.93, bottom=0.04, wspace=0.02, hspace=0.14)
    for i, row in enumerate(rows):
        for ax, head in zip(axes[i], row.values(), strict=True):
            ax.axis("off")
            if head.image is not None:
                ax.imshow(plt.imread(folder / head.image))
            if i == 0:
                ax.set_title(head.label.split(" person")[0], fontsize=8.5)
            unit = "" if head.label.startswith(("source", "truth")) else " mm"
            ax.text(0.5, -0.05, f"{head.caption}{unit}", transform=ax.transAxes, ha="center", fontsize=8)
    bar = figure.add_axes((0.948, 0.2, 0.009, 0.6))
    figure.colorbar(ScalarMappable(Normalize(0, pages.limit_mm), ERROR_COLORMAP), cax=bar, extend="max")
    bar.tick_params(labelsize=7)
    bar.set_title("mm", fontsize=8)
    figure.savefig(IMAGE, dpi=120)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "results/quantitative"))
