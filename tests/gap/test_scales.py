"""What start values are measured by does not depend on what has been added already."""

import pytest
from gapcase import small_case

from hybrid_id.components import Dahl, ElectricalLag
from hybrid_id.gap.scales import scales
from hybrid_id.study.replays import batch_of


@pytest.mark.parametrize(
    ("place", "part"), [("motor", ElectricalLag(T_e=0.01)), ("motor_friction", Dahl(sigma=0.1))]
)
def test_torque_is_known_beside_what_remembers(place, part) -> None:
    dataset, today = small_case()
    richer = today.with_component(f"joint1/{place}", part)
    plain, known = (scales(s, batch_of(dataset, s, dataset.train, 0.1, "cpu"))[0] for s in (today, richer))
    assert known.torque == pytest.approx(plain.torque)
    assert known.dry == pytest.approx(plain.dry, rel=1e-3)
