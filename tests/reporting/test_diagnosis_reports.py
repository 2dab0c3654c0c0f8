"""A diagnosis in words, tables, pictures and on its page."""

import re
from dataclasses import replace

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from hybrid_id.diagnosis.catalogue import SIDES
from hybrid_id.diagnosis.confidence import as_identified
from hybrid_id.diagnosis.course import Course
from hybrid_id.diagnosis.locate import Location
from hybrid_id.diagnosis.next_experiment import Experiment
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.events import write_gap_events
from hybrid_id.reporting.gap import parameters_table, summary, suspects_table
from hybrid_id.reporting.gap_figures import diagnosis_figures
from hybrid_id.reporting.gap_ties import tie_lines
from hybrid_id.reporting.gap_verdict import verdict_sentence
from hybrid_id.reporting.gap_words import goes_with
from hybrid_id.reporting.html.gap_page import gap_page
from hybrid_id.reporting.html.twin import Drawn
from hybrid_id.reporting.parameter_tables import bound_cells
from hybrid_id.study.residual_tests import residual_tests
from hybrid_id.systems import System

PROPOSED = Experiment("reversals of growing size", 1, np.arange(2.0), {"u1": np.zeros(2)}, "u1", 12.345, 1.3)
TIED = ("spring_load@joint1/load", "gravity_load@joint1/load")
MANY = (
    "asymmetric_friction@joint1/motor_friction", "asymmetric_friction@joint1/link_friction",
    "constant_torque@joint1/load", "gravity_load@joint1/load", "spring_load@joint1/load", "delay@joint1/input",
)  # fmt: skip


@pytest.fixture(scope="module")
def figures(diagnosed: tuple[Dataset, System, Diagnosis]) -> dict[str, Drawn]:
    return diagnosis_figures(*diagnosed)


def variants(found: Diagnosis, sound: Diagnosis) -> dict[str, Diagnosis]:
    """Every verdict, the longest form of each."""
    place = Location("joint2", "load", "angle", 0.62, np.linspace(-1, 1, 5), np.linspace(-2, 2, 5))
    bent = tuple(f"F_v{k} is driven to zero" for k in range(9))
    return {
        "effects": replace(found, ties=(TIED, TIED, TIED), bent=bent, experiments=(PROPOSED,)),
        "outside_catalogue": replace(
            found,
            verdict="outside_catalogue",
            unknown=True,
            left=(place,),
            courses=(Course("joint2", "load", 0.7, 0.0), Course("joint1", "joint", 0.1, 9.0)),
            ties=(MANY[:4],),
            bent=bent,
            together=("what kp does from what temperature1 does: they rise together",),
            experiments=(PROPOSED,),
            search=replace(found.search, window=0.5),
        ),
        "parameters_only": replace(sound, verdict="parameters_only", bent=bent),
        "no_gap": replace(sound, verdict="no_gap", withdrawn=("delay at joint1/input",)),
        "inconclusive": replace(sound, verdict="inconclusive"),
    }


WORDS = {
    "effects": "Spring load at the load of joint 1 (k_s = ",
    "outside_catalogue": "Something that the catalogue lacks acts at joint 2, on the link side: it grows with "
    "the angle.",
    "parameters_only": "Wrong parameters explain the gap, and no effect is missing",
    "no_gap": "There is no gap: on unseen records today's model leaves a normalised error of ",
    "inconclusive": "These records are too short to say: their errors are worth ",
}


@pytest.mark.parametrize("verdict", WORDS)
def test_summary_begins_with_the_verdict_and_is_short(verdict: str, diagnosed, sound) -> None:
    lines = summary(variants(diagnosed[2], sound[2])[verdict]).splitlines()
    assert " ".join(lines).startswith(WORDS[verdict])
    assert len(lines) <= 25
    assert max(map(len, lines)) <= 120


def test_sentence_tells_the_figures_of_the_result(diagnosed) -> None:
    found: Diagnosis = diagnosed[2]
    gap, sentence = found.shrink, verdict_sentence(found)
    assert gap is not None
    assert f"falls from {gap.refit:.3g} to {gap.with_effect:.3g}, {100 * gap.share:.0f} % (" in sentence
    value, error = found.selected[0].parameters["q_s"]
    assert f"q_s = {value:.4g} ± {1.96 * error:.2g} rad" in sentence


