"""A small gap: three train records and one test record of a drive, with or without something that its model lacks."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from drives import make_records, multisine, rigid_drive

from hybrid_id.components.base import CATALOGUE, Component
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.systems import System

STEP, SAMPLES, NOISE, RATIO = 0.005, 300, 0.02, 50.0
WHERE = "joint1/load"
MADE: dict[tuple | None, Dataset] = {}
"""What has been simulated: many tests begin with the same records, and none changes them."""


@contextmanager
def only(*effects: str) -> Iterator[None]:
    """A catalogue of some effects, so that a search takes a second."""
    before = dict(CATALOGUE)
    for name in set(CATALOGUE) - set(effects):
        del CATALOGUE[name]
    try:
        yield
    finally:
        CATALOGUE.clear()
        CATALOGUE.update(before)


def small_case(missing: Component | None = None, where: str = WHERE) -> tuple[Dataset, System]:
    """Records of 1.5 s of a drive with ``missing`` somewhere, and the nominal model, whose values are a little off."""
    key = (
        None
        if missing is None
        else (where, type(missing), tuple((n, s.value) for n, s in missing.specs.items()))
    )
    if key not in MADE:
        MADE[key] = _simulated(missing, where)
    nominal = rigid_drive(ratio=RATIO).with_values({"J": 2.3e-5, "F_c": 0.009, "F_v": 6e-5})
    return MADE[key], nominal


def _simulated(missing: Component | None, where: str) -> Dataset:
    truth = rigid_drive(ratio=RATIO)
    truth = truth if missing is None else truth.with_component(where, missing)
    voltages = [multisine(k, samples=SAMPLES, amplitude=6.0 + k, rest=20, step=STEP) for k in range(4)]
    records = make_records(truth, voltages, noise={"q_m1": NOISE}, step=STEP)
    records[3] = replace(records[3], role="test")
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", NOISE),)
    return Dataset("small gap", *channels, tuple(records), STEP)
