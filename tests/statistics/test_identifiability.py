"""Degenerate directions are found, worded, and claimed by nobody; the combinations that remain are right."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hybrid_id.errors import InputError
from hybrid_id.statistics.identifiability import Combination, identifiability, simple_basis

SCALED = {"J", "P_m1", "f_11", "f_12", "f_21", "f_22", "f_3"}
SPEEDS = {"f_13", "f_14", "f_23", "f_24"}
# The paper's rigid link 1 (Table 2) with the acceleration as output: 12 parameters, 10 combinations.
DRIVE_NAMES = ["J", "P_m1", "P_m2", "f_11", "f_12", "f_13", "f_14", "f_21", "f_22", "f_23", "f_24", "f_3"]
DRIVE = np.array(
    [1.97e-5, 19.249e-3, 0.025, 0.010, 0.030, 10.541, 53.005, 0.010, 0.031, 11.313, 58.093, 5.04e-5]
)


def drive_output(p):
    """Acceleration of the motor for prescribed voltage and speed, complex parameters allowed (T,)."""
    time = 0.01 * np.arange(4000)
    speed = 300 * np.sin(time) + 200 * np.sin(2.3 * time + 1) + 50 * np.sin(7 * time)
    voltage = 10 * np.sin(0.9 * time) + 5 * np.cos(3.1 * time)
    size = np.abs(speed)
    forward = p[3] + (p[4] - p[3]) * np.exp(-(((size - p[5]) / p[6]) ** 2))
    backward = p[7] + (p[8] - p[7]) * np.exp(-(((size - p[9]) / p[10]) ** 2))
    friction = np.where(speed > 0, forward, -backward) + p[11] * speed
    return (p[1] * (voltage - p[2] * speed) - friction) / p[0]


def drive_jacobian(noise=0.01):
    """Exact Jacobian by complex steps, weighted by a noise relative to the output (T, 12)."""
    columns = []
    for k in range(DRIVE.size):
        moved = DRIVE.astype(complex)
        moved[k] += 1e-20j * DRIVE[k]
        columns.append(drive_output(moved).imag / (1e-20 * DRIVE[k]))
    return np.stack(columns, axis=1) / (noise * np.std(drive_output(DRIVE)))


def jacobian_of(function, values):
    """By complex steps; function (p,) -> (T,)."""
    columns = []
    for k, value in enumerate(values):
        moved = np.asarray(values, complex)
        moved[k] += 1e-20j * value
        columns.append(function(moved).imag / (1e-20 * value))
    return np.stack(columns, axis=1)


def test_the_papers_link_has_two_directions_and_ten_combinations():
    """READING.md, "What the paper's data cannot tell"."""
    result = identifiability(DRIVE, DRIVE_NAMES, jacobian=drive_jacobian(), references=["P_m1", "P_m2"])
    first, second = result.directions
    assert first.text.startswith("J, P_m1, f_11, f_12, f_21, f_22, f_3 may all be multiplied by one number")
    assert "P_m2 up and f_3 down together" in second.text and "P_m2 + f_3/P_m1 is what matters" in second.text
    assert result.condition_number == np.inf
    assert {c.text for c in result.combinations} == {
        "J/P_m1", "P_m2 + f_3/P_m1", "f_11/P_m1", "f_12/P_m1", "f_21/P_m1", "f_22/P_m1", *SPEEDS,
    }  # fmt: skip
    assert set(result.not_claimable) == SCALED | {"P_m2"}
    assert "no interval may be claimed for: J" in result.summary()


def test_combinations_do_not_change_along_the_directions_and_the_output_neither():
    result = identifiability(DRIVE, DRIVE_NAMES, jacobian=drive_jacobian(), references=["P_m1"])
    scale = np.array([1.7 if name in SCALED else 1.0 for name in DRIVE_NAMES])
    other = DRIVE * scale
    shift = 0.2 * DRIVE[2]
    other[2] += shift
    other[11] -= shift * other[1]
    np.testing.assert_allclose(drive_output(other), drive_output(DRIVE), rtol=1e-9)
    for combination in result.combinations:
        before, after = combination.evaluate(np.stack([DRIVE, other]))
        assert after == pytest.approx(before, rel=1e-3), combination.text


def test_predicted_errors_of_combinations_match_a_parametrisation_that_has_only_those():
    noise = 0.01
    result = identifiability(DRIVE, DRIVE_NAMES, jacobian=drive_jacobian(noise), references=["P_m1"])
    free = np.ones(12, bool)
    free[[1, 2]] = False  # P_m1 and P_m2 known: the ten others are the combinations up to constants
    fixed = drive_jacobian(noise)[:, free]
    error = np.sqrt(np.diag(np.linalg.inv(fixed.T @ fixed))) / DRIVE[free]
    found = dict(zip([c.text for c in result.combinations], result.combination_std, strict=True))
    assert found["J/P_m1"] == pytest.approx(error[0], rel=1e-6)
    assert found["f_14"] == pytest.approx(error[4], rel=1e-6)


def test_data_sheet_priors_hold_all_of_it():
    prior = np.zeros(12)
    prior[[1, 2]] = 1 / (0.03 * DRIVE[[1, 2]]) ** 2
    result = identifiability(DRIVE, DRIVE_NAMES, jacobian=drive_jacobian(), prior_precision=prior)
    assert result.not_claimable == ()
    assert result.relative_std[0] == pytest.approx(0.03, rel=0.05)
    assert result.prior_share[[1, 2]] == pytest.approx(1, abs=0.02)
    assert result.prior_share[6] < 0.01
    assert "the prior holds it to ±5.9 % (95 %)" in result.directions[0].text
    assert "none, thanks to the prior" in result.summary()


def test_a_measured_torque_lifts_the_scale():
    def with_torque(p):
        time = 0.01 * np.arange(4000)
        return np.concatenate(
            [drive_output(p) / 1e4, p[1] * (10 * np.sin(time) - p[2] * 100 * np.cos(2 * time)) / 1e-3]
        )

    result = identifiability(DRIVE, DRIVE_NAMES, jacobian=100 * jacobian_of(with_torque, DRIVE))
    assert result.directions == () and result.not_claimable == ()
    assert np.isfinite(result.condition_number)
    assert "all 12 parameters" in result.summary()


def test_poor_excitation_is_vague_and_good_excitation_is_not():
    names = ["a", "b"]

    def line(stretch):
        time = 1 + stretch * np.linspace(-1, 1, 500)
        return lambda p: p[0] * time + p[1]

    poor = identifiability(np.array([1.0, 1.0]), names, jacobian=10 * jacobian_of(line(1e-3), [1.0, 1.0]))
    good = identifiability(np.array([1.0, 1.0]), names, jacobian=10 * jacobian_of(line(1.0), [1.0, 1.0]))
    assert good.directions == () and good.claimable.all()
    assert not poor.claimable.any() and len(poor.directions) == 1
    assert "a up and b down" in poor.directions[0].text and "told" not in poor.directions[0].text
    assert 0.5 < poor.directions[0].relative_std < 30 and "only to ±" in poor.directions[0].text
    assert 10 < poor.condition_number < np.inf
    # Correlated residuals make the good one vague in the end, too.
    assert not identifiability(
        np.array([1.0, 1.0]), names, jacobian=10 * jacobian_of(line(1.0), [1.0, 1.0]), inflation=500
    ).claimable.any()


def test_a_parameter_without_effect_is_named_alone():
    jacobian = np.column_stack([np.ones(50), np.zeros(50), np.linspace(0, 1, 50)])
    result = identifiability(np.ones(3), ["a", "b", "c"], jacobian=100 * jacobian)
    assert [d.text for d in result.directions] == ["b has no effect on the outputs"]
    assert result.not_claimable == ("b",)
    assert [c.text for c in result.combinations] == ["a", "c"]


@pytest.mark.parametrize(
    ("function", "words", "texts"),
    [
        (lambda p, t: p[0] * p[1] * t + p[2], "a up and b down together, 1 %", {"a·b", "c"}),
        (lambda p, t: p[0] / p[1] * t + p[2], "a, b may all be multiplied", {"b/a", "c"}),
        (lambda p, t: (3 * p[0] + p[1]) * t + p[2], "a + 0.3333 b is what matters", {"a + 0.3333 b", "c"}),
        (lambda p, t: (3 * p[0] - p[1]) * t + p[2], "a and b up together", {"a - 0.3333 b", "c"}),
        (lambda p, t: p[0] ** 2 * p[1] * t + p[2], "a up and b down together, 2 %", None),
    ],
    ids=["product", "ratio", "sum", "difference", "power"],
)
def test_pairs(function, words, texts):
    values = np.array([2.0, 1.5, 1.0])
    time = np.linspace(0, 1, 200)
    result = identifiability(
        values, ["a", "b", "c"], jacobian=1e3 * jacobian_of(lambda p: function(p, time), values)
    )
    assert len(result.directions) == 1 and words in result.directions[0].text
    if texts:
        assert {c.text for c in result.combinations} == texts


def test_zero_needs_a_scale():
    jacobian = np.eye(2) * 100
    with pytest.raises(InputError, match="b is zero"):
        identifiability(np.array([1.0, 0.0]), ["a", "b"], jacobian=jacobian)
    result = identifiability(np.array([1.0, 0.0]), ["a", "b"], jacobian=jacobian, scale=np.array([1.0, 0.5]))
    np.testing.assert_allclose(result.relative_std, [0.01, 0.02])


@given(st.integers(0, 10_000), st.integers(1, 3))
def test_simple_basis_spans_the_same_space(seed, count):
    rng = np.random.default_rng(seed)
    space = np.linalg.qr(rng.standard_normal((6, count)))[0]
    basis = simple_basis(space)
    assert np.linalg.matrix_rank(basis) == count
    np.testing.assert_allclose(space @ (space.T @ basis), basis, atol=5e-3)


@given(st.integers(0, 10_000), st.lists(st.floats(-6, 6), min_size=3, max_size=3))
def test_units_do_not_matter(seed, decades):
    rng = np.random.default_rng(seed)
    jacobian = 30 * rng.standard_normal((50, 3))
    unit = 10.0 ** np.array(decades)
    first = identifiability(np.ones(3), list("abc"), jacobian=jacobian)
    second = identifiability(unit, list("abc"), jacobian=jacobian / unit)
    np.testing.assert_allclose(second.relative_std, first.relative_std, rtol=1e-6)


def test_covariance_of_a_combination_is_the_delta_method(rng):
    result = identifiability(DRIVE, DRIVE_NAMES, jacobian=drive_jacobian(), references=["P_m1"])
    ratio = next(c for c in result.combinations if c.text == "J/P_m1")
    spread = 1e-3 * DRIVE[[0, 1]]
    covariance = np.zeros((12, 12))
    covariance[[0, 1], [0, 1]] = spread**2
    sets = np.tile(DRIVE, (20_000, 1))
    sets[:, [0, 1]] += spread * rng.standard_normal((20_000, 2))
    assert ratio.std_error(DRIVE, covariance) == pytest.approx(np.std(ratio.evaluate(sets)), rel=0.05)


def test_a_parameter_that_has_ended_at_zero_takes_no_error_from_the_others():
    ratio = Combination("a/b", np.ones(1), np.array([[1.0, -1.0, 0.0]]))
    covariance = np.diag([0.04, 0.01, 1.0])
    assert ratio.std_error(np.array([1.0, 2.0, 0.0]), covariance) == pytest.approx(np.hypot(0.1, 0.025))
    assert ratio.std_error(np.array([0.0, 2.0, 3.0]), covariance) == pytest.approx(0.1)  # 0.2 / 2


def test_a_negative_parameter_scales_with_the_others():
    """``(P u - c w) / J`` with c < 0: all three may be multiplied by one number, and c/P is told, not c P."""
    rng = np.random.default_rng(0)
    u, w = rng.normal(size=(2, 500))
    jacobian = 1e3 * jacobian_of(lambda p: (p[0] * u - p[1] * w) / p[2], [2.0, -0.5, 3.0])
    told = identifiability(np.array([2.0, -0.5, 3.0]), ["P", "c", "J"], jacobian=jacobian, references=["P"])
    assert told.directions[0].text.startswith("P, c, J may all be multiplied by one number")
    assert [c.text for c in told.combinations] == ["c/P", "J/P"]


def test_one_that_is_told_far_better_does_not_drown_the_others() -> None:
    told = identifiability([1.0, 1.0], ["a", "b"], jacobian=np.diag([1e9, 1e1]))
    np.testing.assert_allclose(told.relative_std, [1e-9, 1e-1], rtol=1e-9)
