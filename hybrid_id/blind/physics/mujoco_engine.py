"""The same machines in MuJoCo 4: its motor, soft dry friction, series joints for play and flexibility.

A drive becomes a hinge whose armature is the rotor seen behind the gear, driven by a `dcmotor` through that gear; where
rotor and link can move apart, a second hinge in series is the twist between them, with a spring, or with limits for
play. MuJoCo's dry friction and its limits are soft constraints (they creep, they give way), which is the point: it is
another physics than that of the integrator beside it. `MujocoMachine` refuses laws that it has no counterpart for.
"""

import numpy as np

from hybrid_id.blind.physics.integrator import BRAKE, SETTLING, Machine
from hybrid_id.blind.physics.law import Signals
from hybrid_id.blind.physics.load import ConstantTorque
from hybrid_id.blind.physics.mujoco_document import Unsupported, document


class MujocoMachine:
    """A machine in MuJoCo, one simulation a run; every run has the same parameters.

    Args:
        machine: drives and links, as the integrator beside it takes them.

    Raises:
        Unsupported: a law has no counterpart here.
    """

    def __init__(self, machine: Machine) -> None:
        import mujoco

        self._mujoco, self.drives = mujoco, machine.drives
        try:
            text = document(machine)
        except TypeError:  # an array where a number is needed
            raise Unsupported("parameters that differ from run to run") from None
        self.model = mujoco.MjModel.from_xml_string(text)  # type: ignore[attr-defined]
        self._step = float(self.model.opt.timestep)
        joints = range(len(self.drives))
        self._rotor = [int(self.model.joint(f"rotor{i}").qposadr[0]) for i in joints]
        self._twist = [
            None if d.spring is None else int(self.model.joint(f"twist{i}").qposadr[0])
            for i, d in enumerate(self.drives)
        ]

    def begin(self, lanes: int, samples: int, sample_time: float, angles: np.ndarray | None = None) -> None:
        """Prepare B runs of so many samples [s]; they come to rest from angles zero, so that none may be given."""
        if angles is not None:
            raise Unsupported("a start elsewhere than at rest")
        self._steps, self._sample_time, self._sample = round(sample_time / self._step), sample_time, 0
        self._runs = [self._mujoco.MjData(self.model) for _ in range(lanes)]  # type: ignore[attr-defined]
        self._signals = [Signals(lanes) for _ in self.drives]
        for x in self._signals:
            x.history, x.sample_time, x.step = np.zeros((samples, lanes)), sample_time, self._step
        still = np.zeros((len(self.drives), 1))
        first = self._runs[0]
        for k in range(round(SETTLING / self._step)):
            self._mujoco.mj_step(self.model, self._pushed(first, still[:, 0]))  # type: ignore[attr-defined]
            first.qvel *= 1 - BRAKE * self._step
            if k % 200 == 19 and np.abs(first.qvel).max() < 1e-5:
                break
        for run in self._runs:
            run.qpos[:], run.act[:] = first.qpos, first.act
            run.qvel[:] = 0.0

    def advance(self, commands: np.ndarray, disturbance: np.ndarray) -> None:
        """Carry all runs over one sample with held commands and disturbing torques (n_joints, B) [V, N m]."""
        k, plain = self._sample, not any(drive.amplifier for drive in self.drives)
        for x, command in zip(self._signals, commands, strict=True):
            x.command = command
            x.history[k] = command
        for b, run in enumerate(self._runs):
            self._pushed(run, disturbance[:, b])
        for i in range(1 if plain else self._steps):
            volts = [
                self._volts(j, k * self._sample_time + (i + 0.5) * self._step)
                for j in range(len(self.drives))
            ]
            for b, run in enumerate(self._runs):
                run.ctrl[:] = [volt[b] for volt in volts]
                self._mujoco.mj_step(self.model, run, self._steps if plain else 1)  # type: ignore[attr-defined]
        self._sample += 1

    def angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Rotor and link angles (n_joints, B) [rad]."""
        q = np.array([run.qpos for run in self._runs]).T
        behind = q[self._rotor]
        twist = np.array([0.0 * q[0] if at is None else q[at] for at in self._twist])
        ratio = np.array([drive.gear.ratio for drive in self.drives])[:, None]
        return ratio * behind, behind + twist

    def _volts(self, joint: int, time: float) -> np.ndarray:
        """Voltage (B,) at the terminals of a motor."""
        x = self._signals[joint]
        x.time, volts = time, x.command
        for law in self.drives[joint].amplifier:
            volts = law.volts(volts, x)
        return volts

    def _pushed(self, run, disturbance: np.ndarray):
        """A run with torques on its rotors [N m]."""
        for i, drive in enumerate(self.drives):
            bias = sum(law.bias for law in drive.rotor_laws if isinstance(law, ConstantTorque))
            run.qfrc_applied[self._rotor[i]] = drive.gear.ratio * (disturbance[i] + bias)
        return run
