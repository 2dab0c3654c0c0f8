"""A diagnosis in words, tables, pictures and on its page."""

from dataclasses import replace

import numpy as np
import pytest
from command_line import text_of
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from hybrid_id.diagnosis.locate import Disturbance, Location
from hybrid_id.diagnosis.next_experiment import Experiment
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.identification.horizons import Horizon
from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.diagnosis import (
    diagnosis_page,
    diagnosis_table,
)
from hybrid_id.reporting.diagnosis_figures import diagnosis_figures
from hybrid_id.reporting.diagnosis_words import (
    unselected_tie_lines,
    words_of,
)
from hybrid_id.reporting.study import bound_cells
from hybrid_id.reporting.tensorboard import write_diagnosis_events
from hybrid_id.systems import System

PROPOSED = Experiment(
    "reversals of growing size", "", 1, np.arange(2.0), {"u1": np.zeros(2)}, "u1", {"q_m1": 0.0}, 12.345
)
TIED = ("spring_load@joint1/load", "gravity_load@joint1/load")
MANY = (
    "asymmetric_friction@joint1/motor_friction", "asymmetric_friction@joint1/link_friction",
    "constant_torque@joint1/load", "gravity_load@joint1/load", "spring_load@joint1/load", "delay@joint1/input",
)  # fmt: skip
PLACE = Location("joint2", "load", "angle", 0.62, np.linspace(-1, 1, 5), np.linspace(-2, 2, 5))
ACTS = (Disturbance("joint2", "load", 0.7, 0.0), Disturbance("joint1", "joint", 0.1, 9.0))


@pytest.fixture(scope="module")
def figures(diagnosed: tuple[Dataset, System, Diagnosis]) -> dict[str, np.ndarray]:
    return diagnosis_figures(diagnosed[2])


def test_nothing_is_computed_while_pictures_and_page_are_made(
    diagnosed, monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    found = diagnosed[2]
    found.details.compute()
    for name in ("torque_map", "after_reversals", "as_identified", "residual_tests", "replay"):
        monkeypatch.setattr(f"hybrid_id.diagnosis.details.{name}", None)
    drawn = diagnosis_figures(found)
    assert diagnosis_page(found, drawn).html() and diagnosis_table(found)
    write_diagnosis_events(tmp_path, found, drawn)


def half_explained(found: Diagnosis, **changes: object) -> Diagnosis:
    """The spring explains 43 % of the gap, something at joint 2 the rest."""
    first = replace(found.effects[0], share=0.43, share_interval=(0.37, 0.48), probability=0.97)
    some = {
        "effects": (first, *found.effects[1:]), "unknown": True, "remainder": 0.57,
        "remainder_interval": (0.5, 0.62), "disturbances": ACTS, "residual_after": (PLACE,),
    }  # fmt: skip
    return replace(found, **(some | changes))


def variants(found: Diagnosis, sound: Diagnosis) -> dict[str, Diagnosis]:
    """Every verdict, the longest form of each."""
    implausible = tuple(f"F_v{k} is driven to zero" for k in range(9))
    return {
        "effects": half_explained(found, ties=(TIED, TIED), implausible=implausible, experiments=(PROPOSED,)),
        "outside_catalogue": half_explained(
            found,
            verdict="outside_catalogue",
            effects=found.effects[1:],
            ties=(MANY[:4],),
            implausible=implausible,
            confounded=("kp and temperature1 rise together",),
            rejected={"delay at joint1/input": ""},
            contradiction="On the test records the corrected model predicts worse than the re-fitted one.",
            horizon=Horizon("windows", 0.5),
        ),
        "parameters_only": replace(
            sound,
            verdict="parameters_only",
            implausible=implausible,
            changes="A load explains the new values.",
        ),
        "no_gap": replace(sound, verdict="no_gap", rejected={"delay at joint1/input": ""}),
        "inconclusive": replace(sound, verdict="inconclusive"),
    }


WORDS = {
    "effects": "Spring load explains 43 %",
    "outside_catalogue": "None of ",
    "parameters_only": "Wrong parameter values explain the gap",
    "no_gap": "There is no gap",
    "inconclusive": "Inconclusive: too little data",
}


@pytest.mark.parametrize("verdict", WORDS)
def test_summary_begins_with_what_is_known_and_is_short(verdict: str, diagnosed, sound) -> None:
    lines = text_of(diagnosis_table(variants(diagnosed[2], sound[2])[verdict]), 120).splitlines()
    assert " ".join(lines).startswith(WORDS[verdict])
    assert len(lines) <= 25
    assert max(map(len, lines)) <= 120


def test_ties_of_effects_that_are_not_selected_stand_on_the_page_as_in_the_file(diagnosed) -> None:
    first, one, other, *others = (replace(one, tied_with=()) for one in diagnosed[2].effects)
    name, rival = (f"{e.name}@{e.where}" for e in (one, other))
    alike = (first, replace(one, tied_with=(rival,)), replace(other, tied_with=(name,)), *others)
    free = replace(diagnosed[2], effects=(first, one, other, *others), ties=(), experiments=())
    tied = replace(free, effects=alike)
    assert sum(bool(effect["tied_with"]) for effect in tied.as_dict()["effects"]) == 2
    assert "Nothing is indistinguishable" in diagnosis_page(free, {}).html()
    page = diagnosis_page(tied, {}).html()
    assert "Nothing is indistinguishable" not in page
    (line,) = unselected_tie_lines(tied)  # of two that name each other the pair is said once
    assert line[1:] in page and line.count(words_of(one.name)) == line.count(words_of(other.name)) == 1


def test_without_test_records_no_error_is_claimed(diagnosed, sound) -> None:
    blind = {"nominal": None, "refit": None, "with_effect": None, "shrink": None}
    for one in (
        diagnosed[2],
        replace(sound[2], verdict="no_gap"),
        replace(sound[2], verdict="parameters_only"),
    ):
        assert "NRMSE" not in text_of(diagnosis_table(replace(one, **blind)))
    assert "gap" not in diagnosis_figures(replace(diagnosed[2], **blind))


def test_file_says_where_the_unknown_acts_and_each_output_errs(diagnosed) -> None:
    content = half_explained(diagnosed[2]).as_dict()
    assert content["unknown_location"] == {"joint": "joint2", "side": "load"}
    assert content["gap"]["by_output"]["q_m1"]["refit"] == content["gap"]["refit"]


def test_a_bound_that_is_reached_is_marked(diagnosed) -> None:
    model = diagnosed[2].model
    value = model.parameter("q_s").spec.value
    tight = model.with_specs({"q_s": replace(model.parameter("q_s").spec, upper=value)})
    assert [str(cell) for cell in bound_cells(tight, "q_s")][1] == f"{value:.4g}, reached"
    assert "reached" not in str(bound_cells(model, "q_s")[1])


def test_events_hold_errors_shares_probabilities_and_pictures(diagnosed, figures, tmp_path) -> None:
    write_diagnosis_events(tmp_path, diagnosed[2], figures)
    events = EventAccumulator(str(tmp_path)).Reload()
    scalars = set(events.Tags()["scalars"])
    assert {"gap/nominal", "gap/re-fitted", "gap/corrected", "gap/q_m1/corrected"} <= scalars
    assert {"probability/joint1/load/spring_load", "share/joint1/load/spring_load"} <= scalars
    assert {f"figures/{name}" for name in figures} == set(events.Tags()["images"])
