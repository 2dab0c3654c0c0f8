"""The twin as a machine that a controller drives, one call a sample."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hybrid_id.machines.physics.stick_slip import advance
from hybrid_id.machines.twin.campaign import Truth, draw_torques, draw_truth, encoders, read_encoder, ripples
from hybrid_id.machines.twin.settings import read_settings, start_state


class Plant:
    """Runs of a twin side by side, with all its disturbances, at the sample time of its settings.

    Args:
        config: the settings, see `configs/twin_*.yaml`; the experiments are not used.
        seeds: one for each of B runs, of its drift, start angle, random torques and encoder noise.
        pose: joint angles at the start [rad], before the random start angle; zero where it is left out.

    Attributes:
        truths: parameters of each run.
        states: true angles and speeds by name (q_m1, v_m1, ...), (B,) each.
    """

    def __init__(
        self, config: Mapping[str, Any], seeds: Sequence[int], *, pose: Sequence[float] | None = None
    ) -> None:
        twin = self._twin = read_settings(config)
        machine = twin.simulated
        self._random = [np.random.default_rng([seed, len(twin.excitation.experiments) + 1]) for seed in seeds]
        pose = [0.0] * len(machine.motors) if pose is None else pose
        self.truths: list[Truth] = [draw_truth(twin, pose, random) for random in self._random]
        values = {name: np.array([truth[name] for truth in self.truths]) for name in machine.parameters}
        angles = np.array([[truth[f"q_0{motor}"] for truth in self.truths] for motor in machine.motors])
        self._mechanism = machine.build(values, twin.gear_ratios, ripples(twin))
        self._x = start_state(machine, angles, twin.gear_ratios)
        self._mode = self._mechanism.initial_mode(self._x)

    @property
    def states(self) -> dict[str, np.ndarray]:
        """True angles and speeds by name, (B,) each."""
        return dict(zip(self._twin.simulated.rows, self._x, strict=True))

    def measure(self) -> dict[str, np.ndarray]:
        """Readings of the encoders by name (q_m1, ...), (B,) each [rad]; every call draws new noise."""
        states = self.states
        return {
            name: np.array(
                [
                    read_encoder(q, encoder, random)
                    for q, random in zip(states[name], self._random, strict=True)
                ]
            )
            for name, encoder in encoders(self._twin).items()
        }

    def step(self, voltages: np.ndarray) -> dict[str, np.ndarray]:
        """Hold the voltages (n_motors, B) [V] for a sample, and measure at its end."""
        torques = np.array([draw_torques(self._twin, 1, random)[:, 0] for random in self._random]).T
        inputs = np.concatenate((np.broadcast_to(voltages, torques.shape), torques))
        self._x, self._mode = advance(
            self._mechanism,
            self._x,
            self._mode,
            inputs,
            self._twin.sample_time,
            substeps=self._twin.substeps,
        )
        return self.measure()
