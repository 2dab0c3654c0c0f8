"""Rigid gear."""

from hybrid_id.components.base import Transmission


class Rigid(Transmission):
    """``q_m = r q_a``: the solid-body model (paper, Fig. 2). No state and no parameter."""

    kind = "rigid"
    rigid = True
