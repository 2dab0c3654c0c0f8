"""Records by duty, torque, current or a servo's goal, and with both encoders, are diagnosed as those by voltage are."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pytest
from drives import flexible_drive, measure, multisine, rigid_drive
from gapcase import NOISE, RATIO, SAMPLES, STEP, only, small_case

from hybrid_id.components import (
    CurrentCommand,
    CurrentMotor,
    DutySupply,
    PositionLoop,
    Spring,
    TorqueCommand,
    TorqueMotor,
)
from hybrid_id.diagnosis.diagnose import diagnose
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System


@pytest.fixture
def few() -> Iterator[None]:
    """A catalogue of what is missing and its nearest rival."""
    with only("spring_load", "constant_torque"):
        yield


def driven(kind: str) -> tuple[System, Mapping[str, str], tuple[str, ...]]:
    """A drive, the units of its inputs, and its outputs."""
    rigid = rigid_drive(ratio=RATIO)
    if kind == "duty":
        return rigid.with_component("joint1/input", DutySupply()), {"duty1": "1", "supply1": "V"}, ("q_m1",)
    if kind == "torque":
        by_torque = rigid.with_component("joint1/input", TorqueCommand())
        return by_torque.with_component("joint1/motor", TorqueMotor()), {"tau1": "N m"}, ("q_m1",)
    if kind == "current":
        by_current = rigid.with_component("joint1/input", CurrentCommand())
        return by_current.with_component("joint1/motor", CurrentMotor(k_t=0.0254)), {"i1": "A"}, ("q_m1",)
    if kind == "servo":
        units = {"goal1": "rad", "gain1": "1", "supply1": "V"}
        return rigid.with_component("joint1/input", PositionLoop()), units, ("q_m1",)
    return flexible_drive(), {"u1": "V"}, ("q_m1", "q_a1")


def case(kind: str) -> tuple[Dataset, System]:
    """Three train records and a test record of a drive with a spring at its link, and the drive without."""
    today, units, outputs = driven(kind)
    stiff = Spring(k_s=60.0 if kind == "encoders" else 0.6, q_s=0.3 if kind != "encoders" else 0.03)
    truth, records = today.with_component("joint1/load", stiff), []
    noise = {"q_m1": NOISE, "q_a1": NOISE / 156.0}
    for k in range(4):
        wave = multisine(k, samples=SAMPLES, amplitude=6.0 + k, rest=20, step=STEP)
        channels = {name: wave for name in units}
        if kind == "duty":
            channels = {"duty1": wave / 12.0, "supply1": 12.0 + 0.5 * np.sin(np.arange(SAMPLES) / 40.0)}
        elif kind == "torque":
            channels = {"tau1": 0.004 * wave}
        elif kind == "current":
            channels = {"i1": 0.15 * wave}
        elif kind == "servo":
            still = np.ones(SAMPLES)
            channels = {"goal1": 4.0 * wave, "gain1": (40.0 + 10.0 * k) * still, "supply1": 12.0 * still}
        y = measure(truth, channels, outputs=outputs, step=STEP, engine=Engine(substeps=4))
        generator = np.random.default_rng(k)
        y = {name: value + noise[name] * generator.standard_normal(SAMPLES) for name, value in y.items()}
        role = "test" if k == 3 else "train"
        records.append(Record(f"run_{k}", STEP * np.arange(SAMPLES), channels, y, role=role))
    inputs = tuple(Channel(name, unit) for name, unit in units.items())
    return Dataset(
        kind, inputs, tuple(Channel(n, "rad", noise[n]) for n in outputs), tuple(records), STEP
    ), today


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("kind", ["duty", "torque", "current", "servo", "encoders"])
def test_a_missing_spring_is_named(kind: str) -> None:
    found = diagnose(*case(kind), max_effects=1)
    assert [(s.name, s.where) for s in found.selected] == [("spring_load", "joint1/load")]
    assert found.shrink is not None and found.shrink.share > 0.9


@pytest.mark.usefixtures("few")
def test_an_encoder_that_counts_edges_is_no_gap() -> None:
    """Its readings lie half a count below the angle, with no noise that would average them."""
    dataset, today = small_case()
    count = 2.0 * np.pi / 64.0
    read = tuple(
        replace(r, outputs={n: count * np.floor(q / count) for n, q in r.outputs.items()})
        for r in dataset.records
    )
    channels = tuple(replace(channel, noise_std=None) for channel in dataset.outputs)
    found = diagnose(replace(dataset, records=read, outputs=channels), today, max_effects=1)
    assert found.verdict == "parameters_only" and not found.varying
