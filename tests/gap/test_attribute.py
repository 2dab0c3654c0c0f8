"""An effect that is taken out again leaves nothing behind."""

import pytest
from gapcase import small_case

from hybrid_id.gap.attribute import _without
from hybrid_id.gap.catalogue import CATALOGUE
from hybrid_id.gap.scales import scales
from hybrid_id.study.replays import batch_of


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_model_without_an_effect_is_the_one_before(name: str) -> None:
    dataset, today = small_case()
    size = scales(today, batch_of(dataset, today, dataset.train, 0.1, "cpu"))[0]
    for where, models in CATALOGUE[name].models(today, size).items():
        for richer in models:
            assert set(richer.components) > set(today.components) or name in ("backlash", "joint_flexibility")
            plain = _without(richer, today, (name, where))
            assert plain is not None
            assert set(plain.components) == set(today.components)
