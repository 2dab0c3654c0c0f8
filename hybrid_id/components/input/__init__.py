"""Input stage: logged channels to the motor's command."""

from hybrid_id.components.input.current_command import CurrentCommand
from hybrid_id.components.input.deadband import Deadband
from hybrid_id.components.input.delay import Delay
from hybrid_id.components.input.duty import DutySupply
from hybrid_id.components.input.position_loop import PositionLoop
from hybrid_id.components.input.saturation import Saturation
from hybrid_id.components.input.soft_saturation import SoftSaturation
from hybrid_id.components.input.supply_sag import SupplySag
from hybrid_id.components.input.torque_command import TorqueCommand
from hybrid_id.components.input.voltage import Voltage

__all__ = [
    "CurrentCommand",
    "Deadband",
    "Delay",
    "DutySupply",
    "PositionLoop",
    "Saturation",
    "SoftSaturation",
    "SupplySag",
    "TorqueCommand",
    "Voltage",
]
