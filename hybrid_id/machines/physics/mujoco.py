"""The same machines in MuJoCo 4: its motor, soft dry friction, series joints for play and flexibility.

A drive becomes a hinge whose armature is the rotor seen behind the gear, driven by a `dcmotor` through that gear; where
rotor and link can move apart, a second hinge in series is the twist between them, with a spring, or with limits for
play. MuJoCo's dry friction and its limits are soft constraints (they creep, they give way), which is the point: it is
another physics than the integrator in `machine`. `MujocoMachine` refuses laws that it has no counterpart for.
"""

import numpy as np

from hybrid_id.machines.physics.friction import Coulomb, LuGre, Power, Viscous
from hybrid_id.machines.physics.law import Signals
from hybrid_id.machines.physics.load import ConstantTorque, Gravity, RestSpring
from hybrid_id.machines.physics.machine import BRAKE, SETTLING, Drive, Machine, OneLink
from hybrid_id.machines.physics.motor import Cogging, SupplySag
from hybrid_id.machines.physics.transmission import HardeningSpring, LinearSpring, Play

STEP, STEP_OF_A_WINDING = 0.25e-3, 0.125e-3
"""MuJoCo's time step [s], and the one for a current that lags, which it steps by Euler's rule."""
G = 9.81
WARM = 0.0039
"""Temperature coefficient of copper [1/K]."""
LENGTH = 0.3
"""Of the first link [m]; any will do that the coupling and the inertias allow."""


class Unsupported(Exception):
    """A law that MuJoCo has no counterpart for."""


def document(machine: Machine) -> str:
    """The machine as an MJCF document."""
    bodies, ends, pull = "", "", "0 0 0"
    inertias = _bodies(machine)
    for i, drive in enumerate(machine.drives):
        body, gravity = inertias[i]
        if gravity:
            pull = f"0 {-G} 0"
        place = f'pos="{LENGTH if i else 0} 0 0"'
        twist = "" if drive.spring is None else _twist(drive, i)
        if twist:  # a rotor without a link's inertia, then the link
            rotor = '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>'
            bodies += f"<body {place}>{_rotor(drive, i)}{rotor}<body>{twist}{body}"
            ends += "</body></body>"
        else:
            bodies += f"<body {place}>{_rotor(drive, i)}{body}"
            ends += "</body>"
    step = STEP if all(drive.motor.lag is None for drive in machine.drives) else STEP_OF_A_WINDING
    tendons = "".join(_link(drive, i) for i, drive in enumerate(machine.drives))
    motors = "".join(_motor(drive, i) for i, drive in enumerate(machine.drives))
    return (
        f'<mujoco><compiler angle="radian" inertiafromgeom="false"/>'
        f'<option timestep="{step}" gravity="{pull}" integrator="implicitfast"/>'
        f"<worldbody>{bodies}{ends}</worldbody><tendon>{tendons}</tendon><actuator>{motors}</actuator></mujoco>"
    )


def _bodies(machine: Machine) -> list[tuple[str, bool]]:
    """Inertia of each link as MJCF, and whether gravity pulls at it."""
    links = machine.links
    if isinstance(links, OneLink):
        weights = [law for law in machine.drives[0].link_laws if isinstance(law, Gravity)]
        # two weights add up to one
        x = sum(float(law.G) * np.cos(float(law.q_0)) for law in weights) / G
        y = sum(float(law.G) * np.sin(float(law.q_0)) for law in weights) / G
        J, moment = float(links.J), float(np.hypot(x, y))
        mass = max(2 * moment**2 / J, 0.1)
        # gravity pulls along -y, where the weight hangs when the link is at q_0
        position = f"{-y / mass} {-x / mass} 0"
        return [(_inertial(mass, position, J - moment**2 / mass), moment > 0)]
    if any(np.any(value) for value in (links.G_1, links.G_2)):
        raise Unsupported("a tilted arm")
    a, b, c, length = float(links.a), float(links.b), float(links.c), LENGTH
    mass = max(1.05 * c**2 / (length**2 * b), 0.1)
    arm = c / (length * mass)
    first = a - b - mass * length**2
    if first <= 0:
        raise Unsupported("links that no two bodies have")
    return [
        (_inertial(0.1, "0 0 0", first), False),
        (_inertial(mass, f"{arm} 0 0", b - mass * arm**2), False),
    ]


def _inertial(mass: float, position: str, inertia: float) -> str:
    return f'<inertial pos="{position}" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>'


