"""A supply that sags, against the circuit that it stands for."""

import numpy as np
import torch

from hybrid_id.components import SupplySag

RHO, SUPPLY, BACK_EMF = 0.2, 12.0, 0.03


def fed(command: list[float], speed: list[float]) -> np.ndarray:
    part = SupplySag(rho=RHO, V_0=SUPPLY, k_e=BACK_EMF)
    u, v = (torch.tensor(x, dtype=torch.float64) for x in (command, speed))
    return part.map(part.view(), u, v).detach().numpy()


def test_circuit_of_source_amplifier_and_winding_is_solved() -> None:
    resistance = 2.0
    command, speed = (
        np.array([12.0, 12.0, 6.0, -9.0, -9.0, 0.0]),
        np.array([0.0, 300.0, 100.0, -50.0, 200.0, 80.0]),
    )
    given = fed(command.tolist(), speed.tolist())
    duty, current = command / SUPPLY, (given - BACK_EMF * speed) / resistance
    supply = SUPPLY - RHO * resistance * duty * current
    np.testing.assert_allclose(given, duty * supply, rtol=1e-12)
