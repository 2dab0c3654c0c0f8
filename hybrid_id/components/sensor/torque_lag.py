"""Joint torque sensor that is read late."""

from types import SimpleNamespace

from torch import Tensor

from hybrid_id.components.base import Component, StateUpdate
from hybrid_id.parameters import Parameter


class TorqueLag(Component):
    """``T_s dz/dt = tau_a - z``: the torque at the link is read through a filter, as z.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | z | N m | state: reading before gain and offset |
    | T_s | s | time constant of the filter: slow signals are late by it |

    Source: first-order filter of a strain gauge's amplifier; a dead time T_s seen to the first order. Channels that are
    late by a known time are shifted by the key ``skew`` of dataset.yaml instead.
    """

    kind = "torque_lag"
    places = ("sensor",)
    states = ("tau_z",)
    T_s = Parameter(0.005, lower=1e-4, upper=0.5, unit="s", doc="time constant of the reading")

    def state_update(self, p: SimpleNamespace, torque: Tensor) -> StateUpdate:
        """How its state goes on under a torque [N m], ``(B,)``."""
        return StateUpdate(torque / p.T_s, (1.0 / p.T_s).expand_as(torque))

    def mjcf(self, p):
        return {}, "is left out, the exported model has no torque sensor"
