"""Skew between redundant channels: found where it is, and not where physics or nothing is."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.quality import check_dataset
from hybrid_id.records.record import Record
from hybrid_id.records.skew import find_skews

FINE, STEP, RECORDS, DURATION = 1e-4, 1e-3, 6, 6.0
RESISTANCE, BACK_EMF, RATIO = 8.0, 0.03, 100.0
UNITS = {"i1": "A", "tau1": "N m", "q_m1": "rad", "v_m1": "rad/s", "q_a1": "rad"}


@lru_cache(maxsize=2)
def drives(
    seeds: int = 3,
    winding: float = 2e-4,
    delay: float = 0.0,
    stiffness: float = np.inf,
    dead: float = 0.0,
    sag: float = 0.0,
) -> dict[str, np.ndarray]:
    """Signals (seeds x records, fine samples) of a geared motor with dry friction under held voltages.

    Args:
        seeds: how many.
        winding: L / R [s], 0 for a current that follows at once.
        delay: of the command on its way to the motor [s].
        stiffness: of the gear at the motor [N m/rad]; its link has viscous friction.
        dead: voltage that the driver loses at either sign of the current [V].
        sag: share of 10 V that the supply loses at 10 V.
    """
    rows, hold = seeds * RECORDS, round(STEP / FINE)
    rng = np.random.default_rng(7)
    time = STEP * np.arange(round(DURATION / STEP))
    tones = np.geomspace(0.3, 30.0, 12)[None, :, None]
    command = np.sin(2 * np.pi * tones * time + rng.uniform(0, 2 * np.pi, (rows, 12, 1))).sum(1)
    command *= 10.0 / np.abs(command).max(axis=1, keepdims=True)
    u = np.repeat(command, hold, axis=1)
    acting = np.roll(u, round(delay / FINE), axis=1)
    q, v, i, qa, va = np.zeros((5, rows))
    inertia, share = 2e-5, 1.0 if np.isinf(stiffness) else 0.6
    seen = {name: np.empty((rows, time.size * hold), np.float32) for name in ("i1", "q_m1", "v_m1", "q_a1")}
    for k in range(time.size * hold):
        supplied = acting[:, k] * (1.0 - sag * np.abs(acting[:, k]) / 10.0) - dead * np.tanh(i / 0.02)
        aim = (supplied - BACK_EMF * v) / RESISTANCE
        i = aim if winding == 0 else i
        for name, value in (("i1", i), ("q_m1", q), ("v_m1", v)):
            seen[name][:, k] = value
        seen["q_a1"][:, k] = (q if share == 1.0 else qa) / RATIO
        spring = 0.0 if share == 1.0 else stiffness * (q - qa)
        i = i if winding == 0 else i + (aim - i) * -np.expm1(-FINE / winding)
        before = v
        v = v + FINE / (share * inertia) * (BACK_EMF * i - spring - 0.004 * np.tanh(v) - 3e-5 * v)
        q = q + 0.5 * FINE * (before + v)
        if share < 1.0:
            va = va + FINE / ((1 - share) * inertia) * (spring - 3e-5 * va)
            qa = qa + FINE * va
    return seen | {"u1": u, "tau1": BACK_EMF * seen["i1"]}


def dataset(
    seed: int, *, channels: tuple[str, ...], late: dict[str, float] | None = None, **drive
) -> Dataset:
    """Records of one seed with sensors that are read late [s], sampled at 1 kHz, with noise and encoder counts."""
    seen, hold, rng = drives(**drive), round(STEP / FINE), np.random.default_rng(seed)
    noise = {"i1": 0.002, "tau1": 5e-5, "q_m1": 1e-3, "v_m1": 0.3, "q_a1": 1e-4}
    records = []
    for row in range(RECORDS * seed, RECORDS * (seed + 1)):
        at = np.arange(200 * hold, seen["u1"].shape[1] - 100 * hold, hold)
        outputs = {}
        for name in channels:
            values = seen[name][row, at - round((late or {}).get(name, 0.0) / FINE)]
            values = values + noise[name] * rng.normal(size=at.size)
            outputs[name] = np.round(values / 0.002) * 0.002 if name == "q_m1" else values
        role = "test" if row % RECORDS == RECORDS - 1 else "train"
        records.append(
            Record(f"r{row}", STEP * np.arange(at.size), {"u1": seen["u1"][row, at]}, outputs, role)
        )
    declared = tuple(Channel(name, UNITS[name]) for name in channels)
    return Dataset("drive", (Channel("u1", "V"),), declared, tuple(records), STEP)


@pytest.mark.parametrize(
    ("channels", "channel", "late", "drive", "within"),
    [
        (("i1", "q_m1"), "i1", 9e-4, {"winding": 0.0}, (1e-4, 1e-4)),
        (("i1", "q_m1"), "i1", 9e-4, {}, (1e-4, 4e-4)),  # a fifth of a sample of the winding's counts with it
        (("tau1", "q_m1"), "tau1", 9e-4, {}, (1e-4, 4e-4)),
        (("q_m1", "v_m1"), "v_m1", 9e-4, {}, (1e-4, 1e-4)),
        (("q_m1", "v_m1"), "q_m1", 9e-4, {}, (1e-4, 1e-4)),
        (("q_m1", "q_a1"), "q_m1", 2e-3, {}, (1e-4, 1e-4)),
        (("q_m1", "q_a1"), "q_a1", 2e-3, {}, (1e-4, 1e-4)),
        (("i1", "q_m1"), "q_m1", 1.5e-3, {"winding": 0.0}, (1e-4, 1e-4)),
        (("i1", "q_m1"), "q_m1", 3e-3, {"dead": 0.3, "sag": 0.05}, (5e-4, 5e-4)),  # behind a poor driver
    ],
)
def test_a_late_channel_is_found(
    channels: tuple[str, ...], channel: str, late: float, drive: dict, within: tuple[float, float]
) -> None:
    for seed in range(3):
        (skew,) = find_skews(dataset(seed, channels=channels, late={channel: late}, **drive))
        assert skew.channel == channel and -within[0] < skew.late - late < within[1]
        assert skew.std_error < 2e-4


@pytest.mark.parametrize(
    ("seeds", "drive"),
    [
        pytest.param(20, {}, id="sound"),
        pytest.param(20, {"stiffness": 0.03}, id="soft_gear"),
        pytest.param(3, {"winding": 0.0}, id="no_inductance"),
        pytest.param(3, {"winding": 1e-3}, id="slow_winding"),
        pytest.param(3, {"delay": 3e-3}, id="late_command"),
        pytest.param(3, {"dead": 0.3, "sag": 0.05}, id="poor_driver"),
    ],
)
def test_physics_is_no_skew(seeds: int, drive: dict[str, float]) -> None:
    """Inductance, a late command, a poor driver, a soft gear with friction at its link: all the model's."""
    channels = ("q_m1", "q_a1") if "stiffness" in drive else ("i1", "q_m1", "v_m1", "q_a1")
    for seed in range(seeds):
        assert find_skews(dataset(seed, channels=channels, seeds=seeds, **drive)) == []


