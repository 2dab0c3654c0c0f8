"""The cases of experiments/16_real_records: what they ask, and the twin among them."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[1] / "experiments" / "16_real_records"
MODULES = ("cases", "real_machines", "emps", "table")


@pytest.fixture(scope="module")
def experiment():
    """Modules of the experiment by name."""
    sys.path.insert(0, str(FOLDER))
    try:
        yield {name: importlib.import_module(name) for name in MODULES}
    finally:
        sys.path.remove(str(FOLDER))
        for name in MODULES:
            sys.modules.pop(name, None)


def effect(name: str, probability: float, **more):
    return {
        "name": name,
        "probability": probability,
        "selected": True,
        "parameters": {},
        "tied_with": [],
    } | more


@pytest.mark.parametrize(
    ("verdict", "effects", "said"),
    [
        ("effects", [effect("delay", 0.9, parameters={"T_d": [0.031, 0.001]})], "right"),
        ("effects", [effect("delay", 0.9, parameters={"T_d": [0.1, 0.001]})], "right name, wrong size"),
        ("effects", [effect("backlash", 0.4, tied_with=["delay@joint1/input"])], "indistinguishable"),
        ("effects", [effect("backlash", 0.49)], "wrong below 0.5"),
        ("effects", [effect("backlash", 0.5), effect("delay", 0.9)], "wrong"),
        ("inconclusive", [effect("backlash", 0.9, selected=False)], "nothing named"),
    ],
)
def test_agreement_with_what_is_expected(experiment, verdict, effects, said) -> None:
    cases = experiment["cases"]
    case = cases.CASES["xl330_delay_30ms"]
    assert cases.agreement(case, {"verdict": verdict, "effects": effects}) == said


def test_the_twin_moves_at_the_speed_that_its_friction_allows(experiment) -> None:
    axis = experiment["real_machines"].CONFIG["emps"] | {"limit": 60.0, "offset": 0.0}
    goal = np.linspace(0.0, 10.0, 4000)  # faster than the limit of the force allows, so that it is reached
    for sign in (1.0, -1.0):
        force, position = experiment["emps"].simulate(axis, sign * goal, np.zeros(goal.size))
        assert force[-1] == sign * 60.0
        speed = (position[-1] - position[-2]) / 1e-3
        viscous = axis["F_v"] * (1.0 + sign * axis["asymmetry"])
        assert speed == pytest.approx(sign * (60.0 - axis["F_c"]) / viscous, rel=1e-3)


def test_strokes_of_the_twin_begin_and_end_at_rest(experiment) -> None:
    strokes = experiment["cases"].CASES["emps_twin_strokes"].build(Path()).dataset
    assert len(strokes.train) > 20
    for stroke in strokes:
        q = stroke.outputs["q_m1"]
        assert max(np.ptp(q[:5]), np.ptp(q[-5:])) < 2e-3 < np.ptp(q)


def test_interventions_change_what_they_say(experiment, shared) -> None:
    cases, data = experiment["cases"], shared / "data"
    known, late = cases.known_pendulum(data), cases.CASES["pendulum_delay_30ms"].build(data)
    for before, after in zip(known.dataset, late.dataset, strict=True):
        np.testing.assert_array_equal(after.inputs["tau1"], before.inputs["tau1"][6:])
        np.testing.assert_array_equal(after.outputs["q_m1"], before.outputs["q_m1"][:-6])
    heavy = cases.heavier(cases.known_xl330(data)).system
    known = cases.known_xl330(data).system
    J, share, G_l = (
        heavy.parameter(n).spec.value / known.parameter(n).spec.value for n in ("J", "rotor_share", "G_l")
    )
    assert G_l == pytest.approx(1.3) and J * share == pytest.approx(1.0) and 1.0 < J < 1.3


def test_every_case_can_be_built(experiment, shared) -> None:
    for name, case in experiment["cases"].CASES.items():
        machine = case.build(shared / "data")
        assert machine.dataset.train and machine.dataset.test, name


def test_the_publisher_s_arm_scores_as_published(experiment, shared) -> None:
    machines = experiment["real_machines"]
    arm = machines.dfki(shared / "data", "A.0")
    q_1, q_2 = machines.window_errors(arm.system, arm.dataset.records, 0.5).values()
    assert q_1 == pytest.approx(0.053, abs=0.004) and q_2 == pytest.approx(0.184, abs=0.012)  # rad
