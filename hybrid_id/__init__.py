"""Physical and hybrid identification of robot drives.

The public names below are imported on first use: `import hybrid_id` costs milliseconds, and reading
records never loads torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from hybrid_id.components.base import Component as Component
    from hybrid_id.components.friction.asymmetric_stribeck import AsymmetricStribeck as AsymmetricStribeck
    from hybrid_id.components.friction.coulomb import Coulomb as Coulomb
    from hybrid_id.components.friction.dahl import Dahl as Dahl
    from hybrid_id.components.friction.load_dependent import LoadDependent as LoadDependent
    from hybrid_id.components.friction.lugre import LuGre as LuGre
    from hybrid_id.components.friction.stribeck import Stribeck as Stribeck
    from hybrid_id.components.friction.viscous import Viscous as Viscous
    from hybrid_id.components.motor.dc_motor import DCMotor as DCMotor
    from hybrid_id.components.transmission.backlash import Backlash as Backlash
    from hybrid_id.components.transmission.linear_spring import LinearSpring as LinearSpring
    from hybrid_id.components.transmission.rigid import Rigid as Rigid
    from hybrid_id.diagnosis.arm import diagnose_arm as diagnose_arm
    from hybrid_id.diagnosis.diagnose import diagnose as diagnose
    from hybrid_id.diagnosis.result import Diagnosis as Diagnosis
    from hybrid_id.errors import InputError as InputError
    from hybrid_id.identification.adjoint import train as train
    from hybrid_id.identification.fit import fit as fit
    from hybrid_id.identification.result import FitResult as FitResult
    from hybrid_id.parameters import Parameter as Parameter
    from hybrid_id.records.dataset import Dataset as Dataset
    from hybrid_id.records.excitation import design_multisine as design_multisine
    from hybrid_id.records.quality import check_dataset as check_dataset
    from hybrid_id.records.record import Channel as Channel
    from hybrid_id.records.record import Record as Record
    from hybrid_id.simulation.prepare import make_batch as make_batch
    from hybrid_id.simulation.rollout import simulate as simulate
    from hybrid_id.simulation.step import Engine as Engine
    from hybrid_id.study import Study as Study
    from hybrid_id.study import analyse_fits as analyse_fits
    from hybrid_id.study import check_identifiability as check_identifiability
    from hybrid_id.study import compare as compare
    from hybrid_id.study import identify as identify
    from hybrid_id.study import replay as replay
    from hybrid_id.systems.builders import one_link as one_link
    from hybrid_id.systems.builders import one_link_flexible as one_link_flexible
    from hybrid_id.systems.builders import two_link as two_link
    from hybrid_id.systems.chain import System as System
    from hybrid_id.systems.model_file import load_model as load_model
    from hybrid_id.systems.model_file import save_model as save_model

# The same names once more, by the module that defines them; a test keeps the two lists equal.
_MODULES = {
    "hybrid_id.components.base": "Component",
    "hybrid_id.components.friction.asymmetric_stribeck": "AsymmetricStribeck",
    "hybrid_id.components.friction.coulomb": "Coulomb",
    "hybrid_id.components.friction.dahl": "Dahl",
    "hybrid_id.components.friction.load_dependent": "LoadDependent",
    "hybrid_id.components.friction.lugre": "LuGre",
    "hybrid_id.components.friction.stribeck": "Stribeck",
    "hybrid_id.components.friction.viscous": "Viscous",
    "hybrid_id.components.motor.dc_motor": "DCMotor",
    "hybrid_id.components.transmission.backlash": "Backlash",
    "hybrid_id.components.transmission.linear_spring": "LinearSpring",
    "hybrid_id.components.transmission.rigid": "Rigid",
    "hybrid_id.errors": "InputError",
    "hybrid_id.diagnosis.arm": "diagnose_arm",
    "hybrid_id.diagnosis.diagnose": "diagnose",
    "hybrid_id.diagnosis.result": "Diagnosis",
    "hybrid_id.identification.adjoint": "train",
    "hybrid_id.identification.fit": "fit",
    "hybrid_id.identification.result": "FitResult",
    "hybrid_id.parameters": "Parameter",
    "hybrid_id.records.dataset": "Dataset",
    "hybrid_id.records.excitation": "design_multisine",
    "hybrid_id.records.quality": "check_dataset",
    "hybrid_id.records.record": "Channel Record",
    "hybrid_id.simulation.prepare": "make_batch",
    "hybrid_id.simulation.rollout": "simulate",
    "hybrid_id.simulation.step": "Engine",
    "hybrid_id.study": "Study analyse_fits compare identify check_identifiability replay",
    "hybrid_id.systems.builders": "one_link one_link_flexible two_link",
    "hybrid_id.systems.chain": "System",
    "hybrid_id.systems.model_file": "load_model save_model",
}
_HOME = {name: module for module, names in _MODULES.items() for name in names.split()}


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
