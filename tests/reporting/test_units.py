"""Answers in the units that were logged: errors by output, angles at the joint, one interval for a number."""

from dataclasses import replace

import numpy as np
import pytest
from command_line import text_of
from drives import make_records, multisine, rigid_drive

from hybrid_id import Channel, Dataset, one_link
from hybrid_id.reporting.study import study_table
from hybrid_id.reporting.units import in_unit, shown_unit, title
from hybrid_id.statistics.profile import Profile
from hybrid_id.study import Study, identify

DEGREES, RADIANS = Channel("q_m1", "rad", logged="deg"), Channel("q_m1", "rad")
CURRENT = Channel("i1", "A", logged="mA")


def screen(study: Study) -> str:
    return text_of(study_table(study), 160)


@pytest.mark.parametrize(
    ("channel", "ratio", "words"),
    [
        (DEGREES, 1.0, ("180", "deg")),
        (DEGREES, 50.0, ("3.6", "deg at the joint")),
        (RADIANS, 50.0, ("0.0628", "rad at the joint")),
        (CURRENT, 50.0, ("3.14e+03", "mA")),
        (Channel("q_a1", "rad", logged="deg"), 50.0, ("180", "deg")),  # is at the joint already
    ],
)
def test_an_error_has_the_unit_that_was_logged(
    channel: Channel, ratio: float, words: tuple[str, str]
) -> None:
    assert in_unit(channel.name, [np.pi], [channel], one_link(ratio)) == words


@pytest.mark.parametrize(
    ("unit", "outputs", "shown"),
    [
        ("rad", [DEGREES], ("deg", 180.0 / np.pi)),
        ("rad", [CURRENT, DEGREES], ("deg", 180.0 / np.pi)),
        ("rad", [RADIANS], ("rad", 1.0)),
        ("rad", [CURRENT], ("rad", 1.0)),
        ("N m", [DEGREES], ("N m", 1.0)),
    ],
)
def test_an_angle_among_the_parameters_has_it_too(
    unit: str, outputs: list[Channel], shown: tuple[str, float]
) -> None:
    name, factor = shown_unit(unit, outputs)
    assert (name, factor) == (shown[0], pytest.approx(shown[1]))


@pytest.fixture(scope="module")
def study() -> Study:
    voltages = [multisine(k, samples=500, amplitude=7.0) for k in range(2)]
    train, test = make_records(rigid_drive(), voltages, noise={"q_m1": 0.01})
    records = (train, replace(test, role="test"))
    data = Dataset("drive", (Channel("u1", "V"),), (RADIANS,), records, 0.002)
    return identify(data, rigid_drive(), pooled=True)


def test_table_names_every_symbol_and_gives_the_error_by_output(study: Study) -> None:
    words = screen(study)
    for name in study.names:
        row = next(line for line in words.splitlines() if line.startswith(f"{name} "))
        assert study.system.parameter(name).doc in row
    error, ratio = study.test_errors["q_m1"], study.system.gear_ratio[0]
    assert f"q_m1 {error.rmse / ratio:.3g} rad at the joint (normalised {error.nrmse:.4g})" in words
    degrees = replace(study, outputs=(DEGREES,))
    assert f"q_m1 {np.degrees(error.rmse) / ratio:.3g} deg at the joint" in screen(degrees)


def test_a_profile_is_the_one_interval_of_its_parameter(study: Study) -> None:
    k = study.names.index("J")
    before = study.intervals()
    profile = Profile(
        np.zeros(1), np.zeros(1), 1e-5, 4e-5, (True, True), 1.0, "interval closed on both sides"
    )
    profiled = replace(study, profiles={"J": profile})
    assert profiled.intervals()[k].tolist() == [1e-5, 4e-5]
    others = [i for i in range(len(study.names)) if i != k]
    assert np.array_equal(profiled.intervals()[others], before[others], equal_nan=True)
    assert "1e-05 to 4e-05" in screen(profiled)
    assert screen(profiled).count(" to 4e-05") == 1
    half_open = replace(profile, upper=np.inf, closed=(True, False), message="interval open above")
    words = screen(replace(study, profiles={"J": half_open}))
    assert "profile likelihood of J: interval open above" in words


def test_an_output_is_called_by_its_joint_where_a_robot_names_it() -> None:
    outputs = (Channel("q_m1", "rad"), Channel("q_a3", "rad", joint="elbow"))
    assert [title(name, outputs) for name in ("q_m1", "q_a3", "q_a4")] == ["q_m1", "q_a3 (elbow)", "q_a4"]
