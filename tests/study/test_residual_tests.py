"""What a model leaves of records: noise where it is right, and colour where it lacks something."""

from dataclasses import replace

from gapcase import small_case

from hybrid_id.components import REGISTRY
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.step import Engine
from hybrid_id.study.checks import residual_tests
from hybrid_id.systems import System


def test_a_right_model_leaves_noise_and_a_poorer_one_does_not(
    diagnosed: tuple[Dataset, System, Diagnosis],
) -> None:
    dataset, _, found = diagnosed
    poorer, right = found.search.base, found.search.chosen
    (before,) = residual_tests(dataset, poorer.system, poorer.result.engine)
    (after,) = residual_tests(dataset, right.system, right.result.engine)
    assert before.verdict == "not white" and before.rms > 3.0 and before.shared > 0.8
    assert after.verdict in ("white", "nearly white") and 0.8 < after.rms < 1.3
    assert after.output == "q_m1" and after.samples == dataset.test[0].n_samples


def test_train_records_speak_where_none_is_a_test(sound: tuple[Dataset, System, Diagnosis]) -> None:
    dataset, _, found = sound
    base = found.search.base
    alone = replace(dataset, records=dataset.train)
    (told,) = residual_tests(alone, base.system, base.result.engine)
    assert told.samples == sum(record.n_samples for record in dataset.train)
    assert 0.8 < told.rms < 1.3


def test_noise_that_is_not_declared_is_estimated() -> None:
    dataset, today = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    silent = replace(dataset, outputs=tuple(replace(c, noise_std=None) for c in dataset.outputs))
    (declared,), (estimated,) = (residual_tests(one, today, Engine()) for one in (dataset, silent))
    assert abs(estimated.rms / declared.rms - 1.0) < 0.3
