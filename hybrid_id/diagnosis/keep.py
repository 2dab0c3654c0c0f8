"""Models of a search that are kept in a folder: a fit, and what records left out say of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping

import numpy as np

from hybrid_id.diagnosis.model import FittedModel, Name
from hybrid_id.diagnosis.validation import Validation
from hybrid_id.identification.keep import Arrays, Kept, pack_result, same_but_for_values, unpack_result
from hybrid_id.systems.chain import System


def kept_model(
    kept: Kept,
    made_from: object,
    effects: tuple[Name, ...],
    start: System,
    fit: Callable[[], FittedModel | None],
) -> FittedModel | None:
    """A fitted model: read if it is kept, otherwise made and kept.

    Args:
        kept: where the fits are.
        made_from: all that decides it.
        effects: of the model.
        start: the system that the fit starts from.
        fit: makes it; None where the model cannot be fitted.
    """

    def pack(model: FittedModel | None) -> Arrays | None:
        if model is None:
            return {}
        if not same_but_for_values(model.result, start):
            return None
        seen = model.validation
        more = {"effective": seen.effective, "judged": model.judged}
        return pack_result(model.result) | {
            "more": np.array(json.dumps(more)), "blocks": seen.blocks, "sizes": seen.sizes, "row": seen.row,
            "record": seen.record,
        }  # fmt: skip

    def unpack(arrays: Mapping[str, np.ndarray]) -> FittedModel | None:
        if "about" not in arrays:
            return None
        more = json.loads(str(arrays["more"]))
        seen = Validation(
            arrays["blocks"], arrays["sizes"], arrays["row"], more["effective"], arrays["record"]
        )
        return FittedModel(effects, unpack_result(arrays, start), seen, more["judged"])

    return kept.of(made_from, fit, pack, unpack)
