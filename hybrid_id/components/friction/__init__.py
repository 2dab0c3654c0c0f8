"""Friction laws: speed to a torque of its sign."""

from hybrid_id.components.friction.asymmetric import AsymmetricFriction
from hybrid_id.components.friction.asymmetric_stribeck import AsymmetricStribeck, AsymmetricStribeckEq8
from hybrid_id.components.friction.asymmetric_tanh import AsymmetricTanh
from hybrid_id.components.friction.coulomb import Coulomb
from hybrid_id.components.friction.dahl import Dahl
from hybrid_id.components.friction.effort_dependent import EffortDependent
from hybrid_id.components.friction.load_dependent import LoadDependent
from hybrid_id.components.friction.lugre import LuGre
from hybrid_id.components.friction.maxwell_slip import MaxwellSlip
from hybrid_id.components.friction.position_dependent import PositionDependent
from hybrid_id.components.friction.quadratic_drag import QuadraticDrag
from hybrid_id.components.friction.stribeck import Stribeck
from hybrid_id.components.friction.tight_spot import TightSpot
from hybrid_id.components.friction.viscous import Viscous

__all__ = [
    "AsymmetricFriction",
    "AsymmetricStribeck",
    "AsymmetricStribeckEq8",
    "AsymmetricTanh",
    "Coulomb",
    "Dahl",
    "EffortDependent",
    "LoadDependent",
    "LuGre",
    "MaxwellSlip",
    "PositionDependent",
    "QuadraticDrag",
    "Stribeck",
    "TightSpot",
    "Viscous",
]
