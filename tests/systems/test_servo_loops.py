"""Position loops with an integral, a rate limit and dead time: exact solutions, both engines, gradients, recovery."""

import numpy as np
import pytest
import torch
from scipy.linalg import expm

from hybrid_id.components.friction.coulomb import Coulomb
from hybrid_id.components.input.delay import Delay
from hybrid_id.components.input.goal_rate_limit import GoalRateLimit
from hybrid_id.components.input.loop_delay import LoopDelay
from hybrid_id.components.input.position_loop import PositionLoop
from hybrid_id.components.input.position_servo import PositionServo
from hybrid_id.components.input.servo_integral import ServoIntegral
from hybrid_id.components.input.torque_command import TorqueCommand
from hybrid_id.components.load.constant_torque import ConstantTorque
from hybrid_id.components.load.gravity import Gravity
from hybrid_id.components.motor.torque_motor import TorqueMotor
from hybrid_id.components.sensor.unsigned_current import UnsignedCurrent
from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.c_code import compiler
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.simulation.step import Engine
from hybrid_id.study import identify
from hybrid_id.systems import one_link

STEP = 0.002
J, F_V, K_P, K_D = 0.02, 0.1, 8.0, 0.15


def servo(dry=0.0, **limits):
    """A servo at its joint: J a = k_p e' - k_d v - F_v v - F_c sgn v."""
    system = one_link(1.0).with_component("joint1/input", PositionServo(k_p=K_P, k_d=K_D, **limits))
    system = system.with_component("joint1/motor", TorqueMotor())
    return system.with_values({"J": J, "F_c": dry, "F_v": F_V})


def run(system, goal, engine, start=0.0, step=STEP):
    time = step * np.arange(len(goal))
    record = Record("r", time, {"goal1": np.asarray(goal, float)}, {"q_m1": np.full(len(goal), start)})
    return simulate(system, engine, make_batch(system, [record], noise_std={"q_m1": 1.0}))


def steps(count=400):
    goal = np.zeros(count)
    goal[5:] = 0.4
    goal[count // 2 :] = -0.3
    return goal


def linear(matrix, at_goal, goal, x0, step=STEP):
    """States of x' = A x + b goal, goal held between samples, by the matrix exponential."""
    n = len(matrix)
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n] = matrix, at_goal
    phi, x, found = expm(step * whole), np.array(x0, float), []
    for one in goal:
        found.append(x)
        x = (phi @ np.append(x, one))[:n]
    return np.array(found)


def test_an_integral_is_the_linear_loop_of_three_states() -> None:
    w_i, goal = 6.0, steps()
    system = servo().with_component("joint1/input", ServoIntegral(w_i=w_i, z_max=100.0))
    matrix = [[0, 1, 0], [-K_P / J, -(K_D + F_V) / J, K_P / J], [-w_i, 0, 0]]
    exact = linear(matrix, [0, K_P / J, w_i], goal, [0.0, 0.0, 0.0])
    apart = [
        np.abs(run(system, goal, Engine("dry", n)).x[0].numpy() - exact).max() / np.abs(exact[:, 0]).max()
        for n in (1, 2, 4)
    ]
    assert apart[2] < 1e-4
    assert np.log2(apart[0] / apart[1]) == pytest.approx(
        2.0, abs=0.2
    )  # of second order, as all that remembers


def test_dead_time_in_the_loop_is_its_pade_approximant() -> None:
    delay, goal = 0.006, steps()
    system = servo().with_component("joint1/input", LoopDelay(T_l=delay))
    # y = q + z, y' = -v - 2 z / T, z' = -2 v - 2 z / T
    matrix = [
        [0, 1, 0],
        [-K_P / J, (K_D - F_V) / J, (-K_P + 2 * K_D / delay) / J],
        [0, -2, -2 / delay],
    ]
    exact = linear(matrix, [0, K_P / J, 0], goal, [0.0, 0.0, 0.0])
    found = [run(system, goal, Engine("dry", n)).x[0].numpy() for n in (4, 8)]
    apart = [np.abs(one - exact)[:, 0].max() for one in found]
    assert apart[1] < 2e-4
    assert np.log2(apart[0] / apart[1]) == pytest.approx(2.0, abs=0.3)


def test_a_rate_limit_makes_ramps_of_steps() -> None:
    goal, w_max = steps(), 2.0
    system = servo().with_component("joint1/input", GoalRateLimit(w_max=w_max))
    found = run(system, goal, Engine("dry", 3))
    ramp, g = [], 0.0
    for one in goal:
        ramp.append(g)
        g += np.clip(one - g, -w_max * STEP, w_max * STEP)
    row = system.state_names.index("followed1")
    np.testing.assert_allclose(found.x[0, :, row], ramp, atol=1e-12)
    # the loop follows the ramp: against the exact answer to a goal that is held for a fiftieth of a sample
    dense = np.interp(STEP / 50 * np.arange(50 * len(goal)), STEP * np.arange(len(goal)), ramp)
    matrix = [[0, 1], [-K_P / J, -(K_D + F_V) / J]]
    exact = linear(matrix, [0, K_P / J], dense, [0.0, 0.0], STEP / 50)[::50, 0]
    np.testing.assert_allclose(found.y[0, :, 0], exact, atol=2e-4)


