"""A small gap: three train records and one test record of a drive, with or without something that its model lacks."""

from dataclasses import replace

from drives import make_records, multisine, rigid_drive

from hybrid_id.components.base import Component
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.systems import System

STEP, SAMPLES, NOISE, RATIO = 0.005, 300, 0.02, 50.0
WHERE = "joint1/load"


def small_case(missing: Component | None = None) -> tuple[Dataset, System]:
    """Records of 1.5 s of a drive with ``missing`` at its link, and today's model, whose values are a little off."""
    truth = rigid_drive(ratio=RATIO)
    truth = truth if missing is None else truth.with_component(WHERE, missing)
    voltages = [multisine(k, samples=SAMPLES, amplitude=6.0 + k, rest=20, step=STEP) for k in range(4)]
    records = make_records(truth, voltages, noise={"q_m1": NOISE}, step=STEP)
    records[3] = replace(records[3], role="test")
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", NOISE),)
    today = rigid_drive(ratio=RATIO).with_values({"J": 2.3e-5, "F_c": 0.009, "F_v": 6e-5})
    return Dataset("small gap", *channels, tuple(records), STEP), today
