"""The main job: from records and a model to parameter sets with their statistics, and models side by side."""

from hybrid_id.identification.horizons import Horizon
from hybrid_id.identification.keep import Kept
from hybrid_id.study.base_parameters import BaseParameterCheck, check_base_parameters
from hybrid_id.study.checks import (
    ModelCheck,
    check_fit,
    check_identifiability,
    check_model,
    check_priors,
    check_scales,
    check_start_values,
    profiles,
)
from hybrid_id.study.replay import Comparison, Replay, compare, replay
from hybrid_id.study.result import Combinations, Study
from hybrid_id.study.run import analyse_fits, identify

__all__ = [
    "BaseParameterCheck",
    "Combinations",
    "Comparison",
    "Horizon",
    "Kept",
    "ModelCheck",
    "Replay",
    "Study",
    "analyse_fits",
    "check_base_parameters",
    "check_fit",
    "check_identifiability",
    "check_model",
    "check_priors",
    "check_scales",
    "check_start_values",
    "compare",
    "identify",
    "profiles",
    "replay",
]
