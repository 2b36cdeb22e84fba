"""Style of figures: palette, line styles, fonts, panels, and saving."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zlib import crc32

from metropilot.drivers import DRIVERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEFT_IN, RIGHT_IN, TOP_IN, BOTTOM_IN = 0.62, 0.16, 0.78, 0.46
# Okabe and Ito (2008): told apart by everyone; line styles keep them apart in greyscale print.
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PURPLE = (
    "#000000",
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#F0E442",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
GREY, PALE, FAINT = "#6B6B6B", "#D9D9D9", "#EFEFEF"
SERIES_STYLES = (
    (BLUE, "-"),
    (VERMILION, (0, (6, 2))),
    (GREEN, (0, (6, 2, 1, 2))),
    (PURPLE, (0, (1.5, 1.5))),
    (ORANGE, (0, (9, 2, 1, 2, 1, 2))),
    (SKY, (0, (3, 1))),
    (BLACK, (0, (1, 3))),
)


USUAL = ("optimal", "manual", "flat_out", "ppo", "mpc", "pid", "learned")
"""Drivers that are compared most: one colour of the palette each."""


def driver_styles(drivers: Sequence[str]) -> dict[str, tuple[str, Any]]:
    """A colour and a line style for each driver, the same in every picture; no two drivers share both.

    A registered driver has its own; past the palette's end the colours come again, in other line styles. One
    named with its options (``pid:kp=3``) has what its name decides, and gives way only where another such
    driver of the picture has that already.
    """
    styles = [dashes for _, dashes in SERIES_STYLES]
    count = len(SERIES_STYLES)
    places = {name: k for k, name in enumerate(dict.fromkeys((*USUAL, *DRIVERS.ids())))}
    taken = {name: places[name] for name in drivers if name in places}
    free = max(count**2 - len(places), 1)
    for name in sorted(set(drivers) - set(taken)):
        wanted = [len(places) + (crc32(name.encode()) + k) % free for k in range(free)]
        taken[name] = next((k for k in wanted if k not in taken.values()), wanted[0])
    return {
        name: (SERIES_STYLES[k % count][0], styles[(k + k // count) % count]) for name, k in taken.items()
    }


LEGEND_SHARE, LINE_PT = 0.9, 15
"""Share of a figure's width that a line of a legend may take, and its height."""
SETTINGS: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.5,
    "axes.labelsize": 8.5,
    "axes.titlesize": 10,
    "axes.linewidth": 0.6,
    "axes.edgecolor": "#404040",
    "axes.labelcolor": "#202020",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.5,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.color": "#404040",
    "ytick.color": "#404040",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "butt",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "legend.handlelength": 2.6,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.hashsalt": "metropilot",
    "svg.fonttype": "path",
    "path.simplify_threshold": 0.05,
}


@contextmanager
def house_style() -> Iterator[None]:
    """Apply the settings of the project instead of those of the user's Matplotlib."""
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(SETTINGS)
        yield


def new_panels(width_in: float, height_in: float, heights: Sequence[float]) -> tuple[Figure, list[Axes]]:
    """Make a figure without a window, with panels one above the other and room for the headline.

    Args:
        width_in: Width, inches.
        height_in: Height, inches.
        heights: Relative heights of the panels, from the top.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in))
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        len(heights),
        1,
        height_ratios=list(heights),
        left=LEFT_IN / width_in,
        right=1 - RIGHT_IN / width_in,
        bottom=BOTTOM_IN / height_in,
        top=1 - TOP_IN / height_in,
        hspace=0.24,
    )
    panels = [figure.add_subplot(grid[0])]
    panels += [figure.add_subplot(grid[k], sharex=panels[0]) for k in range(1, len(heights))]
    for upper in panels[:-1]:
        upper.tick_params(labelbottom=False)
    return figure, panels


def save_figure(figure: Figure, stem: Path) -> None:
    """Write ``stem.svg`` and ``stem.png``, the same bytes for the same figure."""
    with house_style():
        figure.savefig(stem.with_suffix(".svg"), metadata={"Date": None, "Creator": "metropilot"})
        figure.savefig(stem.with_suffix(".png"), dpi=200, metadata={"Software": "metropilot"})


def label_panel(axes: Axes, text: str) -> None:
    """Write the label of a panel horizontally above it."""
    axes.set_title(text, loc="left", fontsize=8, color="#404040", pad=3)


def add_headline(axes: Axes, title: str, below: str) -> None:
    """Title, a line below it, and the legend in as many lines as it takes, all flush with the left edge."""
    handles, _ = axes.get_legend_handles_labels()
    rows = 0
    while len(handles) > 1:
        rows += 1
        legend = axes.legend(
            loc="lower left",
            bbox_to_anchor=(0, 1.0),
            ncols=-(-len(handles) // rows),
            borderaxespad=0.5,
            borderpad=0,
            columnspacing=1.6,
        )
        # a legend of many drivers takes more than one line
        if rows == len(handles) or legend.get_window_extent().width <= LEGEND_SHARE * axes.figure.bbox.width:
            break
    if rows > 1:
        figure: Any = axes.figure
        grid: Any = axes.get_gridspec()
        grid.update(top=1 - (TOP_IN + (rows - 1) * LINE_PT / 72) / figure.get_figheight())
        for panel in figure.axes:
            panel.set_position(panel.get_subplotspec().get_position(figure))
    above: Any = {"xy": (0, 1), "xycoords": "axes fraction", "textcoords": "offset points"}
    axes.annotate(title, xytext=(0, 22 + LINE_PT * rows), fontsize=11, weight="bold", **above)
    axes.annotate(below, xytext=(0, 8 + LINE_PT * rows), fontsize=8, color=GREY, **above)
