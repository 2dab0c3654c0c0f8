"""Computed torque: the identified model, turned round, says which voltages or torques a motion needs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import cast

import numpy as np
import torch
from torch import Tensor

from hybrid_id.components.input.current_command import CurrentCommand
from hybrid_id.components.input.torque_command import TorqueCommand
from hybrid_id.components.input.voltage import Voltage
from hybrid_id.components.motor.free_rotor import FreeRotor
from hybrid_id.control.reference import Reference
from hybrid_id.errors import InputError, listed
from hybrid_id.systems.chain import System
from hybrid_id.systems.joint import Joint, sum_of

SMOOTHING = 0.01
"""Standard deviation [s] of the Gaussian that smooths the motion planned for a motor behind a gear with play."""


class ComputedTorque:
    """``u = (M (a_d + K_v e_v + K_p e_q) + c + friction) / (torque per unit of u)``, for many models at once.

    Angles and speeds are the motors'. Behind a rigid gear M and c are taken at the measured state, so that with the
    right model the error obeys ``e'' + K_v e' + K_p e = 0``; dry friction is taken at the desired speed, which does
    not chatter. Behind a spring the motor must lead its link: the torque that the link's motion needs gives the
    spring's deflection (for the paper, the inverse of eq. 12), and the motor follows the angle planned so. A gear's
    kinematic error is planned for, too; the loop follows it as far as it is slow beside the sample time.

    Source: computed torque as in the paper's section III.C; J. Y. S. Luh, M. W. Walker, R. P. C. Paul, IEEE Trans.
    Automatic Control 25(3), 1980.

    Args:
        system: the identified model, of any number of joints; each is commanded by a voltage, current or torque.
        reference: desired motion at the links.
        bandwidth: of the error's dynamics [rad/s]: ``K_p = bandwidth^2``, ``K_v = 2 bandwidth``.
        limit: largest command of every motor, or one for each [V, A or N m, as it is commanded].
        channels: what the model reads beside the commands (a logged load, the motion of a robot's other joints),
            ``(T,)`` each in its unit, held over each sample of the reference.
        theta: parameters of B variants of the model in table order, ``(n_p, B)``; the system's own, B = 1, by default.
        width: desired speed at which dry friction is compensated to 76 % [rad/s, motor].

    Raises:
        InputError: a joint that is commanded otherwise or has no inverse, a reference with another number of joints,
            or a channel that is missing.
    """

    def __init__(
        self,
        system: System,
        reference: Reference,
        *,
        bandwidth: float,
        limit: float | Sequence[float],
        channels: Mapping[str, np.ndarray] | None = None,
        theta: Tensor | None = None,
        width: float = 1.0,
    ) -> None:
        if reference.angle.shape[1] != len(system.joints):
            raise InputError(
                f"The reference moves {reference.angle.shape[1]} joints, but the model has {len(system.joints)}."
            )
        _refuse_without_inverse(system)
        self.system, self.width = system, width
        self.limit = torch.as_tensor(limit, dtype=torch.float64).expand(len(system.joints))[:, None]
        self.kp, self.kv = bandwidth**2, 2.0 * bandwidth
        theta = system.theta().detach()[:, None] if theta is None else theta
        self.lanes = theta.shape[1]
        self.views = system.views(list(theta))
        self.commands = [
            f"{c}{joint.number}" for joint in system.joints for c in joint.drive.input[1].channels
        ]
        self.channels = self._known(channels or {}, len(reference.time))
        self.plan = self._plan(reference)
        self.rotors = [system.speed_rows.index(joint.positions[0] + 1) for joint in system.joints]

    def _known(self, channels: Mapping[str, np.ndarray], samples: int) -> dict[str, Tensor]:
        """Channels that the model reads beside the commands, ``(T, B)`` each."""
        read = [name for name in self.system.input_names if name not in self.commands]
        given = {name: np.asarray(channels.get(name, np.nan), float) for name in read}
        if wrong := [n for n, v in given.items() if v.shape != (samples,) or not np.isfinite(v).all()]:
            raise InputError(
                f"The model reads {listed(wrong)} beside its commands; give channels with {samples} finite values of "
                "each, or take a model that reads none."
            )
        return {n: torch.as_tensor(v)[:, None].expand(-1, self.lanes) for n, v in given.items()}

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
        found = self._inverse(k, x, accelerations, planned[1])
        return found.clamp(-self.limit, self.limit).numpy()

    def _inverse(self, k: int, x: list[Tensor], accelerations: list[Tensor], along: Tensor) -> Tensor:
        """Commands with which the rotors accelerate so, ``(n_joints, B)``; dry friction acts along a speed."""
        zero, views = along.new_zeros(self.lanes), self.views
        known = {name: values[k] for name, values in self.channels.items()}
        idle, driven = (known | dict.fromkeys(self.commands, zero + one) for one in (0.0, 1.0))
        magnitudes, forwards = list(along.abs()), list((along > 0).to(along.dtype))
        balances = self.system.balances(x, idle, views, magnitudes, forwards)
        reactions = balances.reactions(accelerations)
        found = []
        for joint, s in zip(self.system.joints, self.rotors, strict=True):
            balance, direction = balances.speeds[s], torch.tanh(along[s] / self.width)
            torque, unit = (joint.drive.torque(x, u, views) for u in (idle, driven))
            laws = joint.frictions["motor_friction"]
            effort = sum_of([law.effort_factor(views[key]) for key, law in laws], zero)
            # the balance rubs by the drive's torque without a command; by the one that is needed it is solved below
            level = balance.level - effort * torque.abs()
            if balance.factor is not None:
                through = balance.transmitted(accelerations[s], reactions[s] + zero)
                level = level + balance.factor * through.abs()
            force = balance.inertia * accelerations[s] + reactions[s] + direction * level
            needed = torque + force - balance.smooth
            # with |effort| < 1 it has the sign that it has without such friction
            needed = needed / (1.0 - direction * effort * torch.sign(needed))
            found.append((needed - torque) / (unit - torque))
        return torch.stack(found)

    @torch.no_grad()
    def _plan(self, reference: Reference) -> Tensor:
        """Angles, speeds and accelerations of every rotor and link, ``(T, 3, n_speeds, B)``."""
        wanted = torch.as_tensor(np.stack([reference.angle, reference.speed, reference.acceleration]))
        columns = []
        for joint, motion in zip(self.system.joints, wanted.unbind(2), strict=True):
            link = motion[..., None].expand(-1, -1, self.lanes)
            if joint.rigid:
                columns.append(_rotor(joint, link, self.views))
            else:
                columns += [self._lead(joint, link, reference.sample_time), link]
        return torch.stack(columns, 2).transpose(0, 1)

    def _lead(self, joint: Joint, link: Tensor, step: float) -> Tensor:
        """Motion of a rotor, ``(3, T, B)``, whose spring gives its link the torque that it needs."""
        if len(self.system.joints) > 1:
            raise InputError("Computed torque through a spring is built for one joint; make the gears rigid.")
        samples = link.shape[1]
        angle, speed, acceleration = link.flatten(1)
        views = {
            key: type(view)(**{n: v.expand(samples, self.lanes).flatten() for n, v in vars(view).items()})
            for key, view in self.views.items()
        }
        zero = torch.zeros_like(angle)
        channels = dict.fromkeys(self.commands, zero) | {n: v.flatten() for n, v in self.channels.items()}
        forward = (speed > 0).to(speed.dtype)

        def shortage(deflection: Tensor) -> Tensor:
            """Torque that the link needs less the one that the spring gives."""
            x = [zero for _ in self.system.state_names]
            turned = _rotor(joint, torch.stack([angle + deflection, speed, acceleration]), views)
            for row, motion in zip(joint.positions, (turned[:2], (angle, speed)), strict=True):
                x[row], x[row + 1] = motion
            magnitudes = [turned[1].abs(), speed.abs()]
            balance = self.system.balances(x, channels, views, magnitudes, [forward, forward]).speeds[1]
            direction = torch.tanh(joint.gear_ratio * speed / self.width)
            return balance.inertia * acceleration + direction * balance.level - balance.smooth

        deflection = _crossing(shortage, angle).reshape(samples, self.lanes)
        rates = [_smooth(deflection, SMOOTHING / step)]
        for _ in range(2):
            rates.append(torch.gradient(rates[-1], spacing=step, dim=0)[0])
        return _rotor(joint, link + torch.stack(rates), self.views)


def _refuse_without_inverse(system: System) -> None:
    """Raise InputError where a command cannot be found for a motion."""
    if system.tree is not None and system.tree.couplings:
        raise InputError("The model's motors are coupled, of which computed torque knows no inverse.")
    remembering = {system.state_names[row] for row in system.memory_rows}
    for joint in system.joints:
        drive = joint.drive
        driven = isinstance(drive.input[1], Voltage | CurrentCommand | TorqueCommand)
        if not driven or isinstance(drive.motor[1], FreeRotor):
            raise InputError(
                f"{joint.name} is not commanded by a voltage, current or torque, which computed torque needs."
            )
        if drive.windings or drive.maps or drive.delay or remembering.intersection(joint.state_names):
            raise InputError(
                f"{joint.name} has a delay, a limit, a dead band or a state that remembers, of which computed "
                "torque knows no inverse; leave these out of the controller's model."
            )
        # what passes a rigid gear depends on the acceleration, and so on the command
        by_command = {"command", "torque", *(["transmitted"] if joint.rigid else [])}
        read = {name for _, part, _ in joint.networks.by_place.values() for name in part.inputs}
        if found := sorted(read & by_command):
            raise InputError(
                f"{joint.name} has a network that reads {listed(found)}, of which computed torque knows no inverse; "
                "leave it out of the controller's model."
            )


def _rotor(joint: Joint, link: Tensor, views: Mapping[str, SimpleNamespace]) -> Tensor:
    """Angle, speed and acceleration of a rotor, ``(3, ...)``, whose unloaded gear moves its link so."""
    ratio, gear = joint.gear_ratio, joint.gear
    if not gear.errors:
        return ratio * link
    for key, _ in gear.errors:
        p = views[key]
        steepest = p.n * torch.hypot(p.E_c, p.E_s) + p.n_2 * torch.hypot(p.E_c2, p.E_s2)
        if bool((ratio * steepest >= 1.0).any()):
            raise InputError(
                f"The kinematic_error of {joint.name} turns its link back while the motor turns on, of which computed "
                "torque knows no inverse; leave it out of the controller's model."
            )
    angle, speed, acceleration = link
    ahead = _crossing(lambda lead: angle - gear.map(ratio * (angle + lead), views)[0], angle)
    rotor = ratio * (angle + ahead)
    _, slope, curvature = gear.map(rotor, views)
    speed = speed / slope
    return torch.stack([rotor, speed, (acceleration - cast(Tensor, curvature) * speed.square()) / slope])


def _crossing(falling: Callable[[Tensor], Tensor], like: Tensor) -> Tensor:
    """Angles [rad], within 1 of zero, where a falling function of them crosses zero, by bisection."""
    reach = torch.full_like(like, 1e-4)
    while bool((falling(reach) > 0).any() or (falling(-reach) < 0).any()) and float(reach.max()) < 1.0:
        reach = 2.0 * reach
    low, high = -reach, reach
    for _ in range(50):
        middle = 0.5 * (low + high)
        above = falling(middle) > 0
        low, high = torch.where(above, middle, low), torch.where(above, high, middle)
    return 0.5 * (low + high)


def _smooth(signal: Tensor, width: float) -> Tensor:
    """Convolution over time, the first axis, with a Gaussian of a standard deviation in samples."""
    half = max(1, round(4 * width))
    kernel = torch.exp(-0.5 * (torch.arange(-half, half + 1, dtype=signal.dtype) / max(width, 1e-3)) ** 2)
    ends = torch.cat([signal[:1].expand(half, -1), signal, signal[-1:].expand(half, -1)])
    return torch.nn.functional.conv1d(ends.T[:, None], (kernel / kernel.sum())[None, None])[:, 0].T
