"""Physical and hybrid identification of robot drives.

The public names below are imported on first use: `import hybrid_id` costs milliseconds, and reading
records never loads torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from hybrid_id.errors import InputError as InputError

# public name -> the module that defines it; the imports above say the same to type checkers
_HOME = {
    "InputError": "hybrid_id.errors",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its module on first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, imported or not."""
    return sorted(set(globals()) | set(_HOME))
