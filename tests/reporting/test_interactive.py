"""The interactive form of a figure shows what the figure shows."""

import json

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from hybrid_id.reporting.interactive import as_script, drawn, interactive
from hybrid_id.reporting.style import COLOURS, journal, new_figure, symbol


@pytest.fixture
def figure() -> Figure:
    with journal():
        made = new_figure(3.0)
        left, right = made.subplots(1, 2, sharey=True)
        left.plot([1.0, 10.0], [0, 1], "o", color=COLOURS[0], label="repeats")
        left.plot([2.0, np.nan], [0, 1], color="black", ls="--")
        left.axvline(1.0, color="black", label="noise")
        left.set(xscale="log", title="test")
        left.set_yticks([0, 1], ["physics only\nwithout F_v", symbol("f_11")])
        left.set_ylim(1.5, -0.5)
        right.barh([0, 1], [-2.0, 3.0], color=[COLOURS[1], COLOURS[0]], height=0.6)
        right.axvspan(-3.0, 3.0, color="grey", alpha=0.2)
        right.plot([0.5], [0.5], "D", label="repeats")
        made.supxlabel("error")
    return made


def test_lines_bars_and_names_of_rows(figure: Figure) -> None:
    plot = interactive(figure)
    repeats, mean, bars, more = plot["data"]
    assert repeats["x"] == [1.0, 10.0] and repeats["mode"] == "markers" and repeats["name"] == "repeats"
    assert mean["x"] == [2.0, None] and mean["line"]["dash"] == "dash" and mean["line"]["color"] == "#000000"
    assert repeats["text"] == ["physics only<br>without F_v", "f<sub>11</sub>"]
    assert (bars["type"], bars["orientation"], bars["x"], bars["y"]) == ("bar", "h", [-2.0, 3.0], [0.0, 1.0])
    assert [trace["showlegend"] for trace in (repeats, mean, more)] == [True, False, False]
    assert repeats["legendgroup"] == more["legendgroup"]
    layout = plot["layout"]
    assert layout["xaxis"]["type"] == "log" and layout["yaxis"]["range"] == [1.5, -0.5]
    assert layout["yaxis"]["ticktext"] == ["physics only<br>without F_v", "f<sub>11</sub>"]
    assert layout["xaxis"]["title"]["text"] == layout["xaxis2"]["title"]["text"] == "error"
    assert layout["annotations"][0]["text"] == "test"
    line, band = layout["shapes"]
    assert (line["xref"], line["yref"], line["x0"], line["name"]) == ("x", "y domain", 1.0, "noise")
    assert (band["type"], band["xref"], band["x0"], band["x1"]) == ("rect", "x2", -3.0, 3.0)


def test_a_frame_stays_a_frame_around_its_cell() -> None:
    with journal():
        made = new_figure(2.0)
        made.subplots().add_patch(Rectangle((-0.5, 1.5), 1, 1, fill=False, ec="black", lw=1.4))
    (frame,) = interactive(made)["layout"]["shapes"]
    assert (frame["xref"], frame["yref"], frame["x0"], frame["x1"], frame["y0"], frame["y1"]) == (
        "x", "y", -0.5, 0.5, 1.5, 2.5,
    )  # fmt: skip
    assert "fillcolor" not in frame and frame["line"] == {"color": "#000000", "width": 1.4}


def test_panels_stand_below_each_other_and_do_not_overlap(figure: Figure) -> None:
    layout = interactive(figure)["layout"]
    (low, high), (below, top) = layout["yaxis"]["domain"], layout["yaxis2"]["domain"]
    assert high == 1.0 and low > top > below >= 0.0


def test_panels_over_one_time_share_zoom_and_pointer() -> None:
    with journal():
        made = new_figure(3.0)
        upper, lower = made.subplots(2, 1, sharex=True, height_ratios=(2.4, 1.0))
        stamps = 1.6e9 + np.arange(3.0)
        upper.plot(stamps, [0, 1, 0], label="measured")
        lower.step(stamps, [0, 1, 0], where="post", label="_u1")
    plot = interactive(made)
    layout, (curve, command) = plot["layout"], plot["data"]
    assert layout["xaxis2"]["matches"] == "x" and layout["hovermode"] == "x unified"
    (low, high), (below, top) = layout["yaxis"]["domain"], layout["yaxis2"]["domain"]
    assert (high - low) == pytest.approx(2 * (top - below))
    assert curve["x"] == list(stamps) and command["line"]["shape"] == "hv" and command["name"] == "u1"


def test_a_map_keeps_values_places_and_scale() -> None:
    with journal():
        figure = new_figure(3.0)
        axes = figure.subplots()
        x, y = np.linspace(0.0, 3.0, 4), np.linspace(-1.0, 1.0, 3)
        image = axes.pcolormesh(x, y, np.arange(12.0).reshape(3, 4), cmap="RdBu_r", vmin=-11.0, vmax=11.0)
        axes.plot([1.0], [0.0], ".", color="black")
        figure.colorbar(image, label="output [N m]")
    image, plot = drawn(figure)
    heat, dot = plot["data"]
    assert image.ndim == 3 and len(plot["data"]) == 2
    np.testing.assert_allclose(heat["x"], x, atol=1e-9)
    np.testing.assert_allclose(heat["y"], y, atol=1e-9)
    np.testing.assert_allclose(heat["z"], np.arange(12.0).reshape(3, 4))
    assert (heat["zmin"], heat["zmax"]) == (-11.0, 11.0)
    assert heat["colorbar"]["title"]["text"] == "output [N m]"
    assert dot["marker"]["color"] == "#000000", "a map is as bright by night as by day"


def test_formulas_become_text() -> None:
    with journal():
        figure = new_figure(2.0)
        axes = figure.subplots()
        axes.plot([0.0, 1.0], [0.0, 1.0], label=r"$j\omega$ in the band")
        axes.set(xlabel=r"$\dot q_\mathrm{m1}$ [rad/s]", ylabel="a < b")
    plot = interactive(figure)
    assert plot["layout"]["xaxis"]["title"]["text"] == "q\u0307<sub>m1</sub> [rad/s]"
    assert plot["data"][0]["name"] == "jω in the band"
    assert "<" not in as_script(plot) and json.loads(as_script(plot)) == plot


def test_long_curves_are_thinned() -> None:
    with journal():
        figure = new_figure(2.0)
        figure.subplots().plot(np.arange(100_001), np.zeros(100_001))
    (curve,) = interactive(figure)["data"]
    assert len(curve["x"]) <= 2000 and curve["x"][0] == 0.0
