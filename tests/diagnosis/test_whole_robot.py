"""How long a whole robot runs free."""

from types import SimpleNamespace
from typing import Any

from gapcase import small_case

from hybrid_id.diagnosis.whole_robot import common_horizon
from hybrid_id.identification.horizons import WHOLE, Horizon


def answer(horizon: Horizon, inertia: float) -> Any:
    """A joint whose re-fitted model has so many times the true inertia."""
    dataset, nominal = small_case()
    (name,) = (info.name for info in nominal.table if info.symbol == "J")
    system = nominal.with_values({name: inertia * nominal.parameter(name).spec.value})
    fits = SimpleNamespace(horizon=horizon, dataset=dataset)
    return SimpleNamespace(fits=fits, found=SimpleNamespace(base=SimpleNamespace(system=system)))


def test_runs_that_have_lost_their_records_begin_again_from_measured_states() -> None:
    short = Horizon("windows", 0.5)
    good, lost = answer(WHOLE, 1.0), answer(WHOLE, 20.0)
    assert common_horizon({"lift": good, "elbow": good}, 0.1) == WHOLE
    found = common_horizon({"lift": good, "elbow": lost}, 0.1)
    assert found.seconds == short.seconds and "elbow" in found.reason and "lift" not in found.reason
    # what a joint asks for anyway stays
    assert common_horizon({"lift": answer(short, 1.0), "elbow": lost}, 0.1) == short