def test_an_integral_stops_at_its_limit() -> None:
    """Against a weight of 1 N m that is more than k_p z_max holds, the joint settles where the gains hold the rest."""
    system = servo().with_component("joint1/load", ConstantTorque(T_0=1.0))
    system = system.with_component("joint1/input", ServoIntegral(w_i=20.0, z_max=0.05))
    found = run(system, np.zeros(3000), Engine("dry", 2))
    assert found.x[0, -1, 2] == 0.05
    assert float(found.y[0, -1, 0]) == pytest.approx(-(1.0 / K_P - 0.05), abs=1e-6)


def test_a_record_at_rest_begins_with_the_integral_that_holds_its_load() -> None:
    system = servo(dry=0.1).with_component("joint1/load", Gravity(G_l=1.5))
    system = system.with_component("joint1/input", ServoIntegral(w_i=5.0))
    found = run(system, np.full(300, 0.6), Engine("dry", 2), start=0.6)
    assert float(found.x[0, 0, 2]) == pytest.approx(1.5 * np.sin(0.6) / K_P, rel=1e-6)
    np.testing.assert_allclose(found.y[0, :, 0], 0.6, atol=1e-12)
    batch = make_batch(
        system,
        [Record("r", STEP * np.arange(50), {"goal1": np.full(50, 0.6)}, {"q_m1": np.full(50, 0.6)})],
        noise_std={"q_m1": 1e-4},
    )
    assert float(batch.x0_std[0, 2]) == pytest.approx(0.1 / K_P + 0.1 * 1.5 * np.sin(0.6) / K_P, rel=1e-6)


@pytest.mark.parametrize(
    "stage", [ServoIntegral(w_i=0.0), GoalRateLimit(w_max=1e9), ServoIntegral(w_i=3.0, z_max=0.0)]
)
def test_a_stage_that_does_nothing_changes_no_bit(stage) -> None:
    plain = servo(dry=0.05, tau_max=2.0, e_0=0.003)
    found = run(plain.with_component("joint1/input", stage), steps(), Engine("dry", 2))
    torch.testing.assert_close(found.y, run(plain, steps(), Engine("dry", 2)).y, rtol=0, atol=0)


def whole(dry=0.05):
    system = servo(dry=dry, tau_max=2.0, e_0=0.002)
    for stage in (
        ServoIntegral(w_i=4.0, z_max=0.1),
        GoalRateLimit(w_max=3.0),
        LoopDelay(T_l=0.004),
        Delay(T_d=0.005),
    ):
        system = system.with_component("joint1/input", stage)
    return system


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
def test_both_engines_agree() -> None:
    plain, fast = (run(whole(), steps(), Engine("dry", 2, compiled=c)) for c in (False, True))
    np.testing.assert_allclose(fast.x.numpy(), plain.x.numpy(), atol=1e-12)


def test_a_position_loop_of_duty_takes_the_same_stages() -> None:
    """U = clip(c gain (g - q + z), -1, 1) supply."""
    system = one_link(100.0).with_component("joint1/input", PositionLoop())
    system = system.with_component("joint1/input", ServoIntegral(w_i=2.0))
    x = [torch.tensor([v], dtype=torch.float64) for v in (0.3, 0.0, 0.05)]
    u = {
        n: torch.tensor([v], dtype=torch.float64)
        for n, v in (("goal1", 0.5), ("gain1", 400.0), ("supply1", 12.0))
    }
    p = system.views([value[None] for value in system.theta().detach()])
    duty = float(system.parameter("duty_per_rad").spec.value) * 400.0 * (0.2 + 0.05)
    assert float(system.joints[0].drive.command(x, u, p)) == pytest.approx(12.0 * duty)


def test_an_ode_solver_meets_the_same_loop() -> None:
    system = servo().with_component("joint1/input", ServoIntegral(w_i=4.0, z_max=0.1))
    system = system.with_component("joint1/input", GoalRateLimit(w_max=3.0))
    here = run(system, steps(80), Engine("dry", 8)).y
    there = run(system, steps(80), OdeEngine(substeps=8, fine=8, width=0.5)).y
    assert float((here - there).abs().max()) < 3e-3