def test_what_is_found_is_said_removed_and_gone() -> None:
    late = dataset(0, channels=("i1", "q_m1"), late={"i1": 9e-4}, winding=0.0)
    (finding,) = [finding for finding in check_dataset(late) if finding.code == "skew"]
    assert finding.severity == "warning" and finding.channel == "i1"
    assert finding.message.startswith("i1 is recorded 0.") and "late against u1 and q_m1" in finding.message
    (skew,) = find_skews(late)
    repaired = late.without_skew({skew.channel: skew.late})
    assert find_skews(repaired) == []
    assert repaired.records[0].n_samples == late.records[0].n_samples - 1


def test_test_records_change_nothing() -> None:
    late = dataset(0, channels=("i1", "q_m1"), late={"i1": 9e-4}, winding=0.0)
    rng = np.random.default_rng(0)
    records = tuple(
        replace(r, outputs={n: rng.permutation(v) for n, v in r.outputs.items()}) if r.role == "test" else r
        for r in late.records
    )
    assert find_skews(replace(late, records=records)) == find_skews(late)


def test_a_shift_is_exact_on_a_smooth_signal_and_cuts_the_ends() -> None:
    time = 0.01 * np.arange(400)
    record = Record(
        "a", time, {"u1": np.round(time, 1)}, {"q_m1": np.sin(time), "q_a1": np.sin(time - 0.025)}
    )
    data = Dataset(
        "d", (Channel("u1", "V"),), (Channel("q_m1", "rad"), Channel("q_a1", "rad")), (record,), 0.01
    )
    shifted = data.without_skew({"q_a1": 0.025}).records[0]
    assert shifted.time[0] == 0.0 and shifted.time[-1] == pytest.approx(3.96)
    assert np.abs(shifted.outputs["q_a1"] - shifted.outputs["q_m1"])[5:].max() < 1e-5
    assert np.array_equal(shifted.inputs["u1"], record.inputs["u1"][:397])
    back = data.without_skew({"u1": -0.02}).records[0]
    assert np.allclose(back.inputs["u1"], record.inputs["u1"][:398]) and back.time[0] == pytest.approx(0.02)


def test_skew_in_a_dataset_file(tmp_path: Path) -> None:
    time = 0.01 * np.arange(300)
    rows = np.column_stack([time, np.sign(np.sin(time)), np.sin(time), np.cos(time - 0.015)])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="t,u1,q_m1,v_m1", comments="", fmt="%.12g")
    text = (
        "name: d\nsample_time: 0.01\ninputs: [{name: u1, unit: V}]\n"
        "outputs: [{name: q_m1, unit: rad}, {name: v_m1, unit: rad/s, skew: SKEW}]\nrecords: [{file: a.csv}]\n"
    )
    (tmp_path / "dataset.yaml").write_text(text.replace("SKEW", "0.015"))
    loaded = Dataset.load(tmp_path)
    assert np.abs(loaded.records[0].outputs["v_m1"] - np.cos(loaded.records[0].time))[5:].max() < 1e-5
    loaded.save(tmp_path / "again")
    again = Dataset.load(tmp_path / "again")
    assert np.array_equal(again.records[0].outputs["v_m1"], loaded.records[0].outputs["v_m1"])
    (tmp_path / "dataset.yaml").write_text(text.replace("SKEW", "15"))
    with pytest.raises(InputError, match="skew of 15 s of 'v_m1' uses up; correct the skew"):
        Dataset.load(tmp_path)
    with pytest.raises(InputError, match="no channel 'i1'"):
        loaded.without_skew({"i1": 0.001})
