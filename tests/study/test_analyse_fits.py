"""Statistics of sets of which one is no estimate, of outputs that stand still, of longer samples; priors stay."""

from dataclasses import replace

import numpy as np
import torch
from drives import make_record, make_records, multisine, only, rigid_drive

from hybrid_id.parameters import Bounded
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.study import analyse_fits, identify, replay

CHANNELS = ((Channel("u1", "V"),), (Channel("q_m1", "rad", 0.02),))


def dataset(**test) -> Dataset:
    truth = rigid_drive()
    records = make_records(truth, [multisine(k, samples=300) for k in range(4)], noise={"q_m1": 0.02})
    records[3] = replace(records[3], role="test", **test)
    return Dataset("short", *CHANNELS, tuple(records), 0.002, signal_share=0.0)


def test_a_set_that_diverged_is_no_estimate() -> None:
    data, system = dataset(), only(rigid_drive(), "J", "F_c", "F_v")
    whole = identify(data, system)
    lost = replace(
        whole.sets[1], status="diverged", jacobian=[np.full_like(j, np.nan) for j in whole.sets[1].jacobian]
    )
    study = analyse_fits(data, system, (whole.sets[0], lost, whole.sets[2]), pooled=False)
    assert np.isnan(study.covariances[1].std_error).all()
    kept = np.array([whole.sets[k].values for k in (0, 2)])
    assert study.variation is not None
    np.testing.assert_allclose(study.variation.mean, kept.mean(0))
    assert all(np.isfinite(trust.std_error) or trust.grade == "D" for trust in study.reliability)


def test_an_output_that_stands_still_has_no_part_in_the_test_error() -> None:
    still = dataset(outputs={"q_m1": np.zeros(300)})
    assert np.isnan(identify(still, only(rigid_drive(), "J")).test_nrmse["run_3"])


def test_longer_samples_of_a_test_record_are_simulated_in_steps_that_they_need() -> None:
    data = dataset()
    truth = rigid_drive()
    slow = make_record(
        truth, multisine(3, samples=300), seed=3, noise={"q_m1": 0.02}, name="run_3", step=0.012
    )
    data = replace(data, records=(*data.records[:3], replace(slow, role="test")), sample_time=None)
    assert identify(data, only(truth, "J", "F_c")).test_nrmse["run_3"] < 0.1


def test_the_callers_model_stays_where_it_is_and_a_prior_does_not_follow_the_estimate() -> None:
    assert Bounded(2.0, prior_std=0.1).prior_mean == 2.0
    assert Bounded(2.0, prior_std=0.1).at(3.0).prior_mean == 2.0
    system = only(rigid_drive(), "J")
    before = system.theta().detach().clone()
    identify(dataset(), system)
    assert torch.equal(system.theta().detach(), before)


def test_cross_validation_is_a_replay_of_every_set_on_every_record() -> None:
    data = dataset()
    study = identify(data, only(rigid_drive(), "J", "F_c"))
    expected = [[one.fit["q_m1"] for one in replay(data, s.system, engine=s.engine)[:3]] for s in study.sets]
    np.testing.assert_allclose(study.cross_validation.fits[..., 0], expected, atol=1e-6)
