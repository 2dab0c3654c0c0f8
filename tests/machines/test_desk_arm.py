"""The twin of a six-servo arm: its records are repeatable, within the joints' limits, and identify its values."""

from pathlib import Path

import numpy as np
import pytest

from hybrid_id.machines import desk_arm
from hybrid_id.machines.desk_arm import SPREAD, write_arm
from hybrid_id.systems.model_file import load_model

pytest.importorskip("mujoco")


def test_an_arm_is_drawn_and_moved_the_same_way_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(desk_arm, "RECORDS", 2)
    monkeypatch.setattr(desk_arm, "LENGTH", 2.0)
    (one, truth), (other, again) = (write_arm(tmp_path / name, seed=3) for name in ("one", "other"))
    assert truth == again
    for first, second in zip(one.records, other.records, strict=True):
        assert all(np.array_equal(first.signal(n), second.signal(n)) for n in (*first.inputs, *first.outputs))
    assert write_arm(tmp_path / "third", seed=4)[1] != truth
    system = load_model(tmp_path / "one" / "model.yaml")
    assert set(truth) == {system.table[k].name for k in system.estimated}
    for name, value in truth.items():
        assert 0.0 < abs(value / system.parameter(name).spec.value - 1.0) < SPREAD
    assert system.tree is not None
    for record in one.records:
        for k, joint in enumerate(system.tree.joints, 1):
            assert joint.limits[0] < record.signal(f"goal{k}").min()
            assert record.signal(f"goal{k}").max() < joint.limits[1]