def _rotor(drive: Drive, i: int) -> str:
    """Hinge of a rotor, behind its gear."""
    if drive.gear.errors or drive.sensor_delay is not None:
        raise Unsupported("gear errors and late sensors")
    r, linear, quadratic, cubic, dry = drive.gear.ratio, 0.0, 0.0, 0.0, 0.0
    for law in drive.rotor_laws:
        if isinstance(law, Viscous):
            linear += float(law.F_v)
        elif isinstance(law, Power) and law.exponent in (2.0, 3.0):
            quadratic += float(law.F) * (law.exponent == 2.0)
            cubic += float(law.F) * (law.exponent == 3.0)
        elif isinstance(law, Coulomb):
            dry += float(law.F_c)
        elif not isinstance(law, Cogging | LuGre | ConstantTorque):
            raise Unsupported(type(law).__name__)
    return (
        f'<joint name="rotor{i}" type="hinge" axis="0 0 1" armature="{r**2 * float(drive.rotor)}" '
        f'damping="{r**2 * linear} {r**3 * quadratic} {r**4 * cubic}" frictionloss="{r * dry}" '
        'solreffriction="0.001 1" solimpfriction="0.99 0.999 0.001"/>'
    )


def _twist(drive: Drive, i: int) -> str:
    """Hinge between gear and link: q_a less q_m / r."""
    head = f'<joint name="twist{i}" type="hinge" axis="0 0 1" '
    spring = drive.spring
    if isinstance(spring, LinearSpring):
        return head + f'stiffness="{float(spring.k)}" damping="{float(spring.damping)}"/>'
    if isinstance(spring, HardeningSpring) and spring.exponent == 3.0:
        return (
            head + f'stiffness="{float(spring.k)} 0 {float(spring.k_n)}" damping="{float(spring.damping)}"/>'
        )
    if isinstance(spring, Play):
        half = 0.5 * float(spring.gap)
        return head + f'limited="true" range="{-half} {half}" solreflimit="0.003 0.5" damping="1e-6"/>'
    raise Unsupported(type(spring).__name__)


def _link(drive: Drive, i: int) -> str:
    """What acts on the absolute angle of a link: a tendon over its hinges."""
    linear, dry, stiffness, rest = 0.0, 0.0, 0.0, 0.0
    for law in drive.link_laws:
        if isinstance(law, Viscous):
            linear += float(law.F_v)
        elif isinstance(law, Coulomb):
            dry += float(law.F_c)
        elif isinstance(law, RestSpring) and law.k_3 == 0.0 and stiffness == 0.0:
            stiffness, rest = float(law.k), float(law.rest)
        elif not isinstance(law, Gravity):
            raise Unsupported(type(law).__name__)
    if not linear and not dry and not stiffness:
        return ""
    twist = "" if drive.spring is None else f'<joint joint="twist{i}" coef="1"/>'
    return (
        f'<fixed name="link{i}" damping="{linear}" frictionloss="{dry}" stiffness="{stiffness}" springlength="{rest}" '
        'solreffriction="0.001 1" solimpfriction="0.99 0.999 0.001">'
        f'<joint joint="rotor{i}" coef="1"/>{twist}</fixed>'
    )


def _motor(drive: Drive, i: int) -> str:
    """The drive's motor; P_1 = K / R and P_2 = K."""
    motor, r = drive.motor, drive.gear.ratio
    if motor.weakening is not None:
        raise Unsupported("field weakening")
    if any(isinstance(law, SupplySag) for law in drive.amplifier):
        raise Unsupported("a supply that feels the motor's torque")
    K = float(motor.P_2)
    R = K / float(motor.P_1)
    text = f'<dcmotor name="motor{i}" joint="rotor{i}" gear="{r}" motorconst="{K} {K}" resistance="{R}"'
    if motor.lag is not None:
        text += f' inductance="0 {float(motor.lag)}"'
    if motor.heating is not None:
        capacity = R * WARM / (K**2 * float(motor.heating))
        text += f' thermal="0 {capacity} {float(motor.cooling)} {WARM} 25 25"'
    for law in drive.rotor_laws:
        if isinstance(law, Cogging):
            if len(law.amplitudes) > 1 or law.periods[0] != round(law.periods[0]):
                raise Unsupported("cogging with overtones")
            text += (
                f' cogging="{float(law.amplitudes[0])} {law.periods[0]:.0f} {float(law.phases[0]) + np.pi}"'
            )
        elif isinstance(law, LuGre):
            levels = [law.stiffness, law.damping, law.F_c, law.F_c + law.drop, law.v_s]
            text += ' lugre="' + " ".join(str(float(v)) for v in levels) + '"'
    return text + "/>"


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

    def carry(self, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Carry all runs through commands (T, n_joints, B) [V]: rotor and link angles, alike, [rad] at all samples."""
        seen = []
        for command in commands:
            seen.append(self.angles())
            self.advance(command, np.zeros_like(command))
        rotor, link = (np.array(one) for one in zip(*seen, strict=True))
        return rotor, link

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
