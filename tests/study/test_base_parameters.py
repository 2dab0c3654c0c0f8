"""How records excite base parameters: predicted errors are those of least squares; a still joint says nothing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.robots.base_parameters import whole_regressor
from hybrid_id.study import check_base_parameters
from hybrid_id.study.base_parameters import TORQUE_ERROR
from hybrid_id.systems import one_link
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model

pytest.importorskip("mujoco")

ARM = """<mujoco><compiler angle="radian"/><option gravity="0 -9.81 0"/><worldbody>
<body name="upper"><joint name="lift" axis="0 0 1" armature="0.02"/>
<inertial mass="0.5" pos="0.2 0.01 0" diaginertia="0.001 0.001 0.002"/>
<body name="lower" pos="0.4 0 0"><joint name="elbow" axis="0 0 1" armature="0.01"/>
<inertial mass="0.3" pos="0.1 0.02 0" diaginertia="0.001 0.001 0.001"/></body></body></worldbody></mujoco>"""
STEP = 0.02
MODEL = """
robot: {file: arm.xml}
gear_ratio: [10, 5]
components: [{place: elbow/load, kind: payload, options: {point: lower}, parameters: {m_l: 0.2, x_l: 0.3}}]
"""


def arm(folder: Path) -> System:
    (folder / "arm.xml").write_text(ARM)
    (folder / "model.yaml").write_text(MODEL)
    return load_model(folder / "model.yaml")


def records(*sizes: float) -> Dataset:
    """Angles of the motors, behind gears of 10 and 5."""
    time = STEP * np.arange(400)
    outputs = {
        f"q_m{k + 1}": r * size * (np.sin((1.3 + 0.7 * k) * time) + 0.5 * np.sin((3.1 + k) * time))
        for k, (size, r) in enumerate(zip(sizes, (10.0, 5.0), strict=True))
    }
    inputs = {"tau1": 0.0 * time, "tau2": 0.0 * time}
    return Dataset(
        "arm", tuple(Channel(n, "N m") for n in inputs), tuple(Channel(n, "rad") for n in outputs),
        (Record("run", time, inputs, outputs),), STEP,
    )  # fmt: skip


def test_predicted_errors_are_those_of_least_squares(tmp_path: Path) -> None:
    found = check_base_parameters(records(0.8, 0.6), arm(tmp_path))
    texts = [found.base.text(k) for k in range(len(found.values))]
    values = dict(zip(texts, found.values, strict=True))
    payload = 0.2 * 0.3**2
    assert values["Izz_elbow"] == pytest.approx(0.001 + 0.3 * (0.1**2 + 0.02**2) + payload)
    assert values["mx_elbow"] == pytest.approx(0.3 * 0.1 + 0.2 * 0.3)
    assert values["Ia_elbow"] == pytest.approx(0.01)
    assert values["mx_lift + 0.4 m_elbow"] == pytest.approx(0.5 * 0.2 + 0.4 * 0.5)
    # the motion as it was made, torques of unit noise a joint, and least squares of them
    time = STEP * np.arange(400)
    w = np.array([[1.3, 3.1], [2.0, 4.1]])[:, :, None]
    size = np.array([0.8, 0.6])[:, None, None] * np.array([1.0, 0.5])[None, :, None]
    q, v, a = (
        (size * f).sum(1).T for f in (np.sin(w * time), w * np.cos(w * time), -(w**2) * np.sin(w * time))
    )
    system = arm(tmp_path)
    assert system.tree is not None
    columns = whole_regressor(system.tree, q, v, a)[..., list(found.base.independent)]
    torque = columns @ found.values
    own = np.eye(2) * np.sign(v)[:, :, None], np.eye(2) * v[:, :, None]
    weight = TORQUE_ERROR * np.sqrt((torque**2).mean(0))
    whole = np.concatenate([columns, *own], 2) / weight[:, None]
    whole = whole.reshape(-1, whole.shape[2])
    expected = np.sqrt(np.diag(np.linalg.inv(whole.T @ whole)))[: len(texts)]
    np.testing.assert_allclose(found.std, expected, rtol=0.05)
    scaled = whole / np.linalg.norm(whole, axis=0)
    assert found.condition_number == pytest.approx(np.linalg.cond(scaled), rel=0.05)


def test_a_base_parameter_of_large_error_is_not_called_excited(tmp_path: Path) -> None:
    found = check_base_parameters(records(0.8, 0.6), arm(tmp_path))
    known = replace(found, values=np.ones_like(found.values), std=np.full_like(found.std, 0.1))
    assert not known.unsure.any()
    doubt = replace(known, std=np.append(0.31, known.std[1:]))
    assert doubt.unsure.tolist() == [True, *[False] * (len(known.std) - 1)]
    nothing = replace(known, values=np.zeros_like(found.values))
    assert not nothing.unsure.any()  # a value of 0 has no relative error


def test_a_joint_that_stands_still_excites_no_inertia_of_its_own(tmp_path: Path) -> None:
    found = check_base_parameters(records(0.0, 0.6), arm(tmp_path))
    std = dict(zip((found.base.text(k) for k in range(len(found.values))), found.std, strict=True))
    assert np.isinf(found.condition_number)
    assert np.isinf(std["Izz_lift + Ia_lift + 0.16 m_elbow"])
    assert np.isfinite(std["mx_elbow"]) and np.isfinite(
        std["Izz_elbow"] if np.isinf(std["Ia_elbow"]) else 1.0
    )


def test_records_without_all_angles_leave_the_count(tmp_path: Path) -> None:
    data = records(0.8, 0.6)
    (run,) = data.records
    less = replace(
        data, outputs=data.outputs[:1], records=(replace(run, outputs={"q_m1": run.outputs["q_m1"]}),)
    )
    found = check_base_parameters(less, arm(tmp_path))
    assert len(found.values) == 7 and "no angle of joint 'elbow'" in found.missing
    with pytest.raises(InputError, match="belong to a robot"):
        check_base_parameters(data, one_link())
