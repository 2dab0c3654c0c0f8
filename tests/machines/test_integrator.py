"""The integrator against closed-form truths: steady states, stops, energy, order."""

import numpy as np
import pytest

from hybrid_id.machines.physics.bench import replay
from hybrid_id.machines.physics.friction import Coulomb, Power, Viscous
from hybrid_id.machines.physics.load import Gravity
from hybrid_id.machines.physics.machine import Drive, Machine, OneLink, TwoLinks
from hybrid_id.machines.physics.motor import Motor
from hybrid_id.machines.physics.transmission import Gear, LinearSpring

RATIO, ROTOR, LINK = 100.0, 1e-5, 0.1
J = ROTOR + LINK / RATIO**2
P_1, P_2, F_C, F_V = 0.01, 0.05, 0.005, 5e-5


def one_link(*, spring=None, laws=(), substeps=4, coulomb=F_C, motor=(P_1, P_2), viscous=F_V) -> Machine:
    drive = Drive(Gear(RATIO), ROTOR, Motor(*motor), spring=spring, link_laws=list(laws))
    drive.rotor_laws = [Coulomb(coulomb), Viscous(viscous)]
    return Machine([drive], OneLink(LINK), substeps=substeps)


def held(volts: float, samples: int = 1000, joints: int = 1) -> np.ndarray:
    return np.full((samples, joints, 1), volts)


def speeds(angles: np.ndarray, sample_time: float = 0.002) -> np.ndarray:
    return np.diff(angles[:, 0, 0]) / sample_time


def test_speed_under_constant_voltage_is_the_steady_one() -> None:
    angles = replay(one_link(), held(5.0), sample_time=0.002)
    assert speeds(angles)[-1] == pytest.approx((P_1 * 5.0 - F_C) / (P_1 * P_2 + F_V), rel=1e-9)


def test_voltage_below_breakaway_moves_nothing() -> None:
    assert np.all(replay(one_link(), held(0.99 * F_C / P_1), sample_time=0.002) == 0.0)
    assert np.any(replay(one_link(), held(1.01 * F_C / P_1), sample_time=0.002) != 0.0)


def test_dry_friction_stops_at_the_distance_of_constant_deceleration_and_stays() -> None:
    volts = held(0.0)
    machine = one_link(motor=(0.01, 0.0), viscous=0.0)
    volts[:100] = 2.0
    angles = replay(machine, volts, sample_time=0.002)[:, 0, 0]
    push = 0.01 * 2.0 - F_C
    speed, driven = push / J * 0.2, 0.5 * push / J * 0.2**2
    assert angles[100] == pytest.approx(driven, rel=1e-3)
    assert angles[-1] == pytest.approx(driven + speed**2 * J / (2 * F_C), rel=1e-3)
    assert np.ptp(angles[-50:]) == 0.0


def test_spring_and_pendulum_without_losses_keep_their_energy() -> None:
    k, weight = 40.0, 2.0
    machine = one_link(
        spring=LinearSpring(k, 0.0), laws=[Gravity(weight)], coulomb=0.0, motor=(0.0, 0.0), viscous=0.0
    )
    machine.begin(1, 2000, 0.002, np.array([[0.7]]))
    x, energies, still = machine.drives[0].x, [], np.zeros((1, 1))
    for _ in range(2000):
        twist = x.q_m / RATIO - x.q_a
        motion = 0.5 * ROTOR * x.v_m**2 + 0.5 * LINK * x.v_a**2
        energies.append(float((motion + 0.5 * k * twist**2 - weight * np.cos(x.q_a))[0]))
        machine.advance(still, still)
    swing = weight * (1 - np.cos(0.7))
    assert np.ptp(energies) < 2e-3 * swing


