"""One look for all pictures: sizes and type of a two-column journal, colours that everybody can distinguish."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from hybrid_id import __version__

WIDTH = 7.16  # in; the text width of a two-column journal page
DPI = 200
GREY = "#8c8c8c"
# Okabe and Ito, "Color Universal Design", 2008; from dark to light on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
DASHES: tuple[Any, ...] = ("-", (0, (4, 1.2)), (0, (1.2, 1)), (0, (5, 1, 1, 1)))

_LOOK: dict[Any, Any] = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "legend.fontsize": 7.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "mathtext.fontset": "dejavusans",
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": False,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": True,
    "lines.linewidth": 1.0,
    "legend.frameon": False,
}
_QUANTITY = {
    "u": "voltage", "duty": "duty cycle", "supply": "supply voltage", "goal": "goal angle", "gain": "loop gain",
    "enable": "motor on", "tau": "torque", "tau_a": "torque at the link", "i": "current", "q_m": "motor angle",
    "q_a": "link angle", "v_m": "motor speed", "v_a": "link speed",
}  # fmt: skip


@contextmanager
def journal() -> Iterator[None]:
    """Draw with the common look, as a context or as a decorator; leaves matplotlib's settings as they were."""
    with rc_context(_LOOK):
        yield


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """An empty figure (sizes in inches) outside of pyplot, so that none piles up in memory."""
    return Figure(figsize=(width, height), layout="constrained")


def rows_of_panels(
    names: Sequence[str], panels: int = 1, *, height: float = 0.27, width: float = WIDTH, **layout: Any
) -> tuple[Figure, list[Axes]]:
    """A figure whose panels share rows, the first on top, each row with its name at the left."""
    figure = new_figure(height * len(names) + 0.9, width)
    grid = list(np.ravel(figure.subplots(1, panels, sharey=True, **layout)))
    grid[0].set_yticks(range(len(names)), names)
    grid[0].set_ylim(len(names) - 0.5, -0.5)
    for axes in grid:
        axes.tick_params(axis="y", length=0)  # beside a bar of no length a tick reads as a minus
    return figure, grid


def symbol(name: str) -> str:
    """A parameter's or signal's name as it is printed, ``f_11`` with its index set low."""
    greek = {letter: rf"\{letter}" for letter in ("alpha", "beta", "mu", "rho", "sigma", "tau", "zeta")}
    found = re.fullmatch(r"([A-Za-z]+)(?:_([A-Za-z]*\d+|[a-z]+)|(\d+))", name)
    if found is None or len(name) == 1:
        return f"${greek.get(name, name)}$" if len(name) == 1 or name in greek else name
    stem, index = found[1], found[2] or found[3]
    stem = greek.get(stem, stem if len(stem) == 1 else rf"\mathrm{{{stem}}}")
    return rf"${stem}_{{\mathrm{{{index}}}}}$"


def shortened(name: str, most: int) -> str:
    """A name of so many characters at most; names often differ at their end."""
    return name if len(name) <= most else f"…{name[1 - most :]}"


def unit(text: str) -> str:
    """A unit as it is printed: ``kg m^2`` with a raised 2, nothing for a pure number."""
    return "" if text == "1" else text.replace("^2", "²").replace("^3", "³").replace(" ", "\u2009")


def label(name: str, unit_text: str) -> str:
    """Axis label of a signal: quantity, symbol, unit."""
    stem = name.rstrip("0123456789")
    words = f"{_QUANTITY.get(stem, '')} {symbol(name)}".strip()
    return f"{words} [{unit(unit_text)}]" if unit(unit_text) else words


def pixels(figure: Figure) -> np.ndarray:
    """A figure as an image, (H, W, 3) uint8: drawn once, for a file and for TensorBoard."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    with warnings.catch_warnings():  # long names may leave no room; the picture is drawn all the same
        warnings.filterwarnings("ignore", "constrained_layout not applied")
        canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def png(image: np.ndarray) -> bytes:
    """An image, (H, W, 3) uint8, as a PNG that names the program."""
    file, about = BytesIO(), PngInfo()
    about.add_text("Software", f"hybrid_id {__version__}")
    Image.fromarray(image).save(file, "png", dpi=(DPI, DPI), pnginfo=about)
    return file.getvalue()


def save(figure: Figure | np.ndarray, path: Path) -> None:
    """Write a figure, or the image of one, as PNG."""
    path.write_bytes(png(pixels(figure) if isinstance(figure, Figure) else figure))


def power_of_ten(values: np.ndarray) -> int:
    """Exponent, a multiple of 3, by which values are scaled so that their axis needs no long numbers."""
    largest = float(np.max(np.abs(values), initial=0.0))
    exponent = 3 * math.floor(math.log10(largest) / 3) if largest > 0 else 0
    return 0 if -2 <= math.log10(largest or 1.0) < 4 else exponent


def scaled_unit(text: str, exponent: int) -> str:
    """Unit with a power of ten in front, in brackets; empty where there is neither."""
    ten = f"$10^{{{exponent}}}$" if exponent else ""
    words = "\u2009".join(part for part in (ten, unit(text)) if part)
    return f"[{words}]" if words else ""


def legend_above(figure: Figure, axes: Axes, columns: int | None = None) -> None:
    """Put the legend of one panel above all panels, in one row unless columns are given."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=columns or len(labels))


def plain_logarithm(axis: Axis) -> None:
    """Few plain numbers instead of powers of ten on a logarithmic axis."""
    low, high = axis.get_view_interval()
    subs = next(
        (s for most, s in ((30.0, (1.0, 2.0, 5.0)), (300.0, (1.0, 3.0))) if high <= most * low), (1.0,)
    )
    axis.set_major_locator(LogLocator(subs=subs, numticks=12))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def pad(axes: Axes, share: float = 0.08) -> None:
    """Leave a little air above and below the curves."""
    low, high = axes.get_ylim()
    axes.set_ylim(low - share * (high - low), high + share * (high - low))