def test_ties_come_with_the_experiment_that_tells_them_apart(diagnosed) -> None:
    words = " ".join(summary(replace(diagnosed[2], ties=(TIED,), experiments=(PROPOSED,))).split())
    assert (
        "do not tell apart: spring load (joint 1, at the load), gravity load (joint 1, at the load)." in words
    )
    assert "What would: slow motion both ways over a quarter turn and more." in words
    assert (
        "next experiment: reversals of growing size at joint 1: the outputs of the tied models would differ"
        in words
    )
    assert "by 12 times the encoders' noise (RMS; 1.3 in these records)." in words
    idle = replace(diagnosed[2], ties=(TIED,), experiments=(replace(PROPOSED, distance=0.08),))
    assert "no command that was simulated parts the tied models by more than 0.08 times" in summary(idle)
    assert idle.as_dict()["next_experiments"] == []
    clear = summary(replace(diagnosed[2], ties=(), experiments=()))
    assert "tell apart" not in clear and "next experiment" not in clear


def test_a_tie_quotes_what_tells_its_own_pair_apart(diagnosed) -> None:
    spring, lag = "joint_flexibility@joint1/transmission", "electrical_lag@joint1/motor"
    tied = tie_lines(
        replace(diagnosed[2], ties=((spring, "delay@joint1/input"), (lag, "delay@joint1/input")))
    )
    assert "What would: a slow sweep through the resonance" in tied[0] and "lag" not in tied[0]
    assert "What would: a fast sweep: a delay turns the phase on" in tied[1]
    (unknown,) = tie_lines(replace(diagnosed[2], ties=(("delay@joint1/input", TIED[0]),)))
    assert unknown.endswith("(joint 1, at the load).")  # nothing is known of this pair
    (sides,) = tie_lines(replace(diagnosed[2], ties=(MANY[:2],)))
    assert sides.endswith(f"What would: {SIDES}.")


def test_a_tie_of_many_says_each_excitation_once(diagnosed) -> None:
    (line,) = tie_lines(replace(diagnosed[2], ties=(MANY,)))
    assert (
        f"What would: for the places of asymmetric friction, {SIDES}; for asymmetric friction and constant"
        in line
    )
    shared = "slow motion both ways over the whole range: uneven friction is the same all over"
    assert line.count(shared) == 1
    assert (
        f"for asymmetric friction and gravity load, and for asymmetric friction and spring load, {shared}"
        in line
    )
    (brief,) = tie_lines(replace(diagnosed[2], ties=(MANY,)), brief=True)
    assert brief.split("What would: ")[1] == (
        f"{SIDES.split(': ')[0]}; steady speeds both ways at several heights, cold and warm; slow motion both ways "
        "over the whole range; slow motion both ways over a quarter turn and more."
    )


def test_without_test_records_no_unseen_record_is_claimed(diagnosed, sound) -> None:
    blind = {"nominal": None, "refit": None, "with_effect": None, "shrink": None}
    for one in (
        diagnosed[2],
        replace(sound[2], verdict="no_gap"),
        replace(sound[2], verdict="parameters_only"),
    ):
        words = summary(replace(one, **blind))
        assert "normalised error" not in words
        assert "there is no test record" in words


@pytest.mark.parametrize(
    ("torque", "words"),
    [
        ([-2.0, 0.0, 1.0, 3.0], "it grows with the angle"),
        ([3.0, 1.0, 0.0, -2.0], "it falls with the angle"),
        ([0.0, 2.0, 2.0, 0.0], "it varies with the angle"),
    ],
)
def test_profile_in_words(torque: list[float], words: str) -> None:
    one = Location("joint1", "load", "angle", 0.5, np.arange(4.0), np.array(torque))
    assert goes_with(one) == words


def test_every_signal_has_words(diagnosed) -> None:
    for one in diagnosed[2].where:
        assert goes_with(one).startswith("it ")


def test_what_no_torque_explains_has_no_place(diagnosed) -> None:
    found = diagnosed[2]
    nowhere = replace(
        found, verdict="outside_catalogue", left=(replace(found.left[0], share=0.03),),
        with_effect=replace(found.with_effect, coloured=0.42),
    )  # fmt: skip
    said = verdict_sentence(nowhere)
    assert said.startswith(
        "Something that the catalogue lacks is at work: 42 % of what the best model leaves on unseen records (mean "
        "square) is no noise. Spring load"
    )


