"""The two-link arm of the paper's eq. (13)-(14): mass matrix, energy, other engines, sticking of two joints at once."""

import numpy as np
import pytest
import torch
from drives import STEP, run, stored
from hypothesis import given, settings
from hypothesis import strategies as st
from machines.scipy_reference import integrate_scipy

from hybrid_id.components import (
    Backlash,
    Coulomb,
    JointCoupling,
    KinematicError,
    LinearSpring,
)
from hybrid_id.errors import InputError
from hybrid_id.machines.physics import friction
from hybrid_id.machines.physics.machine import Drive, Machine, TwoLinks
from hybrid_id.machines.physics.motor import Motor
from hybrid_id.machines.physics.stick_slip import StickSlip
from hybrid_id.machines.physics.transmission import Gear
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link, two_link

RATIO = (156.0, 84.0)
TABLE_10 = {"P_1": 1.101, "P_2": 0.136, "P_3": 0.148, "P_4": 0.068}
MOTORS = {"P_m1m1": 0.019059, "P_m2m1": 0.0254, "P_m1m2": 0.04262, "P_m2m2": 0.0107}
FRICTION = {"F_cm1": 0.011, "F_vm1": 5e-5, "F_cm2": 0.0024, "F_vm2": 2e-5}
NO_FRICTION = dict.fromkeys(FRICTION, 0.0)
COASTING = NO_FRICTION | {"P_m1m1": 1e-9, "P_m1m2": 1e-9, "P_m2m1": 0.0, "P_m2m2": 0.0}


def arm(values: dict | None = None, ratio=RATIO, *, vertical: bool = False) -> System:
    return two_link(ratio, vertical=vertical).with_values(TABLE_10 | MOTORS | FRICTION | (values or {}))


def mass(system: System, angle: float) -> np.ndarray:
    """Mass matrix at the links, from the accelerations that unit torques cause at rest."""
    free = system.without_component("joint1/motor_friction", "coulomb_friction")
    free = free.without_component("joint2/motor_friction", "coulomb_friction")
    free = free.with_values({"P_m1m1": 1.0, "P_m1m2": 1.0, "P_m2m1": 0.0, "P_m2m2": 0.0})
    r = np.array(system.gear_ratio)
    x = [torch.tensor([v], dtype=torch.float64) for v in (0.0, 0.0, angle * r[1], 0.0)]
    columns = []
    for k in range(2):
        u = {f"u{n + 1}": torch.tensor([float(n == k)], dtype=torch.float64) for n in range(2)}
        rates = free.rates(x, u, free.views(list(stored(free))))
        columns.append([rates[row].item() / ratio for row, ratio in zip((1, 3), r, strict=True)])
    return np.linalg.inv(np.array(columns).T / r)


@given(angle=st.floats(-7.0, 7.0))
@settings(max_examples=20)
def test_mass_matrix_of_eq_14(angle: float) -> None:
    c = np.cos(angle)
    expected = [[1.101 + 2 * 0.148 * c, 0.068 + 0.148 * c], [0.068 + 0.148 * c, 0.136]]
    np.testing.assert_allclose(mass(arm(), angle), expected, rtol=1e-9)


positive = st.floats(1e-3, 10.0)


@given(p=st.tuples(positive, positive, st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)))
@settings(max_examples=60)
def test_mass_matrix_is_positive_definite_for_every_angle_or_refused(p) -> None:
    p_1, p_2, p_3, p_4 = p
    c = np.cos(np.linspace(0.0, np.pi, 181))
    least = np.min((p_1 + 2 * p_3 * c) * p_2 - (p_4 + p_3 * c) ** 2)
    if abs(least) < 1e-9:
        return
    bare = two_link(RATIO).without_component("joint1/load", "joint_coupling")
    bare = bare.with_values({"P_1": p_1, "P_2": p_2})
    if least > 0:
        bare.with_component("joint1/load", JointCoupling(P_3=p_3, P_4=p_4))
        return
    with pytest.raises(InputError, match=r"not positive definite for every angle.*P_3 = ") as caught:
        bare.with_component("joint1/load", JointCoupling(P_3=p_3, P_4=p_4))
    assert "\n" not in str(caught.value)


def test_fit_cannot_step_where_the_mass_matrix_is_indefinite() -> None:
    system = arm()
    theta = stored(system, 3)
    theta[[i.name for i in system.table].index("P_4"), 1] = 0.4
    x = [torch.full((3,), v, dtype=torch.float64) for v in (0.0, 1.0, 0.0, 2.0)]
    u = {"u1": torch.ones(3, dtype=torch.float64), "u2": torch.ones(3, dtype=torch.float64)}
    after = Engine().sample(system, x, u, torch.full((3,), STEP), system.views(list(theta)))
    assert torch.isfinite(after[1]).tolist() == [True, False, True]


