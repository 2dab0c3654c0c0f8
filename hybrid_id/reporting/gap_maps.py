"""Maps of a diagnosis: the missing torque over angle and speed, and what is left after each reversal."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hybrid_id.diagnosis.maps import Reversals, TorqueMap, after_reversals, torque_map
from hybrid_id.diagnosis.refit import Refit
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.gap_words import LEAST_SHARE, percent, side_words
from hybrid_id.reporting.style import COLOURS, DASHES, journal, new_figure, scaled_unit, symbol, unit

JOINTS, ANGLES = 3, 4
"""Joints and outputs that are drawn at most."""
MODELS = {"today": COLOURS[0], "re-fitted": COLOURS[1], "corrected": COLOURS[2]}


def map_figures(dataset: Dataset, diagnosis: Diagnosis, signal_share: float) -> dict[str, Figure]:
    """The maps by the name of their file: of joints at which something is told, and where joints turn round.

    Args:
        dataset: the records.
        diagnosis: the result.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
    """
    refit = Refit(diagnosis.as_searched(dataset), signal_share=signal_share)
    places = {
        one.joint: one.place for one in reversed(diagnosis.where)
    }  # the one that tells most is the last
    maps = [
        {
            name: torque_map(refit, one, int(joint[5:]), places[joint])
            for name, one in diagnosis.fitted.items()
        }
        for joint in sorted(places)[:JOINTS]
    ]
    told = [one for one in maps if max(found.share for found in one.values()) > LEAST_SHARE]
    window = diagnosis.search.window
    left = {name: after_reversals(refit, one, window) for name, one in diagnosis.fitted.items()}
    figures = {"torque_map": torque_map_figure(dataset, told)} if told else {}
    return figures | ({"reversals": reversal_figure(dataset, left)} if all(left.values()) else {})


def torque_map_figure(dataset: Dataset, maps: list[dict[str, TorqueMap]]) -> Figure:
    """A row a joint: what the re-fitted model misses over angle and speed, and the corrected one alike."""
    with journal():
        figure = new_figure(2.3 * len(maps) + 0.2)
        grid = figure.subplots(len(maps), len(maps[0]), squeeze=False)
        for panels, of_joint in zip(grid, maps, strict=True):
            angle_unit, torque_unit = units_of(dataset, next(iter(of_joint.values())).joint)
            reach = max(float(np.nanmax(np.abs(one.torque))) for one in of_joint.values()) or 1.0
            for axes, (name, one) in zip(panels, of_joint.items(), strict=True):
                image = axes.pcolormesh(
                    one.angle, one.speed, one.torque, cmap="RdBu_r", vmin=-reach, vmax=reach, rasterized=True
                )  # fmt: skip
                side = "link" if one.side == "load" else "motor"
                axes.set(
                    xlabel=f"{side} angle [{unit(angle_unit)}]", ylabel=f"{side} speed [{unit(angle_unit)}/s]"
                )
                where = side_words(one.joint, one.side)
                share = percent(one.share) if one.share > LEAST_SHARE else "chance"
                axes.set_title(f"{where}, {name}: {share}", loc="left")
                figure.colorbar(image, ax=axes, label=f"missing torque [{unit(torque_unit)}]")
        return figure


def reversal_figure(dataset: Dataset, left: dict[str, list[Reversals]]) -> Figure:
    """A panel an angle: mean error after a reversal, and its standard error, of every model."""
    outputs = [one.output for one in next(iter(left.values()))][:ANGLES]
    units = {channel.name: channel.unit for channel in dataset.outputs}
    with journal():
        figure = new_figure(2.1 * len(outputs) + 0.2)
        panels = np.ravel(figure.subplots(len(outputs), 1, squeeze=False))
        for axes, output in zip(panels, outputs, strict=True):
            axes.axhline(0.0, color="black", lw=0.5)
            counts = 0
            for k, (name, tests) in enumerate(left.items()):
                one = next((t for t in tests if t.output == output), None)
                if one is None:
                    continue
                counts = one.count
                axes.plot(one.time, one.mean, color=MODELS[name], ls=DASHES[k], label=f"{name} model")
                for side in (-1.0, 1.0):
                    label = f"{name} model ± standard error" if side > 0 else None
                    axes.plot(
                        one.time,
                        one.mean + side * one.error,
                        color=MODELS[name],
                        lw=0.5,
                        alpha=0.7,
                        label=label,
                    )
            axes.set(xlabel="time since the reversal [s]", ylabel=f"error {scaled_unit(units[output], 0)}")
            axes.set_title(f"{symbol(output)}, {counts} reversals", loc="left")
            axes.set_xlim(0.0, None)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=2)
        return figure


def units_of(dataset: Dataset, joint: str) -> tuple[str, str]:
    """Units of a joint's angle and torque; a linear axis has a way and a force."""
    number = joint.removeprefix("joint")
    angle = next((c.unit for c in dataset.outputs if c.name in (f"q_m{number}", f"q_a{number}")), "rad")
    return angle, "N" if angle == "m" else "N m"
