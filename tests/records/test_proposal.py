"""What a log's numbers say of time, units, signs and zeros."""

import math
from pathlib import Path

import numpy as np
import pytest

from hybrid_id.records.column_words import read_name
from hybrid_id.records.logs import Log, LogFile
from hybrid_id.records.proposal import (
    sampling,
    wrap_period,
)
from hybrid_id.records.proposed_dataset import propose

T = np.arange(0.0, 6.0, 0.005)
ANGLE = 1.2 * np.sin(1.7 * T)


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


def test_jumps_of_a_turn_and_jitter_are_seen() -> None:
    turning = np.degrees(np.mod(4.0 * T, 2 * math.pi))
    assert wrap_period([turning], "deg") == 360.0
    assert wrap_period([np.degrees(ANGLE)], "deg") == 0.0
    assert sampling([T]).value == "uniform"
    assert sampling([T + 1e-3 * np.sin(50.0 * T)]).value == "resample"


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