def test_couplings_need_two_joints_and_are_there_once() -> None:
    with pytest.raises(InputError, match="couples two joints, but the system has 1"):
        one_link().with_component("joint1/load", JointCoupling())
    with pytest.raises(InputError, match="sits at both joints"):
        arm().with_component("joint2/load", JointCoupling())


def test_arm_without_coupling_is_two_links() -> None:
    apart = arm().without_component("joint1/load", "joint_coupling")
    k = np.arange(300)
    u = {"u1": 8.0 * np.sin(0.05 * k), "u2": 3.0 * np.cos(0.07 * k)}
    together = run(apart, u)
    for n, r, voltage in ((1, RATIO[0], u["u1"]), (2, RATIO[1], u["u2"])):
        values = (MOTORS | FRICTION) | {"P_1": 1.101, "P_2": 0.136}
        named = {"J": values[f"P_{n}"] / r**2, "P_m1": values[f"P_m1m{n}"], "P_m2": values[f"P_m2m{n}"]}
        named |= {"F_c": values[f"F_cm{n}"], "F_v": values[f"F_vm{n}"]}
        alone = run(one_link(r).with_values(named), {"u1": voltage})
        np.testing.assert_allclose(together[f"q_m{n}"], alone["q_m1"], atol=1e-6)
    zero = apart.with_component("joint1/load", JointCoupling())
    np.testing.assert_allclose(run(zero, u)["q_m2"], together["q_m2"], rtol=1e-9, atol=1e-12)


LENGTH, MASS, CENTRE, OWN = (0.4, 0.3), (1.5, 1.0), (0.22, 0.16), (0.03, 0.012)


def mujoco_arm(armature, damping, gravity: bool):
    mujoco = pytest.importorskip("mujoco", reason="needs the physics engine of the extra 'blind'")
    body = (
        '<body pos="{pos}"><joint name="j{n}" type="hinge" axis="0 -1 0" armature="{armature}" damping="{damping}"/>'
        '<inertial mass="{mass}" pos="0 0 {z}" diaginertia="{i} {i} {i}"/>{child}</body>'
    )
    inner = ""
    for n in (1, 0):
        inner = body.format(
            pos=f"0 0 {-LENGTH[0] if n else 0.0}", n=n, armature=armature[n], damping=damping[n], mass=MASS[n],
            z=-CENTRE[n], i=OWN[n], child=inner,
        )  # fmt: skip
    actuators = "".join(f'<motor joint="j{n}"/>' for n in range(2))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="0.0002" integrator="RK4" gravity="0 0 {-9.81 * gravity}"/>'
        f"<worldbody>{inner}</worldbody><actuator>{actuators}</actuator></mujoco>"
    )
    return mujoco, model


@pytest.mark.parametrize("driven", [False, True], ids=["free", "driven"])
@pytest.mark.parametrize("vertical", [False, True], ids=["horizontal", "vertical"])
def test_agrees_with_mujoco(driven: bool, vertical: bool) -> None:
    ratio, rotor = np.array([50.0, 30.0]), np.array([2e-5, 1e-5])
    armature = rotor * ratio**2
    p_4 = OWN[1] + MASS[1] * CENTRE[1] ** 2
    values = {
        "P_1": OWN[0] + MASS[0] * CENTRE[0] ** 2 + MASS[1] * LENGTH[0] ** 2 + p_4 + armature[0],
        "P_2": p_4 + armature[1],
        "P_3": MASS[1] * LENGTH[0] * CENTRE[1],
        "P_4": p_4,
    }
    values |= {"F_cm1": 0.0, "F_cm2": 0.0} | (MOTORS if driven else COASTING)
    if vertical:
        values |= {
            "G_l1": 9.81 * (MASS[0] * CENTRE[0] + MASS[1] * LENGTH[0]),
            "G_l2": 9.81 * MASS[1] * CENTRE[1],
        }
    system = two_link((50.0, 30.0), vertical=vertical).with_values(values)
    get = {info.name: info.spec.value for info in system.table}
    gain = np.array([get["P_m1m1"], get["P_m1m2"]])
    loss = gain * [get["P_m2m1"], get["P_m2m2"]] + [get["F_vm1"], get["F_vm2"]]
    mujoco, model = mujoco_arm(armature, ratio**2 * loss, vertical)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = (0.5, -1.1), ((0.0, 0.0) if driven else (1.5, -3.0))
    k = np.arange(400)
    u = np.stack([6.0 * np.sin(0.06 * k), 2.5 * np.cos(0.043 * k)], 1) * driven
    start = dict(zip(("q_m1", "v_m1", "q_m2", "v_m2"), np.stack([data.qpos * ratio, data.qvel * ratio], 1).ravel(),
                     strict=True))  # fmt: skip
    x = run(system, {"u1": u[:, 0], "u2": u[:, 1]}, start=start, engine=Engine(substeps=2))
    reference = []
    for voltage in u:
        reference.append(data.qpos.copy())
        data.ctrl[:] = ratio * gain * voltage
        for _ in range(10):
            mujoco.mj_step(model, data)
    found = np.stack([x["q_m1"], x["q_m2"]], 1) / ratio
    assert np.ptp(reference, axis=0).min() > 0.15
    np.testing.assert_allclose(found, np.array(reference), atol=2e-6)


