"""Everything that acts in a drive chain: one law, one class, one file.

A module in a folder here is found by itself and its classes are registered: no list names them. Every law's class can
be imported from here by its name.
"""

from importlib import import_module
from pkgutil import walk_packages
from typing import Any

from hybrid_id.components.base import CATALOGUE, PLACES, REGISTRY, Component, Effect

__all__ = ["CATALOGUE", "PLACES", "REGISTRY", "Component", "Effect"]

for _module in walk_packages(__path__, f"{__name__}."):
    import_module(_module.name)


def __getattr__(name: str) -> Any:
    """A law's class (PEP 562)."""
    for law in REGISTRY.values():
        if law.__name__ == name and law.__module__.startswith(__name__):
            return law
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
