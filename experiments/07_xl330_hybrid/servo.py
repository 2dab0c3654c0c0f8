"""The servo's records, its model, and what a training on some of the gains comes to on the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ladder import prepare  # pyright: ignore[reportMissingImports]

from hybrid_id.components import ResidualNetwork
from hybrid_id.identification.hybrid import HybridOptions, HybridResult, train_hybrid
from hybrid_id.identification.objective import Loss
from hybrid_id.records.record import Record
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import ModelFile, build_model


def build(config: Mapping[str, Any]) -> System:
    """The best physics model with a network."""
    how = dict(config["network"])
    system = build_model(ModelFile.model_validate(config["model"]))
    return system.with_component(how.pop("place"), ResidualNetwork(**how))


def rotate(config: Mapping[str, Any], records: Sequence[Record], gain: float) -> HybridResult:
    """Train on the records of all gains but one."""
    groups: dict[float, list[Record]] = {}
    for record in sorted(records, key=lambda r: r.name):
        groups.setdefault(float(record.signal(config["held_out"])[0]), []).append(record)
    rest = [group for key, group in groups.items() if key != gain]
    looked = [group[config["validates"]] for group in rest]
    train = [record for group in rest for record in group if record not in looked]
    system, wish = build(config), dict(config["training"])
    wish |= {"windows": tuple(map(tuple, wish["windows"]))}
    options = HybridOptions(**wish, loss=Loss("huber", delta=config["loss"]))
    engine = OdeEngine(fine=config["fine"], width=config["width"])
    data, held = prepare(config, system, train), prepare(config, system, looked)
    return train_hybrid(system, data, held, engine=engine, options=options)
