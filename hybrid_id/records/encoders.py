"""Two encoders on one joint against the gear ratio that a model has."""

from collections.abc import Sequence

import numpy as np

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.finding import Finding
from hybrid_id.records.measures import estimate_noise

OFF, WRONG = 0.02, 0.2
"""Relative difference between the records' ratio and the model's that is said, and from which no fit means anything."""
TOGETHER = 0.8
"""Correlation below which two angles hardly belong to one gear, unless it is very soft."""
MOVES = 20.0
"""Standard deviation of an angle over its noise from which it moves."""


def check_encoders(dataset: Dataset, gear_ratio: Sequence[float]) -> list[Finding]:
    """Findings of joints whose motor's angle is not the gear ratio times the link's, over all records.

    Play, compliance and errors of the gear change the angles for a while and not their ratio.

    Args:
        dataset: records; a joint counts that has ``q_m`` and ``q_a``.
        gear_ratio: of each joint.
    """
    found, names = [], {channel.name for channel in dataset.outputs}
    for n, ratio in enumerate(gear_ratio, start=1):
        motor, link = f"q_m{n}", f"q_a{n}"
        if not {motor, link} <= names:
            continue
        a, b = (
            np.concatenate([r.outputs[name] - r.outputs[name].mean() for r in dataset])
            for name in (motor, link)
        )
        noise = [max(estimate_noise(r.outputs[name]) for r in dataset) for name in (motor, link)]
        if any(q.std() <= MOVES * max(still, 1e-300) for q, still in zip((a, b), noise, strict=True)):
            continue  # noise has no ratio
        together = float(a @ b) / float(np.linalg.norm(a) * np.linalg.norm(b))
        seen = float(np.linalg.norm(a) / np.linalg.norm(b)) * (1.0 if together > 0 else -1.0)
        if abs(together) < TOGETHER:
            words = (
                f"joint {n}: {motor} and {link} hardly move together (correlation {together:.2f}); {link} is to be the "
                "angle between this link and the one before it"
            )
        elif abs(seen / ratio - 1.0) > OFF:
            words = (
                f"joint {n}: {motor} moves {seen:.4g} times {link} in the records, but the model's gear ratio is "
                f"{ratio:.4g}; correct gear_ratio, or unit or sign of one of them"
                + (f"; {link} is to be the angle against the link before" if n > 1 else "")
            )
        else:
            continue
        grave = abs(together) >= TOGETHER and abs(seen / ratio - 1.0) > WRONG
        found.append(Finding("error" if grave else "warning", "gear_ratio", words, channel=link))
    return found