def coupled(ratio=(20.0, 15.0), **values: float) -> System:
    """An arm light enough for each joint to be dragged by the other."""
    strong = {"P_1": 0.6, "P_2": 0.2, "P_3": 0.12, "P_4": 0.15, "F_cm1": 0.02, "F_cm2": 0.012}
    return arm(strong | values, ratio)


def values_of(system: System) -> dict[str, float]:
    return {info.name: info.spec.value for info in system.table}


def twin_of(system: System) -> StickSlip:
    v, r = values_of(system), system.gear_ratio
    rotors = (0.0, (v["P_2"] - v["P_4"]) / r[1] ** 2)
    drives = [Drive(Gear(r[n - 1]), rotors[n - 1], Motor(v[f"P_m1m{n}"], v[f"P_m2m{n}"])) for n in (1, 2)]
    for n, drive in enumerate(drives, start=1):
        drive.rotor_laws = [friction.Coulomb(v[f"F_cm{n}"]), friction.Viscous(v[f"F_vm{n}"])]
    return StickSlip(Machine(drives, TwoLinks(v["P_1"], v["P_4"], v["P_3"])))


def test_stick_and_slip_agree_with_scipy() -> None:
    system = coupled()
    k = np.arange(250)
    u = np.stack([2.4 * np.sin(0.06 * k), 0.9 * np.sin(0.11 * k) * (k > 60)], 1)
    exact = integrate_scipy(
        twin_of(system), np.zeros(4), np.concatenate([u, 0 * u], 1), STEP * k, rtol=1e-9, atol=1e-11
    )
    resting = exact[:, 1::2] == 0
    assert (resting.sum(0) > 10).all() and (np.diff(np.sign(exact[:, 1::2]), axis=0) != 0).sum() > 8
    gaps = []
    for substeps in (1, 4):
        x = run(system, {"u1": u[:, 0], "u2": u[:, 1]}, engine=Engine(substeps=substeps))
        found = np.stack([x[name] for name in system.state_names], 1)
        gaps.append(np.abs(found - exact).max(0) / np.ptp(exact, axis=0))
    assert gaps[0].max() < 1e-4, gaps
    assert gaps[1].max() < 5e-6, gaps
    assert ((found[:, 1::2] == 0) == resting).mean() > 0.98


def test_spring_in_one_joint_of_the_arm_tends_to_the_rigid_one() -> None:
    k = np.arange(100)
    u = {"u1": 8.0 * np.sin(0.05 * k), "u2": 3.0 * np.cos(0.07 * k) - 3.0}
    rigid = run(arm(), u)
    for n in (1, 2):
        stiff = arm().with_component(f"joint{n}/transmission", LinearSpring(k=1e5, d=30.0))
        assert f"q_a{n}" in stiff.state_names
        x = run(stiff, u, engine=Engine(substeps=10))
        for name in ("q_m1", "q_m2"):
            assert np.abs(x[name] - rigid[name]).max() < 3e-3 * np.ptp(rigid[name])
    both = arm()
    for n in (1, 2):
        both = both.with_component(f"joint{n}/transmission", Backlash()).with_component(
            f"joint{n}/link_friction", Coulomb(F_c=1e-3)
        )
    x = run(both, u, engine=Engine(substeps=8))
    assert np.abs(x["q_m1"] - rigid["q_m1"]).max() < 0.01 * np.ptp(rigid["q_m1"])


