"""The model file that a user of the twin's records would start from."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_id.twin.settings import read_settings


def model_description(config: Mapping[str, Any], seed: int, *, priors: bool = False) -> dict[str, Any]:
    """Content of the model file that the identification starts from.

    Args:
        config: the settings of the twin.
        seed: of the errors of the start values.
        priors: add `prior_std` (centre: the nominal) where the settings give one; it replaces being held.
    """
    twin = read_settings(config)
    names = twin.kind.parameters
    size = twin.model.start_error
    random = np.random.default_rng([seed, len(twin.excitation.experiments)])
    factors = random.uniform(1 - size, 1 + size, len(names))

    def entry(name: str, factor: float) -> dict[str, Any]:
        known = twin.model.parameters[name]
        off_truth = float(f"{twin.truth[name] * factor:.6g}")
        values: dict[str, Any] = {
            "nominal": off_truth if known.nominal is None else known.nominal,
            "lower": known.lower,
            "upper": known.upper,
            "unit": known.unit,
        }
        if priors and known.prior_std is not None:
            values["prior_std"] = known.prior_std
        elif not known.estimate:
            values["estimate"] = False
        return values

    entries = {name: entry(name, factor) for name, factor in zip(names, factors, strict=True)}
    components = [
        {
            "place": place,
            "kind": kind,
            "parameters": {symbol: entries.pop(name) for symbol, name in here.items()},
        }
        for place, kind, here in twin.kind.components
    ]
    return {
        "system": twin.kind.system,
        "gear_ratio": list(twin.gear_ratios),
        "gravity": "none",
        "parameters": entries,
        "components": components,
    }