def test_a_joint_is_told_where_no_shape_is(diagnosed) -> None:
    found = diagnosed[2]
    nowhere = replace(
        found, verdict="outside_catalogue", unknown=True, left=(replace(found.left[0], share=0.03),),
        courses=(Course("joint2", "joint", 0.7, 0.0), Course("joint1", "joint", 0.1, 9.0)),
    )  # fmt: skip
    assert verdict_sentence(nowhere).startswith(
        "Something that the catalogue lacks acts at joint 2: a torque there, whatever its course, explains 70 % of "
        "what the best model leaves within short windows (mean square), elsewhere 10 % at most."
    )
    assert nowhere.as_dict()["unknown_at"] == {"joint": "joint2", "place": None}


def test_tables_hold_every_suspect_and_parameter(diagnosed) -> None:
    _, today, found = diagnosed
    assert suspects_table(found).row_count == len(found.effects)
    judged = [as_identified(diagnosed[0], one) for one in found.fitted.values()]
    table = parameters_table(today, found, judged)
    names = list(table.columns[0].cells)
    assert {"J", "F_c", "k_s", "q_s"} <= set(names)
    row = names.index("k_s")
    assert [list(column.cells)[row] for column in table.columns[1:4]] == [
        "",
        "",
        "",
    ]  # today's model lacks it
    heads = [str(column.header) for column in table.columns]
    assert heads[6:] == ["unit", "trust", "lower bound", "upper bound", "why"]
    cells = {name: [str(list(column.cells)[k]) for column in table.columns] for k, name in enumerate(names)}
    assert cells["k_s"][5] == "none" and cells["k_s"][7] == "D"  # in voltage and angle no torque has a scale
    assert float(cells["q_s"][5]) > 0.0 and cells["q_s"][7] in "ABC"
    assert cells["k_s"][8] == "0"


def test_a_bound_that_is_reached_is_marked(diagnosed) -> None:
    model = diagnosed[2].model
    value = model.parameter("q_s").spec.value
    tight = model.with_specs({"q_s": replace(model.parameter("q_s").spec, upper=value)})
    assert [str(cell) for cell in bound_cells(tight, "q_s")][1] == f"{value:.4g}, reached"
    assert "reached" not in str(bound_cells(model, "q_s")[1])


def test_pictures_are_there_and_not_empty(figures, sound) -> None:
    names = ["gap", "missing_torque", "where", "torque_map", "reversals", "suspects", "worst_record"]
    assert list(figures) == names
    assert not {"missing_torque", "torque_map"} & set(diagnosis_figures(*sound))  # nothing is missing
    for image, plot in figures.values():
        assert plot["data"]
        assert image.dtype == np.uint8 and image.shape[2] == 3
        assert image.min() < 60 and (image == 255).mean() > 0.5


def test_pictures_of_records_without_a_test(diagnosed) -> None:
    dataset, today, found = diagnosed
    alone = replace(found, nominal=None, refit=None, with_effect=None, shrink=None)
    assert "gap" not in diagnosis_figures(dataset, today, alone)


def test_page_has_the_verdict_first_and_every_picture(diagnosed, figures) -> None:
    dataset, today, found = diagnosed
    judged = [as_identified(dataset, one) for one in found.fitted.values()]
    residuals = {
        name: residual_tests(dataset, one.system, one.result.engine) for name, one in found.fitted.items()
    }
    page = gap_page(
        dataset, today, found, figures, reach=1.96, level=0.95, judged=judged, residuals=residuals
    )
    text = page.html()
    titles = re.findall(r"<h2>(.*?)</h2>", text)
    assert titles == [
        "Where", "Which", "How far", "Parameters", "Residuals", "Ties and next experiment", "Records",
    ]  # fmt: skip
    assert "Re-fitted model, q_m1: not white" in text and "Corrected model, q_m1: " in text
    assert text.index("Spring load at the load of joint 1") < text.index("<h2>")
    assert text.count("data:image/png;base64,") == len(figures)
    assert all(one.name.replace("_", " ") in text for one in found.effects)
    assert text.count('<td class="">joint 1') < len(
        found.effects
    )  # the improbable ones are named in a sentence


def test_events_hold_errors_probabilities_and_pictures(diagnosed, figures, tmp_path) -> None:
    images = {name: figure.image for name, figure in figures.items()}
    write_gap_events(tmp_path, diagnosed[2], images)
    events = EventAccumulator(str(tmp_path)).Reload()
    assert {"gap/today", "gap/re-fitted", "gap/corrected"} <= set(events.Tags()["scalars"])
    assert "probability/joint1/load/spring_load" in events.Tags()["scalars"]
    assert {f"figures/{name}" for name in images} == set(events.Tags()["images"])
