"""Interactive twins of pictures: plotly figures as plain data, and the library that draws them without a network."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from hybrid_id.plain import plain
from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.style import COLOURS
from hybrid_id.study import Comparison, Study

POINTS = 2000
"""Points of one curve at most, so that a page stays small."""
DASHES = ("dash", "dot", "dashdot", "longdash")
SYMBOLS = ("circle", "diamond", "square", "cross")

Plot = dict[str, Any]


def library() -> str:
    """Plotly's script, compressed, as base64; browsers unpack it when the first figure is asked for."""
    source = files("plotly").joinpath("package_data", "plotly.min.js").read_bytes()
    return base64.b64encode(gzip.compress(source, mtime=0)).decode("ascii")


def as_script(plot: Plot) -> str:
    """A figure as JSON that may stand inside a script element."""
    return json.dumps(plain(plot), separators=(",", ":")).replace("<", "\\u003c")


def record_plot(dataset: Dataset, comparison: Comparison, record: str) -> Plot:
    """One record: each output measured and simulated by every model, and the residuals below."""
    row = comparison.records.index(record)
    replays = {label: replays[row] for label, replays in comparison.replays.items()}
    measured = dataset[record]
    step = max(1, -(-measured.n_samples // POINTS))
    data, layout = [], {"height": 260 + 340 * len(comparison.signals), "hovermode": "x unified"}
    panels = 2 * len(comparison.signals)
    units = {channel.name: channel.unit for channel in dataset.outputs}
    for k, signal in enumerate(comparison.signals):
        upper, lower = 2 * k + 1, 2 * k + 2
        y = measured.signal(signal)
        shown = [("measured", y, upper, "#7f7f7f", "solid")]
        for m, (label, replay) in enumerate(replays.items()):
            colour, dash = COLOURS[m % len(COLOURS)], DASHES[m % len(DASHES)]
            shown.append((label, replay.outputs[signal], upper, colour, dash))
            thin = "solid" if m == 0 else dash  # noise in dashes is hard to read
            shown.append((f"{label}: residual", y - replay.outputs[signal], lower, colour, thin))
        for label, values, panel, colour, dash in shown:
            curve = {"type": "scattergl" if measured.n_samples > POINTS else "scatter", "mode": "lines"}
            curve |= {
                "x": short(measured.time[::step], digits=12),
                "y": short(values[::step]),
                "name": f"{signal} {label}",
            }
            data.append(
                curve | {"yaxis": _axis("y", panel), "line": {"color": colour, "dash": dash, "width": 1.5}}
            )
        for panel, title in ((upper, f"{signal} [{units[signal]}]"), (lower, f"residual [{units[signal]}]")):
            ends = [1 - (panel - 0.12) / panels, 1 - (panel - 1) / panels]
            layout[f"yaxis{panel if panel > 1 else ''}"] = {"title": {"text": title}, "domain": ends}
    layout["xaxis"] = {"title": {"text": "time [s]"}, "anchor": _axis("y", panels)}
    return {"data": data, "layout": layout | {"legend": {"orientation": "h", "y": 1.08}}}


def parameter_plot(study: Study, reach: float) -> Plot:
    """Difference of every parameter from the selected set's [%], with intervals where one may be claimed."""
    names, chosen = list(study.cross_validation.set_names), study.selection.index
    errors = np.array([study.standard_errors(i) for i in range(len(study.sets))])
    data = []
    for k, name in enumerate(study.names):
        base = study.values[chosen, k]
        if base == 0:
            continue
        known = np.isfinite(errors[:, k])
        curve: Plot = {"type": "scatter", "mode": "markers", "x": names, "name": name, "visible": True}
        curve["y"] = short(100 * (study.values[:, k] / base - 1.0))
        curve["error_y"] = {"array": short(np.where(known, 100 * reach * errors[:, k] / abs(base), 0.0))}
        curve["marker"] = {"color": COLOURS[k % len(COLOURS)], "symbol": SYMBOLS[k % len(SYMBOLS)], "size": 8}
        curve["text"] = [f"{value:.4g}" for value in study.values[:, k]]
        data.append(curve | {"hovertemplate": f"{name} = %{{text}}, set %{{x}}<extra></extra>"})
    title = f"differs from set {names[chosen]} by [%]"
    layout: Plot = {"height": 420, "yaxis": {"title": {"text": title}}, "scattermode": "group"}
    return {"data": data, "layout": layout}


def cross_validation_plot(study: Study) -> Plot:
    """Fit of every set on every record [%], cividis as in the picture."""
    matrix, cross = study.cross_validation.matrix(), study.cross_validation
    rows = [[None if not np.isfinite(v) else round(float(v), 2) for v in row] for row in matrix]
    told = "set %{y} on record %{x}: %{z} %<extra></extra>"
    heat: Plot = {"type": "heatmap", "x": list(cross.record_names), "y": list(cross.set_names), "z": rows}
    heat |= {
        "colorscale": "Cividis",
        "hovertemplate": told,
        "texttemplate": "%{z}" if matrix.size <= 144 else "",
    }
    axes: Mapping[str, Any] = {
        "xaxis": {"title": {"text": "replayed on record"}, "type": "category"},
        "yaxis": {"title": {"text": "parameter set"}, "autorange": "reversed", "type": "category"},
    }
    return {"data": [heat], "layout": {"height": 160 + 40 * len(rows), **axes}}


def _axis(letter: str, number: int) -> str:
    return letter if number == 1 else f"{letter}{number}"


def short(values: np.ndarray, digits: int = 5) -> list[float | None]:
    """Numbers of so many digits; what is not finite is left out of the curve."""
    return [float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in np.asarray(values, float)]
