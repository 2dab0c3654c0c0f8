"""The interactive form of a figure, read off the figure itself, and the library that draws it without a network."""

from __future__ import annotations

import base64
import functools
import gzip
import json
import re
from importlib.resources import files
from typing import Any, NamedTuple, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import QuadMesh
from matplotlib.colors import to_hex
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator

from hybrid_id.records.files import plain
from hybrid_id.reporting.style import pixels

Plot = dict[str, Any]
"""A plotly figure as plain data."""
POINTS = 2000
"""Points of one curve at most, so that a page stays small."""
PANEL, BETWEEN = 300, 80
"""Height of a panel and of the gap below it [px]; panels stand one below the other, which also fits a phone."""
LEAST_PANEL, ROW = 90, 30
"""Height of a panel whose rows have names, at least, and that of a row [px]."""
_DASHES = {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}
_MARKERS = {
    "o": "circle",
    ".": "circle",
    "s": "square",
    "D": "diamond",
    "^": "triangle-up",
    "|": "line-ns-open",
}


class Drawn(NamedTuple):
    """A figure as an image ``(H, W, 3)`` uint8, and its interactive form."""

    image: np.ndarray
    plot: Plot


def drawn(figure: Figure) -> Drawn:
    """Draw a figure once, for a file, a page and TensorBoard."""
    return Drawn(pixels(figure), interactive(figure))


def interactive(figure: Figure) -> Plot:
    """Lines, bars and maps of a figure as a plotly figure, panel by panel from the top."""
    panels = [axes for axes in figure.axes if not hasattr(axes, "_colorbar")]
    heights = [_height(axes) for axes in panels]
    total = sum(heights) + BETWEEN * (len(panels) - 1)
    data: list[Plot] = []
    layout: Plot = {"height": total + 120, "legend": {"orientation": "h", "y": -70 / total, "yanchor": "top"}}
    shapes: list[Plot] = []
    below, top = without_tex(figure.get_supxlabel()), 1.0
    for number, (axes, height) in enumerate(zip(panels, heights, strict=True), start=1):
        name = "" if number == 1 else str(number)
        row, column = (_beside(axes, panels, span) for span in ("rowspan", "colspan"))
        titles = next(filter(None, (one.get_xlabel() for one in column)), below), row[0].get_ylabel()
        across, up = _axis(axes.xaxis, titles[0]), _axis(axes.yaxis, axes.get_ylabel() or titles[1])
        up["domain"] = [max(0.0, top - height / total), top]
        if number > 1 and axes.get_shared_x_axes().joined(axes, panels[0]):
            across["matches"] = "x"  # one zoom for all panels over one time
            layout["hovermode"] = "x unified"
        layout |= {
            f"xaxis{name}": across | {"anchor": f"y{name}"},
            f"yaxis{name}": up | {"anchor": f"x{name}"},
        }
        at = {"xaxis": f"x{name}", "yaxis": f"y{name}"}
        data += [trace | at for trace in _traces(axes)]
        shapes += [
            shape | {"xref": shape["xref"].format(name), "yref": shape["yref"].format(name)}
            for shape in _shapes(axes)
        ]
        if title := axes.get_title() or axes.get_title(loc="left"):
            layout.setdefault("annotations", []).append(
                {"text": without_tex(title), "xref": f"x{name} domain", "yref": f"y{name} domain", "x": 0, "y": 1,
                 "xanchor": "left", "yanchor": "bottom", "showarrow": False}
            )  # fmt: skip
        top -= (height + BETWEEN) / total
    _one_entry_a_label(data)
    return {"data": data, "layout": layout | ({"shapes": shapes} if shapes else {})}


def _height(axes: Axes) -> int:
    """Height of a panel [px]: by its rows where they have names; half where its row in the figure is less than half."""
    if (rows := _names(axes.yaxis)) is not None:
        return max(LEAST_PANEL, ROW * len(rows))
    spec = axes.get_subplotspec()
    ratios = None if spec is None else spec.get_gridspec().get_height_ratios()
    if spec is None or ratios is None:
        return PANEL
    heights = np.asarray(ratios, float)
    return PANEL // 2 if heights[spec.rowspan.start] < 0.5 * heights.max() else PANEL


def _beside(axes: Axes, others: list[Axes], span: str) -> list[Axes]:
    """Panels of the same row or column, which share what stands at its edge."""
    own = axes.get_subplotspec()
    if own is None:
        return [axes]
    spans = ((one, one.get_subplotspec()) for one in others)
    return [one for one, spec in spans if spec is not None and getattr(spec, span) == getattr(own, span)]


