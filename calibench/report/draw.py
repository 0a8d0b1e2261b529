"""Drawing: sheets of axes in one quiet style, images with a colour bar, PNG bytes. No global state (never pyplot)."""

from __future__ import annotations

from io import BytesIO

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Sheet
from matplotlib.patheffects import withStroke

INK, GREY, FAINT = "#22272e", "#6b7480", "#d9dde2"
BLUE, ORANGE, GREEN, RED = "#2f6690", "#c8672b", "#4f8a5b", "#a8323a"  # told apart by the colour-blind too, with the markers
SEQUENTIAL, DIVERGING = "cividis", "RdBu_r"
OUTLINED = [withStroke(linewidth=2, foreground="white")]  # letters over an image
HALF, WIDE = (5.6, 3.75), (11.4, 3.5)  # inches
LABELS_IN, BAR_IN = 0.7, 0.75  # what labels and colour bar take from the width
BELOW_IN, TITLE_IN = 0.6, 0.25  # what labels, and the titles of several panels, take from the height
TALLEST_IN = 8.0
SHADES = 64  # more are not told apart, and noise in many shades makes large files
DPI = 110
STYLE = {
    "font.family": "DejaVu Sans", "font.size": 8.5, "text.color": INK,
    "axes.titlesize": 9, "axes.titlelocation": "left", "axes.labelsize": 8.5, "axes.labelcolor": INK, "axes.edgecolor": GREY,
    "axes.linewidth": 0.7, "axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True,
    "axes.grid": False, "grid.color": FAINT, "grid.linewidth": 0.6,
    "xtick.color": GREY, "ytick.color": GREY, "xtick.labelcolor": INK, "ytick.labelcolor": INK,
    "xtick.labelsize": 8, "ytick.labelsize": 8, "legend.fontsize": 8, "legend.frameon": False,
    "image.cmap": SEQUENTIAL, "lines.linewidth": 1.4, "figure.facecolor": "white", "savefig.facecolor": "white",
}


def style() -> object:
    """Context in which sheets are drawn."""
    return matplotlib.rc_context(STYLE)


def sheet(size_in: tuple[float, float] = HALF, columns: int = 1, rows: int = 1, **subplots: object) -> tuple[Sheet, np.ndarray]:
    """An empty sheet and its axes, flat."""
    made = Sheet(figsize=size_in, dpi=DPI, layout="constrained")
    FigureCanvasAgg(made)
    return made, np.ravel(made.subplots(rows, columns, **subplots))


def sensor_sheet(image_size_px: tuple[int, int], *, wide: bool = False, columns: int = 1,
                 bars: bool = True) -> tuple[Sheet, np.ndarray]:
    """A sheet whose axes have the sensor's proportions; bars: leave room for colour bars."""
    width_in = (WIDE if wide else HALF)[0]
    panel_in = width_in / columns - LABELS_IN - bars * BAR_IN
    height_in = panel_in * image_size_px[1] / image_size_px[0] + BELOW_IN + TITLE_IN * (columns > 1)
    return sheet((width_in, min(height_in, TALLEST_IN)), columns)


def png(made: Sheet) -> bytes:
    """The sheet as PNG; without the library's name and date, so that the same story gives the same bytes."""
    buffer = BytesIO()
    made.canvas.print_png(buffer, metadata={"Software": None})  # savefig would lay the sheet out and draw it once more
    return buffer.getvalue()


def sensor_axes(axes: Axes, image_size_px: tuple[int, int], title: str = "") -> None:
    """Axes in pixels of the sensor, row 0 on top, pixel centres on whole numbers."""
    w, h = image_size_px
    axes.set(xlim=(-0.5, w - 0.5), ylim=(h - 0.5, -0.5), aspect="equal", xlabel="column x (px)", ylabel="row y (px)")
    axes.set_title(title)
    axes.spines[["top", "right"]].set_visible(True)


def sensor_image(axes: Axes, image: np.ndarray, label: str, *, title: str = "", cmap: str = SEQUENTIAL,
                 limits: tuple[float, float] | None = None) -> None:
    """An (H, W) map with its colour bar; limits None: the middle 98 % of the pixels, with pointed ends for the rest."""
    low, high = limits or middle(image)
    h, w = image.shape
    sensor_axes(axes, (w, h), title)
    drawn = axes.imshow(image, cmap=matplotlib.colormaps[cmap].resampled(SHADES), vmin=low, vmax=high,
                        interpolation="antialiased", interpolation_stage="data")
    _colour_bar(axes, drawn, label, float(np.nanmin(image)) < low, float(np.nanmax(image)) > high)


def sensor_field(axes: Axes, values: np.ndarray, image_size_px: tuple[int, int], label: str, *, title: str = "",
                 cmap: str = SEQUENTIAL) -> None:
    """A smooth (rows, columns) field sampled evenly from the first pixel to the last, drawn over the sensor."""
    w, h = image_size_px
    sensor_axes(axes, image_size_px, title)
    drawn = axes.imshow(values, cmap=cmap, extent=(-0.5, w - 0.5, h - 0.5, -0.5), interpolation="bilinear")
    _colour_bar(axes, drawn, label, False, False)


def middle(values: np.ndarray, share: float = 0.98) -> tuple[float, float]:
    """Limits that hold `share` of the finite values, opened a little where all are the same."""
    finite = values[np.isfinite(values)]
    tail = 50 * (1 - share)
    low, high = (float(v) for v in np.percentile(finite, (tail, 100 - tail))) if finite.size else (0.0, 1.0)
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def grid_px(image_size_px: tuple[int, int], columns: int, rows: int, inset_px: float = 0.0) -> np.ndarray:
    """(rows * columns, 2) points, evenly from the first pixel to the last, or inset_px from the edges."""
    w, h = image_size_px
    x, y = np.meshgrid(np.linspace(inset_px, w - 1 - inset_px, columns), np.linspace(inset_px, h - 1 - inset_px, rows))
    return np.column_stack([x.ravel(), y.ravel()])


def _colour_bar(axes: Axes, drawn: object, label: str, below: bool, above: bool) -> None:
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[below, above]
    bar = axes.figure.colorbar(drawn, ax=axes, extend=extend, pad=0.02, aspect=28)
    bar.set_label(label)
    bar.outline.set_visible(False)