@pytest.mark.parametrize("moments", [(0.5, 0.1, 0.12), (0.574, 0.0616, 0.136)])
def test_free_arm_keeps_energy_and_momentum(moments: tuple[float, float, float]) -> None:
    drives = [Drive(Gear(RATIO), ROTOR, Motor(0.0, 0.0)) for _ in range(2)]
    links = TwoLinks(*moments)
    machine = Machine(drives, links, substeps=4)
    machine.begin(1, 1000, 0.002, np.array([[0.0], [0.5]]))
    drives[0].x.v_m, drives[1].x.v_m = np.array([200.0]), np.array([-300.0])
    still, energies, momenta = np.zeros((2, 1)), [], []
    for _ in range(1000):
        v = [d.x.v_m / RATIO for d in drives]
        m_11, m_12, m_22 = links.mass([d.x.q_m / RATIO for d in drives])
        rotors = ROTOR * RATIO**2
        energies.append(
            float((0.5 * ((m_11 + rotors) * v[0] ** 2 + (m_22 + rotors) * v[1] ** 2) + m_12 * v[0] * v[1])[0])
        )
        momenta.append(float(((m_11 + rotors) * v[0] + m_12 * v[1])[0]))
        machine.advance(still, still)
    assert np.ptp(energies) < 5e-3 * energies[0]
    assert np.ptp(momenta) < 5e-3 * abs(momenta[0])


@pytest.mark.parametrize(("terms", "coarse"), [("spring", 1), ("speed", 4)])
def test_error_falls_with_the_square_of_the_step(terms: str, coarse: int) -> None:
    time = 0.002 * np.arange(500 if terms == "spring" else 1000)
    volts = (6 + 5 * np.sin(12 * time))[:, None, None]

    def end(substeps: int) -> float:
        if terms == "spring":
            machine = one_link(spring=LinearSpring(40.0, 0.0), substeps=substeps)
        else:
            machine = one_link(laws=[Power(0.02, on_link=True)], coulomb=0.0, substeps=substeps)
            machine.drives[0].gear = Gear(RATIO, errors=[2e-3], periods=[1.0], phases=[0.3])
        return float(replay(machine, volts, sample_time=0.002)[-1, 0, 0])

    truth = end(64)
    assert 3.0 < abs(end(coarse) - truth) / abs(end(2 * coarse) - truth) < 5.5


def test_lanes_do_not_feel_each_other() -> None:
    time = 0.002 * np.arange(300)
    volts = np.stack([5 * np.sin(8 * time), 9 * np.cos(5 * time)], axis=-1)[:, None, :]
    together = replay(one_link(), volts, sample_time=0.002)
    alone = [replay(one_link(), volts[..., b : b + 1], sample_time=0.002) for b in (0, 1)]
    assert np.array_equal(together, np.concatenate(alone, axis=-1))


def test_machine_settles_before_its_record() -> None:
    machine = one_link(laws=[Gravity(2.0, 0.4)], coulomb=1e-3)
    angles = replay(machine, held(0.0, 60), sample_time=0.002)
    assert np.ptp(angles) < 1e-3  # rad of the rotor; a shorted motor brakes for ever
    assert angles[0, 0, 0] / RATIO == pytest.approx(0.4, abs=0.06)  # where friction holds it


@pytest.mark.parametrize("coulomb", [F_C, 0.1])
def test_a_link_behind_a_spring_settles_too(coulomb: float) -> None:
    k, weight = 40.0, 2.0
    machine = one_link(spring=LinearSpring(k, 0.05), laws=[Gravity(weight, 0.4)], coulomb=coulomb)
    assert np.ptp(replay(machine, held(0.0, 300), sample_time=0.002)) < 1e-4 * RATIO
    link = machine.drives[0].x
    twist = float((link.q_a - link.q_m / RATIO)[0])
    assert k * twist == pytest.approx(-weight * np.sin(float(link.q_a[0]) - 0.4), rel=1e-3)
    rest = np.array([[float(link.q_m[0]) / RATIO]])
    replayed = replay(machine, held(0.0, 300), sample_time=0.002, start=rest)
    assert np.ptp(replayed) < 1e-4 * RATIO, "from angles that are given the link is as wound up as it was"
