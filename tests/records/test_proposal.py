"""What a log's numbers say of time, units, signs and zeros."""

import math
from pathlib import Path

import numpy as np
import pytest

from hybrid_id.records.column_words import read_name
from hybrid_id.records.logs import Log, LogFile
from hybrid_id.records.proposal import (
    JointFacts,
    angle_unit,
    beyond_limits,
    drive_fit,
    goal_lag,
    goal_unit,
    sampling,
    side_by_range,
    sign_of,
    speed_unit,
    time_unit,
    wrap_period,
    zero_by_goal,
    zero_offset,
)
from hybrid_id.records.proposed_dataset import propose

T = np.arange(0.0, 6.0, 0.005)
ANGLE = 1.2 * np.sin(1.7 * T)
ELBOW = JointFacts("elbow", -1.5, 1.5)


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_unit_of_time_by_step_and_span(factor: float, unit: str) -> None:
    guess = time_unit(factor * T)
    assert (guess.value, guess.sure) == (unit, True)


def test_a_joints_name_is_no_unit() -> None:
    joints = "turn", "bend"
    assert read_name("pos_turn", joints).unit == ""
    assert read_name("pos_turn_deg", joints).unit == "deg"
    assert read_name("position_turns").unit == "rev"


@pytest.mark.parametrize(
    ("name", "kind", "command", "unit", "joint"),
    [
        ("observation.state/shoulder_pan.pos", "angle", False, "", "shoulder_pan"),
        ("action/shoulder_pan.pos", "angle", True, "", "shoulder_pan"),
        ("/joint_states/effort/elbow", "torque", False, "", "elbow"),
        ("motorVoltage", "voltage", False, "", ""),
        ("theta_deg", "angle", False, "deg", ""),
        ("vel2 [rpm]", "speed", False, "rpm", "2"),
        ("time_ms", "time", False, "ms", ""),
        ("q_m1", "angle", False, "", "1"),
        ("goal_elbow", "angle", True, "", "elbow"),
        ("i_meas (mA)", "current", False, "mA", ""),
        ("Motor Position [rev]", "angle", False, "rev", ""),
        ("torque_cmd_Ncm", "torque", True, "N cm", ""),
        ("torque_Nmm", "torque", False, "mN m", ""),
        ("velocity_mrad_s", "speed", False, "mrad/s", ""),
    ],
)
def test_what_a_name_says(name: str, kind: str, command: bool, unit: str, joint: str) -> None:
    words = read_name(name, ["shoulder_pan", "elbow"])
    assert (words.kind, words.command, words.unit, words.joint) == (kind, command, unit, joint)


@pytest.mark.parametrize(
    ("values", "joint", "unit"),
    [
        (np.degrees(ANGLE), ELBOW, "deg"),
        (ANGLE, ELBOW, "rad"),
        (np.round(ANGLE * 4096 / 2 / math.pi) + 2048, ELBOW, "counts"),
        (np.round(np.degrees(ANGLE) / (360 / 4096)) * 360 / 4096, None, "deg"),
        (np.round(ANGLE * 1024) / 1024, None, "rev"),
    ],
)
def test_unit_of_an_angle(values: np.ndarray, joint: JointFacts | None, unit: str) -> None:
    assert angle_unit([values], [T], "unit of q", joint=joint).value == unit


def test_a_span_beyond_the_range_is_degrees_and_says_how_much() -> None:
    guess = angle_unit([np.degrees(ANGLE)], [T], "unit of q", joint=ELBOW)
    assert guess.sure and "45.8 times the range of elbow" in guess.evidence


def test_a_speed_far_off_the_unit_of_its_name_is_doubted() -> None:
    assert speed_unit(1.02, 1.0, "unit of v", "rad/s").sure
    guess = speed_unit(1e-3, 1.0, "unit of v", "rad/s")
    assert not guess.sure and "0.001 times it" in guess.evidence


def test_a_zero_outside_the_range_is_asked_for() -> None:
    assert zero_offset([ANGLE], ELBOW, "zero") is None
    guess = zero_offset([ANGLE + math.pi], ELBOW, "zero")
    assert guess is not None and float(guess.value) == pytest.approx(math.pi, abs=1e-3) and not guess.sure


def test_opposed_command_and_response() -> None:
    torque = np.sin(3.0 * T) + np.sin(7.1 * T)
    speed = np.zeros_like(T)
    for k in range(1, T.size):
        speed[k] = speed[k - 1] + 0.005 * (40.0 * torque[k - 1] - 5.0 * speed[k - 1])
    angle = 0.005 * np.cumsum(speed)
    fit = drive_fit(T, torque, angle)
    assert fit is not None and fit.alpha == pytest.approx(40.0, rel=0.05)
    assert sign_of(fit, "u1", "q_m1").value == "1"
    assert sign_of(drive_fit(T, torque, -angle), "u1", "q_m1").value == "-1"


