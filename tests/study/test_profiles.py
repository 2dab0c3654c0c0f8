"""Profile likelihoods of a study agree with its standard errors where the model is nearly linear, and say where not."""

from dataclasses import replace

import numpy as np
import pytest
from drives import make_records, multisine, only, rigid_drive

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.study import Study, identify, profiles
from hybrid_id.systems import System

CHANNELS = ((Channel("u1", "V"),), (Channel("q_m1", "rad", 0.02),))


def dataset() -> Dataset:
    truth = rigid_drive()
    records = make_records(truth, [multisine(k, samples=400) for k in range(2)], noise={"q_m1": 0.02})
    return Dataset("short", *CHANNELS, tuple(records), 0.002, signal_share=0.0)


DATA = dataset()


def studied(system: System, **settings) -> Study:
    return identify(DATA, system, pooled=True, **settings)


def test_a_profile_is_the_interval_of_the_standard_error_where_the_model_is_linear() -> None:
    study = studied(only(rigid_drive(), "J", "F_c"))
    told = []
    found = profiles(DATA, study, ["J"], progress=told.append)["J"]
    half = 1.96 * study.standard_errors(0)[study.names.index("J")]
    estimate = study.selected.values[study.names.index("J")]
    assert found.closed == (True, True)
    np.testing.assert_allclose(
        [found.lower, found.upper], [estimate - half, estimate + half], atol=0.1 * half
    )
    assert told[0] == "profile of J, fit 1"


def test_noise_of_inputs_widens_a_profile_as_it_does_the_standard_error() -> None:
    study = studied(only(rigid_drive(), "J", "F_c"))
    noisier = replace(study, input_error=3.0 * np.stack([cov.std_error for cov in study.covariances]))
    found = profiles(DATA, noisier, ["J"])["J"]
    half = 1.96 * noisier.standard_errors(0)[study.names.index("J")]
    assert half > 2.5 * 1.96 * study.standard_errors(0)[study.names.index("J")]
    assert 0.5 * (found.upper - found.lower) == pytest.approx(half, rel=0.1)


def test_a_prior_counts_as_it_does_in_the_standard_error() -> None:
    start = only(rigid_drive(), "J", "P_m1", "F_c", "F_v")  # which may all be multiplied by one number
    spec = start.parameter("P_m1").spec
    start = start.with_specs({"P_m1": replace(spec, prior_mean=spec.value, prior_std=0.02 * spec.value)})
    study = studied(start)
    found = profiles(DATA, study, ["J"])["J"]
    half = 1.96 * study.standard_errors(0)[study.names.index("J")]
    assert half > 0.03 * study.selected.values[study.names.index("J")]
    assert 0.5 * (found.upper - found.lower) == pytest.approx(half, rel=0.1)


def test_where_the_records_do_not_tell_a_profile_is_open() -> None:
    start = only(rigid_drive(), "J", "P_m1", "F_c", "F_v")
    free = {n: replace(start.parameter(n).spec, lower=0.0, upper=1e6) for n in ("J", "P_m1", "F_c", "F_v")}
    found = profiles(DATA, studied(start.with_specs(free)), ["J"])["J"]
    assert found.closed == (False, False) and "do not identify" in found.message


def test_what_is_not_estimated_has_no_profile() -> None:
    study = studied(only(rigid_drive(), "J", "F_c"))
    with pytest.raises(InputError, match="'P_m2' is not estimated; give some of F_c, J"):
        profiles(DATA, study, ["P_m2"])
    with pytest.raises(InputError, match="nothing but J is estimated"):
        profiles(DATA, studied(only(rigid_drive(), "J")), ["J"])


def test_ctrl_c_keeps_the_profiles_that_are_complete() -> None:
    study, told = studied(only(rigid_drive(), "J", "F_c")), []

    def stop(words: str) -> None:
        told.append(words)
        if words.startswith("profile of F_c"):
            raise KeyboardInterrupt

    assert list(profiles(DATA, study, ["J", "F_c"], progress=stop)) == ["J"]
