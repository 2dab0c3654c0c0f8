"""What a log's numbers say of time, units, signs and zeros."""

import math

import numpy as np
import pytest

from hybrid_id.records.column_words import read_name
from hybrid_id.records.proposal import (
    JointFacts,
    angle_unit,
    drive_fit,
    sampling,
    sign_of,
    time_unit,
    wrap_period,
    zero_offset,
)

T = np.arange(0.0, 6.0, 0.005)
ANGLE = 1.2 * np.sin(1.7 * T)
ELBOW = JointFacts("elbow", -1.5, 1.5)


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_unit_of_time_by_step_and_span(factor: float, unit: str) -> None:
    guess = time_unit(factor * T)
    assert (guess.value, guess.sure) == (unit, True)


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


def test_a_zero_outside_the_range_is_asked_for() -> None:
    assert zero_offset([ANGLE], 1.0, ELBOW, "zero") is None
    guess = zero_offset([ANGLE + math.pi], 1.0, ELBOW, "zero")
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
