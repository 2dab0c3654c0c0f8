"""The band of an excitation in which play and flexibility of a gear act most, or least (paper, II.D)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.excitation import design_multisine
from hybrid_id.records.measures import DRIVES
from hybrid_id.records.record import Record
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

EDGES = 6
"""Frequencies, evenly on a logarithmic scale, between which the bands lie."""
STILL = 0.05
"""Motion, as a share of the largest, from which a band identifies anything at all."""


@dataclass(frozen=True)
class GearBand:
    """A band, and what the gear does there.

    Attributes:
        band: lowest and highest frequency [Hz].
        share: RMS of the gear's deflection over that of the motor's angle at the joint.
        motion: RMS of the motor's angle at the joint [rad].
    """

    band: tuple[float, float]
    share: float
    motion: float


def bands_by_gear(
    system: System,
    band: tuple[float, float],
    act: Literal["most", "least"],
    *,
    sample_time: float,
    duration: float,
    amplitude: float,
    tones: int,
) -> list[GearBand]:
    """Parts of a band, simulated, the one in which play and flexibility of the first such gear act most or least first.

    A rigid model is identified best where they act least, a model with play or a spring where they act most.

    Args:
        system: its values are the ones that are believed before the experiment.
        band: lowest and highest frequency [Hz].
        act: what is wanted.
        sample_time: [s].
        duration: [s].
        amplitude: peak of the command, in its unit.
        tones: number of tones in each part.

    Raises:
        InputError: all gears are rigid, or no part of the band moves the joint or holds so many tones.
    """
    joint = next((one for one in system.joints if not one.rigid), None)
    if joint is None:
        raise InputError(
            "the model's gears are rigid: no band lets play or flexibility act more than another"
        )
    drive = next((f"{c}{joint.number}" for c in joint.channels if c in DRIVES), None)
    if drive is None:
        raise InputError(
            f"{joint.name} is driven by a servo's goal; give a model with voltage, duty, current or torque"
        )
    sides, found = (f"q_m{joint.number}", f"q_a{joint.number}"), []
    edges = np.geomspace(max(band[0], 1.0 / duration), band[1], EDGES)
    for low, high in combinations(edges.tolist(), 2):
        try:
            design = design_multisine(
                (low, high), sample_time=sample_time, duration=duration, amplitude_limits=amplitude, tones=tones,
                starts=1,
            )  # fmt: skip
        except InputError:
            continue  # too narrow for so many tones
        still = np.zeros(len(design.time))
        inputs = {f"{c}{one.number}": still for one in system.joints for c in one.channels} | {
            drive: design.signal
        }
        record = Record(
            name="excitation", time=design.time, inputs=inputs, outputs=dict.fromkeys(sides, still)
        )
        batch = make_batch(system, [record], noise_std=dict.fromkeys(sides, 1.0), signal_share=0.0)
        y = simulate(system, with_substeps(system, compiled_for(system, Engine()), batch), batch).y[0].numpy()
        motor, link = (
            y[:, batch.outputs.index(sides[0])] / joint.gear_ratio,
            y[:, batch.outputs.index(sides[1])],
        )
        if np.isfinite(y).all() and motor.std() > 0.0:
            found.append(GearBand((low, high), float((motor - link).std() / motor.std()), float(motor.std())))
    largest = max((one.motion for one in found), default=0.0)
    found = [one for one in found if one.motion >= STILL * largest]
    if not found:
        raise InputError(
            f"no part of {band[0]:g} to {band[1]:g} Hz moves {joint.name} and holds {tones} tones; raise --amplitude, "
            "lengthen --duration or ask for fewer tones"
        )
    return sorted(found, key=lambda one: one.share, reverse=act == "most")
