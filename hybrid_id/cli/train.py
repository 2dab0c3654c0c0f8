"""`train`: the same objective by the adjoint method."""

from hybrid_id.cli.options import SourceArgument


def train(source: SourceArgument) -> None:
    """Train through the differential equation by the adjoint method."""
    raise NotImplementedError