def _traces(axes: Axes) -> list[Plot]:
    bars = [bar for bar in axes.containers if isinstance(bar, BarContainer)]
    maps = [mesh for mesh in axes.collections if isinstance(mesh, QuadMesh)]
    lines = [line for line in axes.lines if line.get_transform() == axes.transData and len(_data(line)[0])]
    return [*map(_map, maps), *(_bar(axes, bar) for bar in bars), *(_line(axes, line) for line in lines)]


def _data(line: Line2D) -> tuple[np.ndarray, np.ndarray]:
    x, y = (np.asarray(values, float) for values in line.get_data(orig=False))
    return x, y


def _line(axes: Axes, line: Line2D) -> Plot:
    x, y = _data(line)
    step = max(1, -(-len(x) // POINTS))
    x, y, marker = x[::step], y[::step], _MARKERS.get(str(line.get_marker()))
    style = _style(line) | ({"shape": "hv"} if line.get_drawstyle() == "steps-post" else {})
    shown = {"lines": line.get_linestyle() not in ("None", " ", ""), "markers": marker is not None}
    # stamps may count from 1970
    trace: Plot = {"type": "scatter", "x": short(x, 12), "y": short(y), "opacity": line.get_alpha() or 1.0}
    trace |= {"mode": "+".join(name for name, one in shown.items() if one), "line": style}
    if not (label := str(line.get_label())).startswith(("_child", "_nolegend")):
        trace["name"] = without_tex(
            label.removeprefix("_")
        )  # "_" keeps a name from the picture's legend only
    if marker:
        colour = to_hex(line.get_color())
        edge = 2 if marker.endswith("-open") else 0
        trace["marker"] = {"color": colour, "symbol": marker, "size": max(3.0, 1.6 * line.get_markersize())}
        trace["marker"]["line"] = {"width": edge, "color": colour}
    return trace | _hover(axes, x, y)


def _hover(axes: Axes, x: np.ndarray, y: np.ndarray) -> Plot:
    """What stands beside the pointer where rows or columns have names."""
    for axis, values, other in ((axes.yaxis, y, "x"), (axes.xaxis, x, "y")):
        names = _names(axis)
        if names and set(values) <= set(names):
            return {
                "text": [names[v] for v in values],
                "hovertemplate": f"%{{text}}: %{{{other}}}<extra></extra>",
            }
    return {}


def _bar(axes: Axes, bars: BarContainer) -> Plot:
    patches = [cast(Rectangle, patch) for patch in bars.patches]
    lying = bars.orientation == "horizontal"
    ends = [p.get_width() if lying else p.get_height() for p in patches]
    at = [p.get_y() + p.get_height() / 2 if lying else p.get_x() + p.get_width() / 2 for p in patches]
    x, y = (np.array(ends), np.array(at).round(9)) if lying else (np.array(at).round(9), np.array(ends))
    trace: Plot = {"type": "bar", "orientation": "h" if lying else "v", "x": short(x), "y": short(y)}
    trace |= {"textposition": "none"}
    if not (label := str(bars.get_label())).startswith("_"):
        trace["name"] = without_tex(label)
    trace["marker"] = {"color": [to_hex(p.get_facecolor()) for p in patches]}
    return trace | _hover(axes, x, y)


def _map(mesh: QuadMesh) -> Plot:
    corners = np.asarray(mesh.get_coordinates())
    x, y = ((edge[:-1] + edge[1:]) / 2 for edge in (corners[0, :, 0], corners[:, 0, 1]))
    values = np.asarray(mesh.get_array()).reshape(len(y), len(x))
    colours = [[k / 10, to_hex(mesh.get_cmap()(k / 10))] for k in range(11)]
    low, high = mesh.get_clim()
    trace: Plot = {"type": "heatmap", "x": short(x), "y": short(y), "z": [short(row) for row in values]}
    if mesh.axes is not None and mesh.axes.texts:  # numbers in the cells
        trace["texttemplate"] = "%{z:.4~g}"
    bar = {"thickness": 12}
    if mesh.colorbar is not None:
        bar |= {"title": {"text": without_tex(mesh.colorbar.ax.get_ylabel()), "side": "right"}}
    return trace | {"colorscale": colours, "zmin": low, "zmax": high, "colorbar": bar}


def _shapes(axes: Axes) -> list[Plot]:
    """Lines and bands across the whole panel, and frames around cells."""
    found: list[Plot] = []
    across, up = axes.get_xaxis_transform(which="grid"), axes.get_yaxis_transform(which="grid")
    for line in axes.lines:
        if line.get_transform() in (across, up):
            (x0, x1), (y0, y1) = (map(float, values) for values in _data(line))
            ends = {"x0": x0, "x1": x1, "y0": y0, "y1": y1}
            shape: Plot = {
                "type": "line",
                **ends,
                **_refs(line.get_transform() == across),
                "line": _style(line),
            }
            if not (label := str(line.get_label())).startswith("_"):
                shape |= {"name": without_tex(label), "showlegend": True}
            found.append(shape)
    bars = {id(patch) for bar in axes.containers if isinstance(bar, BarContainer) for patch in bar.patches}
    for patch in axes.patches:
        if isinstance(patch, Rectangle) and id(patch) not in bars:
            box = patch.get_bbox()
            ends = {"x0": box.x0, "x1": box.x1, "y0": box.y0, "y1": box.y1}
            if not patch.get_fill():  # a frame around a cell
                edge = {"color": to_hex(patch.get_edgecolor()), "width": patch.get_linewidth()}
                found.append({"type": "rect", **ends, "xref": "x{}", "yref": "y{}", "line": edge})
                continue
            colour = {"fillcolor": to_hex(patch.get_facecolor()), "opacity": patch.get_alpha() or 1.0}
            look = colour | {"line": {"width": 0}, "layer": "below"}
            found.append({"type": "rect", **ends, **_refs((box.y0, box.y1) == (0.0, 1.0)), **look})
    return found


def _refs(upright: bool) -> Plot:
    return {"xref": "x{}" if upright else "x{} domain", "yref": "y{} domain" if upright else "y{}"}


def _axis(axis: Axis, title: str) -> Plot:
    """Scale, limits, title and names of an axis."""
    found: Plot = {"title": {"text": without_tex(title), "standoff": 12}, "automargin": True}
    low, high = axis.get_view_interval()
    if (names := _names(axis)) is not None:
        found |= {"tickvals": list(names), "ticktext": list(names.values()), "zeroline": False}
        return found | {"range": [float(low), float(high)]}
    if axis.get_scale() == "log":
        return found | {"type": "log", "range": [float(np.log10(low)), float(np.log10(high))]}
    return found | {"range": [float(low), float(high)]}


def _names(axis: Axis) -> dict[float, str] | None:
    """Names along an axis by place, where it was given its ticks and what they say."""
    if not isinstance(locator := axis.get_major_locator(), FixedLocator):
        return None
    say = axis.get_major_formatter()
    return {float(at): without_tex(say(at, k)) for k, at in enumerate(np.asarray(locator(), float))}


def _one_entry_a_label(data: list[Plot]) -> None:
    """Let the legend show each label once, and its entry switch all curves of that label."""
    seen: set[str] = set()
    for trace in data:
        name = trace.get("name")
        trace["showlegend"] = name is not None and name not in seen
        if name is not None:
            trace["legendgroup"] = name
            seen.add(name)


def _style(line: Line2D) -> Plot:
    dash = _DASHES.get(str(line.get_linestyle()), "solid")
    return {"color": to_hex(line.get_color()), "width": max(1.0, 1.3 * line.get_linewidth()), "dash": dash}


@functools.cache
def library() -> str:
    """Plotly's script, compressed, as base64; browsers unpack it when the first figure is asked for."""
    source = files("plotly").joinpath("package_data", "plotly.min.js").read_bytes()
    return base64.b64encode(gzip.compress(source, mtime=0)).decode("ascii")


def as_script(plot: Plot) -> str:
    """A figure as JSON that may stand inside a script element."""
    return json.dumps(plain(plot), separators=(",", ":")).replace("<", "\\u003c")


def short(values: np.ndarray, digits: int = 5) -> list[float | None]:
    """Numbers of so many digits; what is not finite is left out of the curve."""
    return [float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in np.asarray(values, float)]


def without_tex(words: str) -> str:
    """Words without TeX: indices and powers as HTML."""

    def formula(found: re.Match[str]) -> str:
        text = re.sub(r"\\mathrm\{([^{}]*)\}", r"{\1}", found[1]).replace("{{", "{").replace("}}", "}")
        text = re.sub(r"\\dot ?\{?(\w)\}?", "\\1\u0307", text)
        for name, sign in (
            ("tau", "τ"),
            ("omega", "ω"),
            ("sigma", "σ"),
            ("mu", "μ"),
            ("times", "×"),
            ("pm", "±"),
        ):
            text = text.replace(f"\\{name}", sign)
        text = re.sub(r"_(?:\{([^{}]*)\}|(\w))", r"<sub>\1\2</sub>", text)
        text = re.sub(r"\^(?:\{([^{}]*)\}|(\w))", r"<sup>\1\2</sup>", text)
        return re.sub("[{}]", "", text)

    return re.sub(r"\$([^$]*)\$", formula, words).replace("\n", "<br>")
