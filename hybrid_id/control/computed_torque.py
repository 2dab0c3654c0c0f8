"""Computed torque: the identified model, turned round, says which voltages or torques a motion needs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from hybrid_id.components.input.current_command import CurrentCommand
from hybrid_id.components.input.torque_command import TorqueCommand
from hybrid_id.components.input.voltage import Voltage
from hybrid_id.control.reference import Reference
from hybrid_id.errors import InputError
from hybrid_id.systems.chain import System

SMOOTHING = 0.01
"""Standard deviation [s] of the Gaussian that smooths the motion planned for a motor behind a gear with play."""


class ComputedTorque:
    """``u = (M (a_d + K_v e_v + K_p e_q) + c + friction) / (torque per unit of u)``, for many models at once.

    Angles and speeds are the motors'. Behind a rigid gear M and c are taken at the measured state, so that with the
    right model the error obeys ``e'' + K_v e' + K_p e = 0``; dry friction is taken at the desired speed, which does
    not chatter. Behind a spring the motor must lead its link: the torque that the link's motion needs gives the
    spring's deflection (for the paper, the inverse of eq. 12), and the motor follows the angle planned so.

    Source: computed torque as in the paper's section III.C; J. Y. S. Luh, M. W. Walker, R. P. C. Paul, IEEE Trans.
    Automatic Control 25(3), 1980.

    Args:
        system: the identified model, of any number of joints; each is commanded by a voltage, current or torque.
        reference: desired motion at the links.
        bandwidth: of the error's dynamics [rad/s]: ``K_p = bandwidth^2``, ``K_v = 2 bandwidth``.
        limit: largest command of every motor, or one for each [V, A or N m, as it is commanded].
        theta: parameters of B variants of the model in table order, ``(n_p, B)``; the system's own, B = 1, by default.
        width: desired speed at which dry friction is compensated to 76 % [rad/s, motor].

    Raises:
        InputError: a joint that is commanded otherwise, or a reference with another number of joints.
    """

    def __init__(
        self,
        system: System,
        reference: Reference,
        *,
        bandwidth: float,
        limit: float | Sequence[float],
        theta: Tensor | None = None,
        width: float = 1.0,
    ) -> None:
        if reference.angle.shape[1] != len(system.joints):
            raise InputError(
                f"The reference moves {reference.angle.shape[1]} joints, but the model has {len(system.joints)}."
            )
        if system.tree is not None and system.tree.couplings:
            raise InputError("The model's motors are coupled, of which computed torque knows no inverse.")
        remembering = {system.state_names[row] for row in system.memory_rows}
        for joint in system.joints:
            if not isinstance(joint.drive.input[1], Voltage | CurrentCommand | TorqueCommand):
                raise InputError(
                    f"{joint.name} is not commanded by a voltage, current or torque, which computed torque needs."
                )
            drive = joint.drive
            if drive.windings or drive.maps or drive.delay or remembering.intersection(joint.state_names):
                raise InputError(
                    f"{joint.name} has a delay, a limit, a dead band or a state that remembers, of which computed "
                    "torque knows no inverse; leave these out of the controller's model."
                )
        self.system, self.width = system, width
        self.limit = torch.as_tensor(limit, dtype=torch.float64).expand(len(system.joints))[:, None]
        self.kp, self.kv = bandwidth**2, 2.0 * bandwidth
        theta = system.theta().detach()[:, None] if theta is None else theta
        self.lanes = theta.shape[1]
        self.views = system.views(list(theta))
        self.plan = self._plan(reference)
        self.rotors = [system.speed_rows.index(joint.positions[0] + 1) for joint in system.joints]

    def planned(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Angles [rad] and speeds [rad/s] that are planned for the motors at sample ``k``, ``(n_joints, B)`` each."""
        angle, speed = self.plan[k, :2, self.rotors].numpy()
        return angle, speed

    @torch.no_grad()
    def command(self, k: int, angles: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        """Commands of sample ``k``, limited.

        Args:
            k: number of the sample.
            angles: motor angles as the encoders read them [rad], ``(n_joints, B)``.
            speeds: motor speeds [rad/s].

        Returns:
            ``(n_joints, B)`` in V, A or N m, as each joint is commanded.
        """
        planned = self.plan[k]  # (3, n_speeds, B): angle, speed, acceleration of every rotor and link
        x = [self.plan.new_zeros(self.lanes) for _ in self.system.state_names]
        for s, row in enumerate(self.system.speed_rows):
            x[row - 1], x[row] = planned[0, s], planned[1, s]
        accelerations = list(planned[2])
        for j, joint in enumerate(self.system.joints):
            s = self.rotors[j]
            q, v = torch.as_tensor(angles[j]), torch.as_tensor(speeds[j])
            for key, encoder in joint.drive.encoders:
                q = q - encoder.read(self.views[key], torch.zeros_like(q))  # its reading at the model's zero
            error = self.kp * (planned[0, s] - q) + self.kv * (planned[1, s] - v)
            accelerations[s] = accelerations[s] + error
            if joint.rigid:
                x[joint.positions[0]], x[joint.positions[0] + 1] = q, v
        found = self._inverse(x, accelerations, planned[1], self.rotors)
        return found.clamp(-self.limit, self.limit).numpy()

    def _inverse(
        self, x: list[Tensor], accelerations: list[Tensor], along: Tensor, rotors: list[int]
    ) -> Tensor:
        """Commands with which the rotors accelerate so, ``(n_joints, B)``; dry friction acts along a speed."""
        zero = torch.zeros(self.lanes, dtype=along.dtype)
        magnitudes, forwards = list(along.abs()), list((along > 0).to(along.dtype))
        idle, driven = (
            self.system.balances(
                x, {name: zero + one for name in self.system.input_names}, self.views, magnitudes, forwards
            )
            for one in (0.0, 1.0)
        )
        reactions = idle.reactions(accelerations)
        found = []
        for s in rotors:
            balance = idle.speeds[s]
            level = balance.level
            if balance.factor is not None:
                level = (
                    level + balance.factor * balance.transmitted(accelerations[s], reactions[s] + zero).abs()
                )
            force = (
                balance.inertia * accelerations[s] + reactions[s] + torch.tanh(along[s] / self.width) * level
            )
            found.append((force - balance.smooth) / (driven.speeds[s].smooth - balance.smooth))
        return torch.stack(found)

    @torch.no_grad()
    def _plan(self, reference: Reference) -> Tensor:
        """Angles, speeds and accelerations of every rotor and link, ``(T, 3, n_speeds, B)``."""
        wanted = np.stack([reference.angle, reference.speed, reference.acceleration], 1)
        motions = torch.as_tensor(wanted)[..., None].expand(-1, -1, -1, self.lanes)
        columns = []
        for j, joint in enumerate(self.system.joints):
            link = motions[:, :, j]
            if joint.rigid:
                columns.append(joint.gear_ratio * link)
                continue
            rotor = self._lead(j, link, reference.sample_time)
            columns += [rotor, link]
        return torch.stack(columns, 2)

    def _lead(self, j: int, link: Tensor, step: float) -> Tensor:
        """Motion of a rotor, ``(T, 3, B)``, whose spring gives its link the torque that it needs."""
        joint = self.system.joints[j]
        if len(self.system.joints) > 1:
            raise InputError("Computed torque through a spring is built for one joint; make the gears rigid.")
        angle, speed, acceleration = (part.flatten() for part in link.unbind(1))
        views = {
            key: type(view)(**{n: v.expand(len(link), self.lanes).flatten() for n, v in vars(view).items()})
            for key, view in self.views.items()
        }
        r, zero = joint.gear_ratio, torch.zeros_like(angle)
        channels = {name: zero for name in self.system.input_names}
        forward = (speed > 0).to(speed.dtype)

        def shortage(deflection: Tensor) -> Tensor:
            """Torque that the link needs less the one that the spring gives."""
            x = [zero for _ in self.system.state_names]
            x[joint.positions[0]], x[joint.positions[0] + 1] = r * (angle + deflection), r * speed
            x[joint.positions[1]], x[joint.positions[1] + 1] = angle, speed
            balance = joint.balances(x, channels, views, [r * speed.abs(), speed.abs()], [forward, forward])[
                1
            ]
            return (
                balance.inertia * acceleration
                + torch.tanh(r * speed / self.width) * balance.level
                - balance.smooth
            )

        reach = torch.full_like(angle, 1e-4)
        while bool((shortage(reach) > 0).any() or (shortage(-reach) < 0).any()) and float(reach.max()) < 1.0:
            reach = 2.0 * reach
        low, high = -reach, reach
        for _ in range(50):
            middle = 0.5 * (low + high)
            short = shortage(middle) > 0
            low, high = torch.where(short, middle, low), torch.where(short, high, middle)
        deflection = _smooth((0.5 * (low + high)).reshape(len(link), self.lanes), SMOOTHING / step)
        rates = [deflection]
        for _ in range(2):
            rates.append(torch.gradient(rates[-1], spacing=step, dim=0)[0])
        return r * (link + torch.stack(rates, 1))


def _smooth(signal: Tensor, width: float) -> Tensor:
    """Convolution over time, the first axis, with a Gaussian of a standard deviation in samples."""
    half = max(1, round(4 * width))
    kernel = torch.exp(-0.5 * (torch.arange(-half, half + 1, dtype=signal.dtype) / max(width, 1e-3)) ** 2)
    ends = torch.cat([signal[:1].expand(half, -1), signal, signal[-1:].expand(half, -1)])
    return torch.nn.functional.conv1d(ends.T[:, None], (kernel / kernel.sum())[None, None])[:, 0].T
