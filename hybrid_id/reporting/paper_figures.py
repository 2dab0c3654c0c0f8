"""Figures of the paper, from the reproduction's results."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hybrid_id.reporting.style import COLOURS, DASHES, GREY, journal, new_figure, pad
from hybrid_id.reproduction.curves import Curve
from hybrid_id.reproduction.preprocessing import Preprocessed
from hybrid_id.reproduction.result import TrackingResult


def preprocessing_figure(record: Preprocessed) -> Figure:
    """Fig. 3: voltage, position and velocity of one experiment, raw and preprocessed."""
    with journal():
        figure = new_figure(4.2)
        panels = figure.subplots(3, 2, sharex="col", width_ratios=(2.2, 1))
        begin = record.time[0] + 0.45 * np.ptp(record.time)
        inside = (record.time >= begin) & (record.time <= begin + 0.25)
        for column, part in enumerate((slice(None), inside)):
            time = record.time[part]
            voltage, angle, speed = panels[:, column]
            voltage.plot(time, record.voltage[part], color="black", lw=0.8)
            angle.plot(time, record.angle[part], color=GREY, lw=1.6, label="encoder")
            angle.plot(time, record.smooth_angle[part], color=COLOURS[0], lw=0.9, label="band-limited")
            speed.plot(time, record.difference[part], color=GREY, lw=0.6, label="differences")
            speed.plot(time, record.speed[part], color=COLOURS[0], lw=0.9, label=r"$j\omega$ in the band")
            speed.set_xlabel("time [s]")
            for axes in panels[:, column]:
                axes.margins(x=0)
                pad(axes)
        labels = (
            r"voltage $u_1$ [V]",
            r"motor angle $q_\mathrm{m1}$ [rad]",
            "motor speed\n" + r"$\dot q_\mathrm{m1}$ [rad/s]",
        )
        for axes, text in zip(panels[:, 0], labels, strict=True):
            axes.set_ylabel(text)
        for axes in panels[1:, 0]:
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, borderaxespad=0.0)
        panels[0, 0].set_title("the whole experiment", loc="left")
        panels[0, 1].set_title("a quarter of a second", loc="left")
        figure.align_ylabels(panels[:, 0])
        return figure


def tracking_figure(result: TrackingResult, *, title: str = "") -> Figure:
    """Figs 4 and 5: the joint follows a sine under each model (left), and its errors (right)."""
    with journal():
        figure = new_figure(2.6)
        left, right = figure.subplots(1, 2)
        _motion(left, result, 0)
        _error(right, result, 0)
        left.set_title(title, loc="left")
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))
        return figure


def two_motions_figure(result: TrackingResult) -> Figure:
    """Fig. 8: both joints under each model."""
    return _both(result, _motion)


def two_errors_figure(result: TrackingResult) -> Figure:
    """Fig. 9: errors of both joints under each model."""
    return _both(result, _error)


def _both(result: TrackingResult, draw) -> Figure:
    with journal():
        figure = new_figure(2.6)
        panels = figure.subplots(1, 2)
        for joint, axes in enumerate(panels):
            draw(axes, result, joint)
            axes.set_title(f"joint {joint + 1}", loc="left")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))
        return figure


def _motion(axes: Axes, result: TrackingResult, joint: int) -> None:
    axes.plot(result.time, result.desired[:, joint], color=GREY, lw=2.4, alpha=0.75, label="desired")
    for k, model in enumerate(result.models):
        axes.plot(result.time, result.angle[:, joint, k], color=COLOURS[k], ls=DASHES[k], lw=0.9, label=model)
    axes.set(xlabel="time [s]", ylabel=rf"joint angle $q_{joint + 1}$ [rad]")
    axes.margins(x=0)
    pad(axes)


def _error(axes: Axes, result: TrackingResult, joint: int) -> None:
    axes.axhline(0.0, color="black", lw=0.5)
    for k, model in enumerate(result.models):
        error = 1e3 * (result.desired[:, joint] - result.angle[:, joint, k])
        axes.plot(result.time, error, color=COLOURS[k], ls=DASHES[k], lw=0.9, label=model)
    axes.set(xlabel="time [s]", ylabel=rf"error of $q_{joint + 1}$ [mrad]")
    axes.margins(x=0)
    pad(axes)


def spread_figure(results: Sequence[tuple[str, TrackingResult, int]]) -> Figure:
    """RMS error of every seed under each model: one panel for each (title, result, joint)."""
    with journal():
        figure = new_figure(2.2)
        panels = np.ravel(figure.subplots(1, len(results)))
        for axes, (title, result, joint) in zip(panels, results, strict=True):
            for k in range(len(result.models)):
                values = 1e3 * result.rms[k, joint]
                across = k + np.linspace(-0.18, 0.18, len(values))
                axes.plot(across, values, "o", ms=2.6, color=COLOURS[k], alpha=0.8, mew=0)
                axes.plot([k - 0.28, k + 0.28], [values.mean()] * 2, color="black", lw=1.0)
            names = [model.replace("backlash-flexible", "with backlash") for model in result.models]
            axes.set_xticks(range(len(names)), names)
            axes.set_title(title, loc="left")
            axes.set_ylim(0, None)
            axes.set_xlim(-0.6, len(names) - 0.4)
        panels[0].set_ylabel("RMS error [mrad]")
        return figure


def friction_figure(curves: Sequence[Curve], link: Curve | None = None) -> Figure:
    """Figs 13 and 14: identified friction torque over velocity, each with its truth; the link's own beside it."""
    with journal():
        figure = new_figure(2.9)
        panels = np.ravel(figure.subplots(1, 2 if link else 1, width_ratios=(2, 1) if link else (1,)))
        exponent = 1e3
        for k, curve in enumerate(curves):
            for half in (curve.speed < 0, curve.speed > 0):
                panels[0].plot(
                    curve.speed[half], exponent * curve.truth[half], color=COLOURS[k], lw=2.6, alpha=0.3,
                    solid_capstyle="butt",
                )  # fmt: skip
                panels[0].plot(
                    curve.speed[half], exponent * curve.torque[half], color=COLOURS[k], ls=DASHES[k],
                    lw=1.1, label=curve.label if half[-1] else None,
                )  # fmt: skip
        panels[0].plot([], [], color=GREY, lw=2.6, alpha=0.5, label="truth (pale)")
        panels[0].set(xlabel="motor speed [rad/s]", ylabel="friction torque at the motor [mN m]")
        if link is not None:
            colour = COLOURS[len(curves)]
            panels[1].plot(link.speed, exponent * link.truth, color=colour, lw=2.6, alpha=0.3)
            panels[1].plot(
                link.speed,
                exponent * link.torque,
                color=colour,
                lw=1.1,
                label=r"$\tau_\mathrm{fa}$, flexible",
            )
            panels[1].set(xlabel="link speed [rad/s]", ylabel="friction torque at the link [mN m]")
            panels[1].legend(loc="upper left")
        for axes in panels:
            axes.axhline(0, color="black", lw=0.4)
            axes.axvline(0, color="black", lw=0.4)
        panels[0].legend(loc="upper left")
        return figure