def test_jumps_of_a_turn_and_jitter_are_seen() -> None:
    turning = np.degrees(np.mod(4.0 * T, 2 * math.pi))
    assert wrap_period([turning], "deg") == 360.0
    assert wrap_period([np.degrees(ANGLE)], "deg") == 0.0
    assert sampling([T]).value == "uniform"
    assert sampling([T + 1e-3 * np.sin(50.0 * T)]).value == "resample"


def test_a_goal_beside_an_angle_in_counts_is_in_the_unit_whose_span_fits() -> None:
    counts = 2 * math.pi / 4096
    for unit, factor in {"rad": 1.0, "deg": math.pi / 180, "same": counts}.items():
        guess = goal_unit(2.2 / factor, 2.4, counts, "position", "unit of goal1")
        assert (guess.value, guess.sure) == (unit, unit == "same")
    assert not goal_unit(1e9, 2.4, counts, "position", "unit of goal1").sure  # fits none


def test_side_of_the_gear_by_the_range() -> None:
    found = side_by_range(0.6 * ELBOW.range, ELBOW, 50.0)
    assert found is not None and found[0] == "a"
    found = side_by_range(0.6 * 50.0 * ELBOW.range, ELBOW, 50.0)
    assert found is not None and found[0] == "m"
    assert side_by_range(0.6 * ELBOW.range, ELBOW, 2.0) is None  # both are possible
    assert side_by_range(1.0, JointFacts("wheel"), 50.0) is None


def test_a_goal_tells_the_zero_unless_it_has_the_same() -> None:
    goal = 1.2 * np.sin(1.7 * (T + 0.05))
    guess = zero_by_goal([ANGLE + math.pi + 0.02], [goal], 3.0, "zero")
    assert guess is not None and float(guess.value) == pytest.approx(math.pi)
    guess = zero_by_goal([ANGLE + 2.4], [goal], 3.0, "zero")
    assert guess is not None and float(guess.value) == pytest.approx(2.4, abs=0.02)
    assert zero_by_goal([ANGLE + math.pi], [goal + math.pi], 3.0, "zero") is None


def test_lag_is_the_loops_damping_over_its_stiffness() -> None:
    k_p, damping, friction, weight = 10.0, 0.6, 0.1, 0.8
    speed = 1.2 * 1.7 * np.cos(1.7 * T)
    goal = ANGLE + (damping * speed + friction * np.sign(speed) + weight * np.sin(ANGLE)) / k_p
    assert goal_lag(T, goal, ANGLE) == pytest.approx(damping / k_p, rel=0.05)
    assert goal_lag(T, ANGLE + 0.1, ANGLE) == 0.0


def test_an_angle_beyond_the_limits() -> None:
    (beyond,) = beyond_limits([1.3 * ANGLE], ELBOW)
    assert beyond.sum() == np.sum(np.abs(1.3 * ANGLE) > 1.503) > 0
    assert not beyond_limits([ANGLE], ELBOW)[0].any()


def test_a_weight_is_seen_with_the_angle_at_which_it_hangs() -> None:
    torque = np.sin(3.0 * T) + np.sin(7.1 * T)
    for weight in (30.0, 0.0):
        speed, angle = np.zeros_like(T), np.zeros_like(T)
        for k in range(1, T.size):
            pull = weight * np.sin(angle[k - 1] - 0.3)
            speed[k] = speed[k - 1] + 0.005 * (40.0 * torque[k - 1] - 5.0 * speed[k - 1] - pull)
            angle[k] = angle[k - 1] + 0.005 * speed[k]
        fit = drive_fit(T, torque, angle)
        assert fit is not None
        if weight:
            assert fit.weight > 0.3
            assert fit.gravity == pytest.approx(weight, rel=0.05) and fit.hang == pytest.approx(0.3, abs=0.02)
        else:
            assert fit.weight < 1e-3


@pytest.mark.parametrize("missing", [5, 100])
def test_gaps_of_another_topic_are_bridged_or_cut(missing: int) -> None:
    time = 0.01 * np.arange(1000)
    own = np.delete(time + 0.003, slice(300, 300 + missing))
    volts, angle = np.sin(3.0 * time), np.sin(2.0 * time)
    columns = {"/volts": time, "/volts/data/voltage": volts, "/link/position/a": angle}
    log = Log(LogFile(Path("run"), "bag"), columns, "/volts", times={"/link/position/a": own})
    found = propose([log])
    assert [one.column for one in found.outputs] == ["/link/position/a"]
    if missing == 5:
        assert found.resample and 6 < found.max_gap <= 8 and not found.between
    else:
        assert found.between[0] == (pytest.approx(4.01), time[-1]) and not found.max_gap
