"""The parameters of a system as one table, each with a name of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

from torch import nn

from hybrid_id.components.base import Component
from hybrid_id.parameters import ParameterInfo


def parameter_table(components: nn.ModuleDict, aliases: Mapping[tuple[str, str], str]) -> list[ParameterInfo]:
    """All parameters in the components' order.

    A name is the alias, or the symbol where no other component has it, or the symbol with the component's key.

    Args:
        components: by key, ``joint1/motor_friction/coulomb_friction``.
        aliases: preferred names by key and symbol.
    """
    entries = [(key, s) for key, c in components.items() for s in cast(Component, c).declared]
    symbols = [symbol for _, symbol in entries]
    table = []
    for key, symbol in entries:
        part = cast(Component, components[key])
        name = aliases.get((key, symbol))
        if name is None:
            joint, place, kind = key.split("/")
            name = symbol if symbols.count(symbol) == 1 else f"{symbol}_{joint}_{place}_{kind}"
        table.append(ParameterInfo(name, key, symbol, part.declared[symbol].doc, part.specs[symbol]))
    return table
