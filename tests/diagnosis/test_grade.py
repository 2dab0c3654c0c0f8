"""What each effect explains and how surely: shares that add up, ties, and what is not asserted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.grade import (
    Grade,
    RatedEffect,
    behind_play,
    doubtful,
    grade,
    of_robot,
    structural_share,
    tied_models,
    tied_sets,
    tied_steps,
)
from hybrid_id.diagnosis.model import FittedModel, Name
from hybrid_id.diagnosis.screen import SelectionStep
from hybrid_id.diagnosis.select import Selection, accepted_ones
from hybrid_id.diagnosis.validation import Validation

BLOCKS = 240
SPRING, WEIGHT, BIAS = ((name, "joint1/load") for name in ("spring_load", "gravity_load", "constant_torque"))
DRAG = "quadratic_drag", "joint1/motor_friction"
NONE: Any = SimpleNamespace()


@dataclass(frozen=True, eq=False)
class Fitted:
    """What a grade asks of a model."""

    effects: tuple[Name, ...]
    validation: Validation
    result: Any
    system: Any
    judged: bool = True
    white: bool = False
    autocorrelation: float = 0.2

    @property
    def error(self) -> float:
        return self.validation.error

    trained = error
    no_structure = property(lambda self: self.autocorrelation <= CRITERIA.coloured)
    fall, ahead_of = FittedModel.fall, FittedModel.ahead_of


def explained(found: Grade) -> float:
    return sum(c.share or 0.0 for c in found.effects if c.selected)


def model(error: float, *effects: Name, seed: int = 0, scatter: float = 0.2, white: bool = False) -> Any:
    """A model whose blocks scatter about its mean square; of one seed alike."""
    blocks = error * (1.0 + scatter * np.random.default_rng(seed).uniform(-1.0, 1.0, BLOCKS))
    row = np.arange(BLOCKS) // 40
    found = Validation(25.0 * blocks, np.full(BLOCKS, 25), row, 500.0, row)
    result = SimpleNamespace(
        names=("x",), values=[1.0], jacobian=(np.ones((9, 1, 1)),), noise_scale=1.0, n_samples=9, at_bound=(),
        prior_precision=np.zeros(1),
        residual=[np.sqrt(error) * np.sin(0.01 * np.arange(400))[:, None]], cost=error,
        system=SimpleNamespace(parameter=lambda _: SimpleNamespace(component=""), table=()),
    )  # fmt: skip
    return Fitted(tuple(sorted(effects)), found, result, SimpleNamespace(components={}), white=white)


def search(*steps: Sequence[Any], chosen: Any = None) -> Selection:
    """A search whose steps hold the model before, then the candidates."""
    found = tuple(SelectionStep(before, tuple(candidates)) for before, *candidates in steps)
    return Selection(found[0].before, found, chosen or found[-1].candidates[0])


def share_of(found: Grade, name: Name) -> RatedEffect:
    return next(c for c in found.effects if (c.name, c.where) == name)


@settings(max_examples=20)
@given(
    st.lists(st.floats(0.05, 0.9), min_size=1, max_size=3), st.floats(0.0, 1.0), st.integers(0, 20)
)  # ratios of errors from each model to the next
def test_shares_and_the_remainder_add_up_to_the_gap(falls: list[float], structural: float, seed: int) -> None:
    names, models = (SPRING, DRAG, BIAS), [model(100.0)]
    for k, fall in enumerate(falls):
        models.append(model(models[-1].error * fall, *names[: k + 1], seed=seed))
    steps = list(pairwise(models))
    found = grade(NONE, search(*steps), structural, seed=seed)
    assert explained(found) + found.remainder == pytest.approx(1.0)
    last = models[-1].error
    assert found.gap == pytest.approx(models[0].error - last * (1.0 - structural))
    for k, (a, b) in enumerate(steps):
        one = share_of(found, names[k])
        assert one.share is not None and one.share_interval is not None
        assert one.selected and one.share == pytest.approx((a.error - b.error) / found.gap)
        low, high = one.share_interval
        assert low <= one.share + 0.02 and one.share - 0.02 <= high
    shares = [c.share for c in found.effects if c.selected]
    assert shares == sorted(shares, reverse=True)


def test_the_effect_that_explains_more_alone_has_the_larger_share_in_whatever_order_they_were_found() -> None:
    base, play, friction = model(100.0), model(40.0, SPRING), model(25.0, DRAG)
    both = model(5.0, SPRING, DRAG)
    found = grade(NONE, search((base, play, friction), (play, both)), 0.0)
    assert [(c.name, c.where) for c in found.effects if c.selected] == [DRAG, SPRING]
    assert share_of(found, DRAG).share == pytest.approx(75.0 / 95.0)
    assert share_of(found, SPRING).share == pytest.approx(20.0 / 95.0)


def test_an_effect_that_explains_all_alone_has_its_share_alone() -> None:
    base, spring, bias = model(100.0), model(1.0, SPRING), model(50.0, BIAS)
    found = grade(NONE, search((base, spring, bias)), 0.0)
    assert share_of(found, SPRING).alone == pytest.approx(1.0)
    assert share_of(found, BIAS).alone == pytest.approx(50.0 / 99.0)
    assert share_of(found, BIAS).share is None and share_of(found, BIAS).share_interval is None


def test_a_sure_effect_is_probable_and_its_rivals_are_not() -> None:
    found = grade(NONE, search((model(100.0), model(1.0, SPRING), model(50.0, BIAS))), 0.0)
    assert share_of(found, SPRING).probability > 0.9
    assert share_of(found, BIAS).probability < 0.05
    assert not doubtful(found) and not tied_sets(found.effects)


def test_two_that_explain_alike_are_asserted_as_one_of_both() -> None:
    base, spring, weight = model(100.0), model(1.0, SPRING, seed=1), model(1.005, WEIGHT, seed=2)
    told = search((base, spring, weight))
    found = grade(NONE, told, 0.0)
    one, other = share_of(found, SPRING), share_of(found, WEIGHT)
    assert 0.4 < one.probability < 0.6 and one.tied_with == ("gravity_load@joint1/load",)
    assert one.probability + other.probability > 0.9
    assert tied_sets(found.effects) == [("spring_load@joint1/load", "gravity_load@joint1/load")]
    assert tied_models(told) == [[spring, weight]]
    # whole records have added nothing
    whole = replace(search((base, model(40.0, BIAS)), chosen=spring), near=told)
    assert tied_models(whole) == [[spring, weight]]
    three = grade(NONE, search((base, spring, weight, model(1.005, BIAS, seed=3))), 0.0)
    assert share_of(three, SPRING).probability < CRITERIA.least_probability
    assert not doubtful(found) and not doubtful(three)  # together they are probable


def test_each_step_that_has_left_rivals_of_the_chosen_model_open_is_a_tie() -> None:
    """Those of the first effect, beside the second, and those of the second beside the first."""
    base, spring = model(100.0), model(10.0, SPRING)
    both, drag = model(1.0, SPRING, BIAS, seed=1), model(1.005, SPRING, DRAG, seed=2)
    second = SelectionStep(spring, (both, drag))
    first = SelectionStep(model(90.0, BIAS), (both, model(1.005, WEIGHT, BIAS, seed=3)), swap=True)
    told = Selection(base, (SelectionStep(base, (spring,)), second, first), both)
    assert [(step, len(equals)) for step, equals in tied_steps(told, told.steps)] == [(second, 2), (first, 2)]


def test_where_structure_is_left_what_is_not_much_less_probable_is_indistinguishable() -> None:
    """Two laws that differ by a third of their error, each better on half of the records; one that does little."""
    rng = np.random.default_rng(0)

    def leaving(error: float, ratios: Sequence[float], name: Name) -> Any:
        one = model(error, name)
        blocks = one.validation.blocks * np.repeat(ratios, 40) * rng.uniform(0.95, 1.05, BLOCKS)
        return replace(one, validation=replace(one.validation, blocks=blocks), autocorrelation=0.9)

    base = replace(model(100.0), autocorrelation=0.9)
    spring, weight = leaving(20.0, [1, 2, 1, 2, 1, 2], SPRING), leaving(26.0, [2, 1, 2, 1, 2, 1], WEIGHT)
    poor = leaving(70.0, [1] * 6, BIAS)
    told = search((base, spring, weight, poor))
    assert share_of(grade(NONE, told, 0.5), SPRING).tied_with == ("@".join(WEIGHT),)
    sure = leaving(26.0, [1] * 6, WEIGHT)
    assert (
        share_of(grade(NONE, search((base, leaving(10.0, [1] * 6, SPRING), sure)), 0.5), SPRING).tied_with
        == ()
    )


def test_what_one_record_alone_gains_by_is_no_more_probable_than_what_is_accepted() -> None:
    """One effect does better in most blocks, the other in the sum of each record, and worse than neither in most."""

    def errs(small: float, large: float, first: float, *names: Name) -> Any:
        one, record = model(1.0, *names, seed=len(names)), np.full(40, small)
        blocks = np.tile(record, 6)
        blocks[::40] = [first, *[large] * 5]
        blocks = one.validation.blocks * blocks
        return replace(one, validation=replace(one.validation, blocks=blocks), autocorrelation=0.9)

    base = errs(4.0, 100.0, 3000.0)
    spring, weight = errs(2.8, 251.0, 1000.0, SPRING), errs(4.08, 161.0, 700.0, WEIGHT)
    told = search((base, spring, weight))
    assert weight.error < spring.error and weight.ahead_of(spring) > 2.0
    assert accepted_ones(told.steps[0]) == [spring]
    found = grade(NONE, told, 0.5)
    one = share_of(found, SPRING)
    assert one.probability >= share_of(found, WEIGHT).probability and one.together > 0.5


def candidate(
    name: Name, probability: float, ties: tuple[str, ...] = (), *, sure: bool = True
) -> RatedEffect:
    return RatedEffect(*name, probability, True, ties, {}, 0.3, (0.2, 0.4), sure=sure)


def graded(*candidates: RatedEffect) -> Grade:
    return Grade(candidates, 0.0, (0.0, 0.0), False, 1.0, 1.0)


def test_nothing_improbable_or_of_no_sure_size_is_asserted() -> None:
    assert doubtful(graded(candidate(SPRING, 0.6), candidate(DRAG, 0.9))) == []
    assert doubtful(graded(candidate(SPRING, 0.4))) == [SPRING]
    assert doubtful(graded(candidate(SPRING, 0.9, sure=False))) == [SPRING]
    rival = replace(candidate(WEIGHT, 0.9), selected=False)
    tied = replace(candidate(SPRING, 0.4, ties=("gravity_load@joint1/load",)), others=0.3)
    assert doubtful(graded(tied, rival)) == []
    # the step that has compared the two says it, not the one in which the rival was found
    assert doubtful(graded(replace(tied, others=0.05), rival)) == [SPRING]
    assert doubtful(graded(replace(candidate(SPRING, 0.1), selected=False))) == []


def test_an_effect_that_helps_by_chance_has_an_interval_that_holds_zero() -> None:
    held = dropped = 0
    for seed in range(1, 21):
        base, spring = model(1.0, scatter=0.9), model(1.0, SPRING, seed=seed, scatter=0.9)
        found = grade(NONE, search((base, spring)), 0.5)
        interval = found.effects[0].share_interval
        assert interval is not None
        held += interval[0] < 0.0
        dropped += doubtful(found) == [SPRING]
    assert held >= 17 and dropped >= 17


@settings(max_examples=20)
@given(st.floats(0.01, 0.99), st.floats(0.31, 1.0))
def test_unknown_is_what_remains_by_a_tenth_and_by_as_much_as_is_explained(
    fall: float, structural: float
) -> None:
    base = model(100.0)
    found = grade(NONE, search((base, model(100.0 * fall, SPRING))), structural)
    expected = found.remainder >= 0.1 and found.remainder >= explained(found)
    assert found.unknown == expected
    assert not grade(NONE, search((base, model(100.0 * fall, SPRING))), 0.0).unknown


def by_record(errors: Sequence[float], *effects: Name) -> Any:
    """A model that leaves a mean square of its own in each record, with blocks that are alike within one."""
    one = model(1.0, *effects, scatter=0.02)
    return replace(one, validation=one.validation.weighted(np.array(errors)))


def test_an_interval_knows_that_records_differ_more_than_their_blocks() -> None:
    base, spring = by_record([100.0] * 6), by_record([90.0, 80.0, 70.0, 20.0, 15.0, 10.0], SPRING)
    alike = by_record([47.5] * 6, SPRING)
    wide, narrow = (
        grade(NONE, search((base, one)), 0.5).effects[0].share_interval for one in (spring, alike)
    )
    assert wide is not None and narrow is not None
    assert wide[1] - wide[0] > 0.1 > 2.0 * (narrow[1] - narrow[0])


def test_what_some_records_gain_by_and_others_lose_by_is_asserted_beside_noise_alone() -> None:
    base, spring = by_record([100.0] * 6), by_record([40.0, 50.0, 115.0, 120.0, 60.0, 110.0], SPRING)
    tried = search((base, spring))
    white, structural = (grade(NONE, tried, share) for share in (0.1, 0.5))
    assert not doubtful(white)
    assert doubtful(structural) == [SPRING]
    interval = share_of(structural, SPRING).share_interval
    assert interval is not None and interval[0] <= 0.0
    # dropped, it is no more probable than what is asserted must be
    dropped = grade(NONE, replace(tried, chosen=base, unsure=(SPRING,)), 0.5)
    assert share_of(structural, SPRING).probability > 0.5 >= share_of(dropped, SPRING).probability
    rival = by_record([41.0, 51.0, 114.0, 121.0, 60.0, 109.0], WEIGHT)
    both = grade(NONE, replace(search((base, spring, rival)), chosen=base, unsure=(SPRING,)), 0.5)
    assert all(one.together <= 0.5 for one in both.effects)
    # every record gains: sure, however differently
    every = search((base, by_record([40.0, 50.0, 80.0, 90.0, 60.0, 70.0], SPRING)))
    assert not doubtful(grade(NONE, every, 0.5))


ERRORS = st.lists(st.floats(1e-6, 1e6), min_size=6, max_size=6)


@given(ERRORS, ERRORS, st.sampled_from([0.0, 1e-9, 0.02, 0.5, 1.0]))
def test_no_draw_of_records_makes_a_share_more_than_all_of_the_gap(
    first: list[float], second: list[float], structural: float
) -> None:
    """In some draws an effect serves worse than none, and next to nothing is left: a gap of nearly zero."""
    base, one, two = by_record([100.0] * 6), by_record(first, SPRING), by_record(second, SPRING, DRAG)
    found = grade(NONE, search((base, one), (one, two)), structural)
    for low, high in (one.share_interval for one in found.effects if one.share_interval):
        assert -1.0 <= low <= high <= 1.0
    assert 0.0 <= found.remainder_interval[0] <= found.remainder_interval[1] <= 1.0


def test_what_other_records_could_have_made_the_smaller_part_says_nothing_of_the_catalogue() -> None:
    base = by_record([100.0] * 6)
    unsure, sure = by_record([90.0, 85.0, 80.0, 40.0, 25.0, 10.0], SPRING), by_record([55.0] * 6, SPRING)
    for one, expected in ((unsure, False), (sure, True)):
        found = grade(NONE, search((base, one)), 1.0)
        assert found.remainder == pytest.approx(0.55, abs=0.01) and found.remainder > explained(found)
        assert found.unknown == expected


def test_without_an_effect_all_of_the_gap_is_unknown_or_noise() -> None:
    base, poor = model(100.0), model(99.0, SPRING)
    nothing = search((base, poor), chosen=base)
    unknown, noise = grade(NONE, nothing, 0.8), grade(NONE, nothing, 0.1)
    assert unknown.unknown and unknown.remainder == pytest.approx(1.0)
    assert not noise.unknown and explained(unknown) == explained(noise) == 0.0
    assert not any(c.selected for c in unknown.effects)
    assert max(c.probability for c in unknown.effects) < 0.5


def test_a_law_that_contains_another_is_no_rival_of_it() -> None:
    """Friction over the angle with a mean explains whatever dry friction alone does."""
    dry, waves, drop = (
        (name, "joint1/motor_friction")
        for name in ("coulomb_friction", "position_dependent_friction", "stribeck_friction")
    )
    found = grade(NONE, search((model(100.0), model(1.0, dry), model(1.0, waves), model(1.0, drop))), 0.0)
    assert share_of(found, dry).tied_with == ("stribeck_friction@joint1/motor_friction",)
    assert share_of(found, waves).probability == 0.0
    # where the waves predict better, dry friction alone is none of theirs
    found = grade(NONE, search((model(100.0), model(0.5, waves), model(1.0, dry))), 0.0)
    assert share_of(found, waves).probability > 0.9


def test_what_each_records_own_values_refute_is_improbable_beside_what_remains() -> None:
    base = model(9.0)
    found = search((base, model(1.0, SPRING, seed=1), model(5.0, WEIGHT, seed=2)), chosen=base)
    before, after = (
        {(c.name, c.where): c.probability for c in grade(NONE, one, 0.9).effects}
        for one in (found, replace(found, refuted=(SPRING,)))
    )
    assert before[SPRING] > 0.9 and after[SPRING] <= CRITERIA.false_alarms
    assert after[WEIGHT] == before[WEIGHT]


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_robot_that_lacks_something_lacks_other_things_at_the_base_rate(p: float, left: float) -> None:
    """Only what was refuted is below it, and nothing rises beyond it; selected effects stay as they are."""
    odds = {SPRING: 0.97, WEIGHT: p, BIAS: p}
    rated = tuple(RatedEffect(*name, odds[name], name == SPRING, (), {}) for name in odds)
    found = of_robot(Grade(rated, 0.0, (0.0, 0.0), False, 1.0, 0.9), [BIAS], left)
    now = {(c.name, c.where): c.probability for c in found.effects}
    assert found.effects[0].selected and now[SPRING] == 0.97 and now[BIAS] == p
    assert CRITERIA.base_rate <= now[WEIGHT] <= max(p, CRITERIA.base_rate) + 1e-12
    if left == 1.0 and p >= CRITERIA.base_rate:
        assert now[WEIGHT] == pytest.approx(p)


def test_what_other_values_in_each_record_explain_is_no_part_of_a_robots_gap() -> None:
    """Shares are of a smaller gap then; their intervals reach from the old to the new one."""
    spring = RatedEffect(*SPRING, 0.97, True, (), {}, share=0.6, share_interval=(0.5, 0.65), alone=0.6)
    found = Grade((spring,), 0.4, (0.3, 0.5), True, 10.0, 0.9)
    part, whole = of_robot(found, (), 0.4), of_robot(found, (), 1.0)
    assert (whole.remainder, whole.gap, whole.unknown) == (0.4, 10.0, True)
    # what remains may have made it look like what it is not
    assert whole.effects == (replace(spring, probability=0.97 - 0.4 * 0.47),)
    (one,) = part.effects
    assert one.share is not None and one.share + part.remainder == pytest.approx(1.0)
    assert part.gap == pytest.approx(7.6) and part.remainder == pytest.approx(0.16 / 0.76)
    assert one.share_interval == pytest.approx((0.5, 0.65 / 0.76)) and part.beyond_floor == pytest.approx(
        0.684
    )
    assert of_robot(found, (), 0.0).remainder == 0.0 and not of_robot(found, (), 0.0).unknown


@given(
    share=st.floats(-1.0, 0.99), end=st.floats(-1.0, 1.0), p=st.floats(0.0, 1.0), others=st.floats(0.0, 0.5),
    left=st.floats(0.0, 1.0),
)  # fmt: skip
@example(
    share=-0.24, end=-0.1, p=0.92, others=0.0, left=0.122
)  # one that predicts worse: once -7e10 came of it
def test_probabilities_and_shares_stay_such_whatever_remains(
    share: float, end: float, p: float, others: float, left: float
) -> None:
    """What is selected may predict worse than nothing, and other values may explain all that remains."""
    low, high = min(share, end), max(share, end)
    one = RatedEffect(
        *SPRING, p, True, (), {}, share=share, share_interval=(low, high), others=others, alone=0.5
    )
    found = of_robot(Grade((one,), min(1.0 - share, 1.0), (0.0, 1.0), False, 10.0, 0.9), (), left)
    (rated,) = found.effects
    assert 0.0 <= rated.probability <= p and 0.0 <= rated.others <= others
    assert rated.share is not None and rated.share_interval is not None and rated.alone is not None
    least, most = rated.share_interval
    assert -1.0 <= least <= rated.share <= most <= 1.0 and abs(rated.alone) <= 1.0
    assert 0.0 <= found.remainder <= 1.0 + 1e-9 and 0.0 < found.gap <= 10.0


@given(first=st.floats(1.0, 100.0), last=st.floats(1.0, 300.0), structural=st.floats(0.01, 1.0))
def test_no_share_is_more_than_all_where_a_model_predicts_worse(
    first: float, last: float, structural: float
) -> None:
    found = grade(NONE, search((model(first), model(last, SPRING))), structural)
    share = share_of(found, SPRING).share
    assert share is not None and -1.0 - 1e-9 <= share <= 1.0 + 1e-9 and 0.0 <= found.remainder <= 1.0 + 1e-9


@pytest.mark.parametrize("left", [1.0, 0.3])
@pytest.mark.parametrize("structural", [0.02, 0.29])
def test_a_quiet_joint_of_a_robot_lacks_nothing_that_is_unknown(structural: float, left: float) -> None:
    """All of what it leaves is its remainder, and next to nothing of that is structural."""
    start = model(100.0)
    quiet = grade(NONE, search((start, model(99.9, BIAS, seed=5)), chosen=start), structural)
    assert not quiet.unknown and not of_robot(quiet, (), left).unknown


def test_an_image_of_something_else_is_as_doubtful_with_a_rival_as_without() -> None:
    alone = RatedEffect(*SPRING, 0.96, True, (), {}, share=0.6, share_interval=(0.5, 0.65))
    tie = replace(alone, probability=0.5, tied_with=("@".join(WEIGHT),), others=0.46)
    rival = RatedEffect(*WEIGHT, 0.46, False, ("@".join(SPRING),), {})
    one = of_robot(Grade((alone,), 0.4, (0.3, 0.5), True, 10.0, 0.9), (), 1.0)
    two = of_robot(Grade((tie, rival), 0.4, (0.3, 0.5), True, 10.0, 0.9), (), 1.0)
    assert two.effects[0].together == pytest.approx(one.effects[0].probability)


@pytest.mark.parametrize(("surely", "most", "unknown"), [(0.02, 0.6 / 0.85, False), (0.12, 0.6, True)])
def test_a_robot_lacks_what_surely_remains_and_a_remainder_that_may_be_none_widens_the_shares(
    surely: float, most: float, unknown: bool
) -> None:
    spring = RatedEffect(*SPRING, 0.97, True, (), {}, share=0.55, share_interval=(0.5, 0.6))
    found = of_robot(Grade((spring,), 0.15, (surely, 0.4), False, 10.0, 0.9), (), 1.0)
    assert found.effects[0].share_interval == pytest.approx((0.5, most)) and found.unknown is unknown


def leaving(residual: np.ndarray, share: float, **components: None) -> Any:
    return SimpleNamespace(
        result=SimpleNamespace(residual=[residual]),
        autocorrelation=share,
        system=SimpleNamespace(components=components),
    )


def test_what_has_a_cause_is_what_has_colour_or_a_signal() -> None:
    error = np.ones((100, 1))
    torque = [SimpleNamespace(share=0.15), SimpleNamespace(share=0.05)]
    assert structural_share(leaving(error, 0.8), []) == 0.8
    assert (
        structural_share(leaving(error, 0.8), [], 0.05) == 0.0
    )  # each record's own values leave white noise
    # colour that small random torques leave counts where a torque of some signal explains it elsewhere
    assert structural_share(leaving(error, 0.2), torque) == 0.15
    assert structural_share(leaving(error, 0.1), torque) == 0.1
    assert structural_share(leaving(error, 0.2), [SimpleNamespace(share=-0.5)]) == 0.0
    # behind play nobody has measured the link, and no torque of a signal is looked for
    loose = leaving(error, 0.2, **{"joint1/transmission/backlash": None})
    assert behind_play(loose) and structural_share(loose, []) == 0.2
    # errors far below the noise have no cause
    assert structural_share(leaving(0.05 * error, 0.9), torque) == 0.0
