"""What a diagnosis of logs as a drive writes them costs: six train records of 8 s at 1 kHz, one link.

    python -m benchmarks.kilohertz

Processor time of one thread, a process for each missing effect, compilation included where it is not in the cache.
"""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np

from hybrid_id import Channel, Dataset, Record, diagnose, one_link, replay
from hybrid_id.components import REGISTRY

RATE, SECONDS, RECORDS = 1000.0, 8.0, 8
"""Samples a second, length of a record [s], and records, the last two of them test records."""
COUNT = 2 * np.pi / 4096
"""Angle of an encoder's count [rad]."""
MISSING = {
    "stribeck_friction": ("joint1/motor_friction", {"F_drop": 0.008, "v_s": 20.0}),
    "backlash": ("joint1/transmission", {"gap": 0.02}),
    "spring_load": ("joint1/load", {"k_s": 0.6, "q_s": 0.3}),
}


def logs(effect: str) -> Dataset:
    """Records of a drive with the effect: a multisine of voltage, counts of the motor's encoder."""
    where, values = MISSING[effect]
    drive = one_link(50.0).with_values({"J": 2.1e-5, "F_c": 0.008, "F_v": 5e-5})
    drive = drive.with_component(where, REGISTRY[effect](**values))
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", COUNT),)
    time_, random, records = np.arange(0.0, SECONDS, 1 / RATE), np.random.default_rng(0), []
    for k in range(RECORDS):
        tones = 0.3 + 4.0 * np.arange(1, 7) / 6
        phases = random.uniform(0.0, 2 * np.pi, len(tones))
        u = sum(2.0 * np.sin(2 * np.pi * f * time_ + p) for f, p in zip(tones, phases, strict=True))
        u = np.where(time_ < 0.2, 0.0, u)
        empty = Dataset("logs", *channels, (Record("run", time_, {"u1": u}, {"q_m1": 0 * time_}),))
        angle = np.round(replay(empty, drive)[0].outputs["q_m1"] / COUNT) * COUNT
        role = "train" if k < RECORDS - 2 else "test"
        records.append(Record(f"run{k}", time_, {"u1": u}, {"q_m1": angle}, role))
    return Dataset("logs", *channels, tuple(records), 1 / RATE)


def main() -> None:
    """Diagnose each, in a process of its own."""
    if len(sys.argv) > 1:
        dataset, begun = logs(sys.argv[1]), time.process_time()
        found = diagnose(dataset, one_link(50.0).with_values({"J": 2.3e-5, "F_c": 0.012, "F_v": 6e-5}))
        named = [name for name, _ in found.search.chosen.effects]
        print(
            f"{sys.argv[1]}: {named}, {time.process_time() - begun:.0f} s, samples {found.sample_time} s apart"
        )
        return
    for effect in MISSING:
        subprocess.run([sys.executable, "-m", "benchmarks.kilohertz", effect], check=True)


if __name__ == "__main__":
    main()