def test_rotor_share_that_leaves_the_links_too_light_is_refused() -> None:
    heavy = arm({"P_3": 0.2})
    with pytest.raises(InputError, match="the links' own"):
        heavy.with_values({"rotor_share1": 0.9}).with_component("joint1/transmission", LinearSpring())


def test_errors_of_both_gears_against_the_lagrangian_of_the_arm() -> None:
    ratio, share, volts = (20.0, 30.0), 0.4, (1.5, -2.0)
    errors = [(4e-3, -3e-3, 1.0), (2e-3, 1e-3, 2.0)]  # E_c, E_s, n
    system = arm(NO_FRICTION, ratio)
    for k, (e_c, e_s, n) in enumerate(errors, 1):
        system = system.without_component(f"joint{k}/motor_friction", "coulomb_friction")
        system = system.with_component(f"joint{k}/transmission", KinematicError(E_c=e_c, E_s=e_s, n=n))
    system = system.with_values({info.name: share for info in system.table if info.symbol == "rotor_share"})
    q, v = torch.tensor([2.0, 17.0]).double(), torch.tensor([90.0, -60.0]).double()
    rotors = [share * TABLE_10[f"P_{k + 1}"] / ratio[k] ** 2 for k in range(2)]

    def energy(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        links = torch.stack(
            [
                q[k] / ratio[k] + c * (torch.cos(n * q[k]) - 1) + s * torch.sin(n * q[k])
                for k, (c, s, n) in enumerate(errors)
            ]
        )
        slopes = [
            1 / ratio[k] + n * (s * torch.cos(n * q[k]) - c * torch.sin(n * q[k]))
            for k, (c, s, n) in enumerate(errors)
        ]
        w = torch.stack([slopes[k] * v[k] for k in range(2)])
        swing = TABLE_10["P_3"] * torch.cos(links[1])
        m_11, m_12 = (1 - share) * TABLE_10["P_1"] + 2 * swing, TABLE_10["P_4"] + swing
        moving = m_11 * w[0] ** 2 + 2 * m_12 * w[0] * w[1] + (1 - share) * TABLE_10["P_2"] * w[1] ** 2
        return 0.5 * (moving + rotors[0] * v[0] ** 2 + rotors[1] * v[1] ** 2)

    by_angle = torch.autograd.functional.jacobian(energy, (q, v))[0]
    mixed, inertia = torch.autograd.functional.hessian(energy, (q, v))[1]
    torque = torch.tensor(
        [
            MOTORS[f"P_m1m{k}"] * (u - MOTORS[f"P_m2m{k}"] * v[k - 1])
            for k, u in zip((1, 2), volts, strict=True)
        ]
    )
    expected = torch.linalg.solve(inertia, torque.double() - mixed @ v + by_angle)
    x = [value[None] for pair in zip(q, v, strict=True) for value in pair]
    u = {f"u{k}": torch.tensor([one]).double() for k, one in zip((1, 2), volts, strict=True)}
    rates = system.rates(x, u, system.views(list(stored(system))))
    np.testing.assert_allclose([rates[1].item(), rates[3].item()], expected.numpy(), rtol=1e-9)


@pytest.mark.parametrize("vertical", [False, True])
def test_energy_is_kept_without_friction_and_motors(vertical: bool) -> None:
    ratio = (10.0, 7.0)
    system = arm(COASTING, ratio, vertical=vertical)
    start = {"q_m1": 8.0, "v_m1": 25.0, "q_m2": -6.0, "v_m2": -30.0}
    drift = []
    for substeps in (1, 2, 4):
        x = run(
            system, {"u1": np.zeros(200), "u2": 0.0}, step=0.01, start=start, engine=Engine(substeps=substeps)
        )
        (q_1, q_2), (v_1, v_2) = ((x[f"{s}1"] / ratio[0], x[f"{s}2"] / ratio[1]) for s in ("q_m", "v_m"))
        c = np.cos(q_2)
        energy = (
            0.5 * (1.101 + 2 * 0.148 * c) * v_1**2 + (0.068 + 0.148 * c) * v_1 * v_2 + 0.5 * 0.136 * v_2**2
        )
        energy = energy - (10.0 * np.cos(q_1) + 3.0 * np.cos(q_1 + q_2) if vertical else 0.0)
        drift.append(np.abs(energy - energy[0]).max() / np.ptp(0.5 * v_1**2))
    assert drift[0] / drift[1] > 12 and drift[1] / drift[2] > 12, drift
    assert drift[2] < 1e-5
    assert np.ptp(q_2) > 2.0
