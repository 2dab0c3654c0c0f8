"""Start values of one link without a robot: what a servo's name and the lag of its goal say."""

import pytest

from hybrid_id.records.proposal import DriveFit
from hybrid_id.records.proposal_parts import DriveFacts, MotorSheet
from hybrid_id.systems.proposed_model import REGISTER, ProposedModel, propose_model
from hybrid_id.systems.servos import SERVOS, drive_of

FIT = DriveFit(alpha=1600.0, beta=200.0, gamma=0.1, partial=0.9, explained=0.9)


def proposed(sheet: MotorSheet, command: str = "goal", fit: DriveFit | None = FIT, lag: float = 0.0):
    return propose_model([DriveFacts("the drive", 1, command, "a", fit, lag)], sheet)


def loop(model: ProposedModel) -> dict[str, dict]:
    return model.values["components"][0]["parameters"]


def test_a_servo_by_name_is_used_without_a_robot() -> None:
    known, _ = drive_of(SERVOS["sts3215"], 32.0, 1.0, 7.4)
    model = proposed(MotorSheet(servo="sts3215", p=32.0, voltage=7.4))
    stiffness, top = (known.specs[name].value for name in ("k_p", "tau_max"))
    assert loop(model)["k_p"]["nominal"] == pytest.approx(stiffness, rel=0.01)
    assert loop(model)["tau_max"]["nominal"] == pytest.approx(top, rel=0.01)
    found = {name: entry["nominal"] for name, entry in model.values["parameters"].items()}
    assert found["J"] == pytest.approx(stiffness / 1600.0, rel=0.01)
    assert found["F_v"] / found["J"] == pytest.approx(200.0, rel=0.01)
    assert loop(model)["k_p"]["prior_std"] and "How stiff" not in str(model.questions)


def test_a_register_that_is_not_known_is_asked_for() -> None:
    model = proposed(MotorSheet(servo="xl330_m288"))
    known, _ = drive_of(SERVOS["xl330_m288"], REGISTER)
    assert loop(model)["k_p"] == {
        "nominal": pytest.approx(known.specs["k_p"].value, rel=0.01),
        "unit": "N m/rad",
    }
    assert "What does the register P of the servos hold?" in str(model.questions)


def test_the_lag_of_a_goal_is_a_start_where_the_acceleration_gives_none() -> None:
    for sheet in (MotorSheet(), MotorSheet(servo="sts3215", p=16.0), MotorSheet(gear_ratio=20.0)):
        model = proposed(sheet, fit=None, lag=0.13)
        ratio, damping = model.values["gear_ratio"][0], model.values["parameters"]["F_v"]["nominal"]
        assert damping * ratio**2 / loop(model)["k_p"]["nominal"] == pytest.approx(0.13, rel=0.01)
        assert "lag of the angle" in model.why["parameters.F_v"]
    assert "How stiff is the servo's loop?" in str(proposed(MotorSheet(), fit=None, lag=0.13).questions)


@pytest.mark.parametrize(
    ("command", "words"), [("voltage", "none (voltage)"), ("position_loop", "(position loop)")]
)
def test_a_servo_that_no_goal_of_the_logs_drives_is_asked_about(command: str, words: str) -> None:
    model = proposed(MotorSheet(servo="sts3215", p=16.0), command)
    assert any("What is the servo 'sts3215'" in q.words and words in q.words for q in model.questions)