def test_a_servo_with_all_parts_is_recovered() -> None:
    """True values from goals and angles of a loop that its motor damps, from starts that are 30 % off."""
    system = servo(dry=0.05, tau_max=2.0).with_values({"k_d": 0.0, "F_v": 0.25})
    for stage in (ServoIntegral(w_i=8.0, z_max=0.5), GoalRateLimit(w_max=4.0), LoopDelay(T_l=0.006)):
        system = system.with_component("joint1/input", stage)
    held = {"k_p": system.parameter("k_p").spec}
    truth = system.with_specs({n: Bounded(s.value, s.lower, s.upper, s.unit, False) for n, s in held.items()})
    engine = Engine("dry", 4, compiled=compiler() is not None)
    rng, noise, records, time = np.random.default_rng(2), 1e-5, [], 0.004 * np.arange(400)
    for number in range(3):
        goal = np.repeat(rng.uniform(-0.8, 0.8, 8), 50)
        goal[:20] = 0.0
        blank = Record(f"r{number}", time, {"goal1": goal}, {"q_m1": 0.0 * time})
        batch = make_batch(truth, [blank], noise_std={"q_m1": 1.0})
        y = simulate(truth, engine, batch).y[0, :, 0].numpy() + noise * rng.standard_normal(400)
        records.append(
            Record(blank.name, time, blank.inputs, {"q_m1": y}, role="train" if number < 2 else "test")
        )
    data = Dataset("servo", (Channel("goal1", "rad"),), (Channel("q_m1", "rad", noise),), tuple(records))
    free = {i.name: i.spec.value for i in truth.table if i.spec.estimate}
    assert {"w_i", "w_max", "T_l", "J", "F_v", "F_c"} <= set(free)
    start = truth.with_values({name: 1.3 * value for name, value in free.items()})
    found = identify(data, start, engine=engine, pooled=True).selected.system
    for name, value in free.items():
        assert found.parameter(name).spec.value == pytest.approx(value, rel=0.02), name


def test_a_servo_reads_the_size_of_its_torque_over_the_torque_constant() -> None:
    system = servo().with_component("joint1/motor", TorqueMotor(k_t=2.0))
    system = system.with_component("joint1/sensor", UnsignedCurrent(i_0=0.05))
    goal = steps(200)
    record = Record(
        "r", STEP * np.arange(200), {"goal1": goal}, {"q_m1": np.zeros(200), "i1": np.full(200, 0.05)}
    )
    run = simulate(system, Engine("dry", 2), make_batch(system, [record], noise_std={"q_m1": 1.0, "i1": 1.0}))
    q, v = run.x[0, :, 0].numpy(), run.x[0, :, 1].numpy()
    np.testing.assert_allclose(run.y[0, :, 1], np.abs(K_P * (goal - q) - K_D * v) / 2.0 + 0.05, rtol=1e-9)
    assert (run.y[0, :, 1] > 0.1).any()


def test_a_stage_without_a_position_loop_is_refused() -> None:
    system = one_link(1.0).with_component("joint1/input", TorqueCommand())
    system = system.with_component("joint1/motor", TorqueMotor())
    system = system.with_component("joint1/input", ServoIntegral())
    time = STEP * np.arange(20)
    with pytest.raises(
        InputError, match="belongs to a position loop, which torque_command is not; put position_loop"
    ):
        make_batch(system, [Record("r", time, {"tau1": 0 * time}, {"q_m1": 0 * time})])
    assert Coulomb.kind in str(list(system.components))


def test_gradients_are_those_of_finite_differences() -> None:
    system = whole()
    goal = 0.3 * np.sin(np.arange(60) * STEP * 14.0) + 0.1
    record = Record("r", STEP * np.arange(60), {"goal1": goal}, {"q_m1": 0.0 * goal + 0.05})
    batch = make_batch(system, [record], noise_std={"q_m1": 1.0})
    engine, theta = Engine("dry", 2), system.theta().detach()

    def end(values):
        """States after all samples, of one lane a column of values."""
        x = [row.expand(values.shape[1]) for row in batch.x[:, 0].unbind(1)]
        p = system.views(list(values))
        for k in range(59):
            u = {n: c[:, k].expand(values.shape[1]) for n, c in batch.u.items()}
            x = engine.sample(system, x, u, batch.dt[:, k].expand(values.shape[1]), p)
        return torch.stack(x)

    exact = torch.as_tensor(torch.autograd.functional.jacobian(lambda t: end(t[:, None])[:, 0], theta))
    names = [info.name for info in system.table]
    assert float(exact[0].abs()[names.index("w_i")]) > 0
    h = 1e-6 * theta.abs().clamp_min(1e-3)
    with torch.no_grad():
        ahead, back = end(theta[:, None] + torch.diag(h)), end(theta[:, None] - torch.diag(h))
    slopes = (ahead - back) / (2.0 * h)
    for k, name in enumerate(names):
        if name in ("rotor_share", "gain"):
            continue
        slope = slopes[:, k]
        np.testing.assert_allclose(
            exact[:, k], slope, rtol=1e-4, atol=1e-6 * float(slope.abs().max()) + 1e-8, err_msg=name
        )
