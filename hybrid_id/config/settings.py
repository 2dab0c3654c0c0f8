"""What a study file asks for, as the settings of the engines and of the fits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hybrid_id.config import Hybrid, StudyConfig

if TYPE_CHECKING:
    from hybrid_id.identification.adjoint import TrainOptions
    from hybrid_id.identification.hybrid import HybridOptions
    from hybrid_id.simulation.solvers import OdeEngine


def fit_settings(config: StudyConfig) -> dict[str, Any]:
    """Arguments of :func:`hybrid_id.study.identify` as a study file asks."""
    from hybrid_id.identification.horizons import Horizon
    from hybrid_id.identification.least_squares import Options
    from hybrid_id.identification.objective import Loss
    from hybrid_id.simulation.step import Engine

    wish = config.identification
    return {
        "pooled": wish.pooled,
        "starts": wish.starts,
        "seed": wish.seed,
        "device": wish.device,
        "level": config.statistics.level,
        "horizon": Horizon.of(wish.window),
        "engine": Engine(wish.friction, wish.substeps, wish.width),
        "options": Options(wish.max_iterations, wish.tolerance, loss=Loss(wish.loss, wish.threshold)),
    }


def ode_engine(config: StudyConfig) -> OdeEngine:
    """The solver of differential equations that the section `training` asks for.

    Raises:
        InputError: there is no such solver; the key is named.
    """
    from hybrid_id.simulation.solvers import OdeEngine

    with config.at("training"):
        return OdeEngine(
            **config.training.model_dump(include={"substeps", "width", "fine", "method", "gradient"})
        )


def train_options(config: StudyConfig) -> TrainOptions:
    """How `train` descends without networks."""
    from hybrid_id.identification.adjoint import TrainOptions
    from hybrid_id.identification.objective import Loss

    return TrainOptions(
        windows=tuple(config.training.windows),
        loss=Loss(config.identification.loss, config.identification.threshold),
        **config.training.model_dump(include={"max_iterations", "tolerance", "validate_every"}),
    )


def hybrid_options(config: StudyConfig, wish: Hybrid) -> HybridOptions:
    """How `train` and `ablate` train physics with networks."""
    from hybrid_id.identification.hybrid import HybridOptions
    from hybrid_id.identification.objective import Loss

    return HybridOptions(
        windows=tuple(wish.windows),
        loss=Loss(config.identification.loss, config.identification.threshold),
        starts=config.identification.starts,
        seed=config.identification.seed,
        **wish.model_dump(exclude={"networks", "validation", "windows"}),
    )
