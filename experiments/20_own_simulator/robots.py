"""Logs of five robots in a simulator of one's own: MuJoCo, with laws of this file's own that their descriptions lack.

    robots.py FOLDER [--so101 FILE]

writes of each robot a folder of CSV files, another one of motions that are not recorded (`NAME_unseen`), and the
description that its owner has, which is wrong (`NAME.xml`).

- `lift`: one joint behind a gear of 50, a DC motor by voltage; the description lacks a torsion spring.
- `servo`: one joint, a position servo by its goal in rad, encoder in counts; the description lacks load-dependent
  friction.
- `band`: one joint by a commanded torque; the description lacks a rubber band that is slack below 0.6 rad, which no
  effect of the catalogue is.
- `arm`: the six joints of SO-101's own MJCF, goals and angles in degrees; other gains, rotors, damping and dry
  friction, a payload, and load-dependent friction at two joints.
- `cobot`: six joints, goals and angles in rad; other gains, damping and dry friction, and a controller that holds the
  weight of all links, of which the description says nothing.
"""

import csv
import shutil
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

mujoco: Any = import_module("mujoco")  # has no types
SO101 = Path("../shared/data/so101/so101_new_calib.xml")
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
COUNT = 2 * np.pi / 4096
ONE_JOINT = """<mujoco model="one_joint">
  <compiler angle="radian"/>
  <option timestep="{step}" integrator="implicitfast"/>
  <worldbody>
    <body name="forearm" pos="0 0 0.5">
      <joint name="elbow" axis="0 1 0" range="-2.6 2.6" armature="{armature}" damping="{damping}" frictionloss="{dry}"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.35"/>
      <geom type="sphere" pos="0 0 -0.27" size="0.03" mass="{load}"/>
    </body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>
"""
MOTOR = '<motor name="elbow" joint="elbow"/>'
SERVO = '<position name="elbow" joint="elbow" kp="10" kv="0.4" forcerange="-5 5"/>'
DESCRIBED = {
    "lift": ONE_JOINT.format(
        step=0.0005,
        armature=0.01,
        damping=0.04,
        dry=0.2,
        load=0.2,
        actuator=MOTOR.replace("/>", ' gear="50"/>'),
    ),
    "band": ONE_JOINT.format(step=0.0005, armature=0.02, damping=0.2, dry=0.1, load=0.2, actuator=MOTOR),
    "servo": ONE_JOINT.format(step=0.0005, armature=0.015, damping=0.05, dry=0.1, load=0.5, actuator=SERVO),
}
COBOT = """<mujoco model="cobot">
  <compiler angle="radian"/>
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="shoulder" pos="0 0 0.15">
      <joint name="pan" axis="0 0 1" range="-3 3" armature="0.5" damping="5" frictionloss="2"/>
      <inertial mass="3.6" pos="0 -0.02 0" diaginertia="0.01 0.01 0.01"/>
      <body name="upper" pos="0 0.13 0">
        <joint name="raise" axis="0 1 0" range="-2.5 2.5" armature="0.5" damping="5" frictionloss="2"/>
        <inertial mass="7.9" pos="0 0 0.25" diaginertia="0.13 0.13 0.02"/>
        <body name="fore" pos="0 -0.12 0.42">
          <joint name="bend" axis="0 1 0" range="-2.8 2.8" armature="0.3" damping="3" frictionloss="1.5"/>
          <inertial mass="2.4" pos="0 0 0.19" diaginertia="0.04 0.04 0.004"/>
          <body name="first" pos="0 0 0.4">
            <joint name="tip" axis="0 1 0" range="-3 3" armature="0.1" damping="1" frictionloss="0.5"/>
            <inertial mass="1.3" pos="0 0.1 0" diaginertia="0.002 0.002 0.002"/>
            <body name="second" pos="0 0.11 0">
              <joint name="swing" axis="0 0 1" range="-3 3" armature="0.1" damping="1" frictionloss="0.5"/>
              <inertial mass="1.2" pos="0 0 0.08" diaginertia="0.002 0.002 0.002"/>
              <body name="flange" pos="0 0 0.1">
                <joint name="roll" axis="0 1 0" range="-3 3" armature="0.1" damping="1" frictionloss="0.5"/>
                <inertial mass="0.9" pos="0.01 0.12 0.03" diaginertia="0.002 0.001 0.002"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="pan" joint="pan" kp="2500" kv="150"/>
    <position name="raise" joint="raise" kp="2500" kv="150"/>
    <position name="bend" joint="bend" kp="1800" kv="100"/>
    <position name="tip" joint="tip" kp="600" kv="30"/>
    <position name="swing" joint="swing" kp="600" kv="30"/>
    <position name="roll" joint="roll" kp="600" kv="30"/>
  </actuator>
</mujoco>
"""
COBOT_JOINTS = ("pan", "raise", "bend", "tip", "swing", "roll")
Rows = list[tuple[float, ...]]


def multisine(t: np.ndarray, rng: np.random.Generator, size: float, low: float, high: float) -> np.ndarray:
    """Seven tones of drawn frequencies [Hz] and phases, from 0 on, (T,)."""
    tones = zip(rng.uniform(low, high, 7), rng.uniform(0, 2 * np.pi, 7), strict=True)
    total = sum(np.sin(2 * np.pi * f * t + p) - np.sin(p) for f, p in tones) / np.sqrt(7)
    return size * total * np.clip((t - 0.2) / 0.5, 0, 1)


def goals(kind: str, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Goals of one joint [rad], (T,): a multisine, steps, or a slow sine."""
    if kind == "multisine":
        return multisine(t, rng, rng.uniform(0.7, 1.3), 0.1, 1.2)
    if kind == "steps":
        levels = np.r_[0.0, rng.uniform(-1.5, 1.5, 8)]
        return levels[np.clip(((t - 0.5) // 1.1 + 1).astype(int), 0, 8)]
    return 1.4 * np.clip(t - 0.3, 0, 1) * np.sin(2 * np.pi * 0.35 * (t - 0.3))


def inertia(model: Any, data: Any) -> np.ndarray:
    """Mass matrix, (nv, nv)."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


def rub(model: Any, data: Any, dry: np.ndarray, mu: np.ndarray, rotors: np.ndarray) -> None:
    """Set dry friction by the torque that each gear carries: weight and acceleration of all but its own rotor."""
    carried = data.qfrc_bias + (inertia(model, data) - np.diag(rotors)) @ data.qacc
    model.dof_frictionloss[:] = dry + mu * np.abs(carried)


def simulate(
    model: Any, wanted: np.ndarray, step: float, act: Callable, read: Callable, settle: float = 0.0
) -> Rows:
    """Rows of a log: what `read` sees at every sample; `act` sets the torques at every step of the simulator."""
    data = mujoco.MjData(model)
    data.qpos[:] = wanted[0] if settle else 0.0
    for _ in range(round(settle / model.opt.timestep)):
        act(data, wanted[0], data.qpos)
        mujoco.mj_step(model, data)
    rows = []
    for k, goal in enumerate(wanted):
        seen = data.qpos.copy()
        rows.append((k * step, *read(data, goal)))
        for _ in range(round(step / model.opt.timestep)):
            act(data, goal, seen)
            mujoco.mj_step(model, data)
    return rows


def lift(kind: str, seed: int) -> Rows:
    """Voltage by a PD controller at 250 Hz, 14-bit encoder at the joint."""
    k_t, ohm, gear, step = 0.03, 2.0, 50.0, 0.004
    model = mujoco.MjModel.from_xml_string(
        ONE_JOINT.format(step=0.0002, armature=0.0125, damping=0.05, dry=0.3, load=0.2, actuator=MOTOR)
    )
    volts = np.zeros(1)

    def act(data: Any, goal: np.ndarray, seen: np.ndarray) -> None:
        data.ctrl[0] = gear * k_t / ohm * (volts[0] - k_t * gear * data.qvel[0])
        data.qfrc_applied[0] = -0.8 * (data.qpos[0] - 0.4)  # the spring that the description lacks

    def read(data: Any, goal: np.ndarray) -> tuple[float, ...]:
        volts[0] = np.clip(25 * (goal[0] - data.qpos[0]) - 0.6 * data.qvel[0], -24, 24)
        return volts[0], np.degrees(np.round(data.qpos[0] / (COUNT / 4)) * COUNT / 4)

    t = step * np.arange(2000)
    return [(1e3 * row[0], *row[1:]) for row in
            simulate(model, goals(kind, t, np.random.default_rng(seed))[:, None], step, act, read)]  # fmt: skip


def servo(kind: str, seed: int) -> Rows:
    """A servo of 12 N m/rad whose gear rubs by 20 % of its load; 12-bit encoder that counts from half a turn."""
    model = mujoco.MjModel.from_xml_string(
        ONE_JOINT.format(step=0.0002, armature=0.02, damping=0.08, dry=0.05, load=0.5, actuator=MOTOR)
    )

    def act(data: Any, goal: np.ndarray, seen: np.ndarray) -> None:
        data.ctrl[0] = np.clip(12 * (goal[0] - data.qpos[0]) - 0.5 * data.qvel[0], -5, 5)
        rub(model, data, np.array([0.05]), np.array([0.2]), np.array([0.02]))

    def read(data: Any, goal: np.ndarray) -> tuple[float, ...]:
        return goal[0], 2048 + np.round(data.qpos[0] / COUNT), 0.0

    t = 0.004 * np.arange(2000)
    return simulate(model, goals(kind, t, np.random.default_rng(seed))[:, None], 0.004, act, read)


def band(kind: str, seed: int) -> Rows:
    """Torque by a PD controller at 250 Hz, speed by a tachometer; a band of 2 N m/rad that is slack below 0.6 rad."""
    step = 0.004
    model = mujoco.MjModel.from_xml_string(
        ONE_JOINT.format(step=0.0002, armature=0.025, damping=0.25, dry=0.15, load=0.2, actuator=MOTOR)
    )
    torque, rng = np.zeros(1), np.random.default_rng(100 + seed)

    def act(data: Any, goal: np.ndarray, seen: np.ndarray) -> None:
        data.ctrl[0] = torque[0]
        data.qfrc_applied[0] = -2.0 * max(data.qpos[0] - 0.6, 0.0)

    def read(data: Any, goal: np.ndarray) -> tuple[float, ...]:
        torque[0] = np.clip(15 * (goal[0] - data.qpos[0]) - 0.5 * data.qvel[0], -8, 8)
        return torque[0], np.round(data.qpos[0] / (COUNT / 4)) * COUNT / 4, data.qvel[0] + rng.normal(0, 0.02)

    t = step * np.arange(2000)
    return simulate(model, goals(kind, t, np.random.default_rng(seed))[:, None], step, act, read)


def arm(file: Path, seed: int) -> Rows:
    """Six servos at 50 Hz."""
    k_p, k_d = np.array([11, 13, 10.5, 10.6, 9, 8]), np.array([0.3, 0.35, 0.3, 0.25, 0.2, 0.2])
    rotors, damping = np.array([20, 22, 18, 16, 14, 12]) * 1e-3, np.array([0.3, 0.35, 0.3, 0.3, 0.25, 0.25])
    dry, mu = np.array([0.08, 0.12, 0.11, 0.09, 0.07, 0.05]), np.array([0, 0.25, 0.2, 0, 0, 0])
    spec = mujoco.MjSpec.from_file(str(file))
    spec.option.timestep, spec.option.integrator = 0.0005, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    held = spec.body("gripper").add_body(name="held", pos=spec.site("gripperframe").pos)
    held.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], mass=0.12, contype=0, conaffinity=0)
    model = spec.compile()
    model.dof_armature[:], np.reshape(model.dof_damping, (model.nv, -1))[:, 0] = rotors, damping
    model.actuator_biasprm[:], model.actuator_gainprm[:, 0], model.actuator_ctrllimited[:] = 0, 1, 0
    rng = np.random.default_rng(seed)

    def act(data: Any, goal: np.ndarray, seen: np.ndarray) -> None:
        data.ctrl[:] = np.clip(k_p * (goal - data.qpos) - k_d * data.qvel, -3.35, 3.35)
        rub(model, data, dry, mu, rotors)

    def read(data: Any, goal: np.ndarray) -> tuple[float, ...]:
        counted = COUNT * np.round((data.qpos + rng.normal(0, 0.0005, 6)) / COUNT)
        return (*np.degrees(counted), *np.degrees(goal))

    t, (low, high) = 0.02 * np.arange(600), model.jnt_range.T
    share = np.array([0.6, 0.6, 0.5, 0.6, 0.6, 0.6])
    waves = np.stack([multisine(t, rng, 0.5 * one, 0.08, 0.7) for one in share], axis=1)
    wanted = np.clip(0.5 * (low + high) + (high - low) * waves * 0.5, low + 0.08, high - 0.08)
    return simulate(model, wanted, 0.02, act, read, settle=2.0)


def cobot(seed: int) -> Rows:
    """Six drives at 100 Hz whose controller holds the links' weight; angles with 0.1 mrad of noise."""
    model = mujoco.MjModel.from_xml_string(COBOT.replace("0.0005", "0.0002"))
    model.opt.gravity[:] = 0.0  # nothing is left of the weight
    scale = np.array([1.1, 0.9, 1.2, 0.85, 1.1, 0.95])
    k_p, k_d = scale * model.actuator_gainprm[:, 0], -scale[::-1] * model.actuator_biasprm[:, 2]
    model.actuator_biasprm[:], model.actuator_gainprm[:, 0] = 0, 1
    model.dof_frictionloss[:] = [4.0, 5.0, 2.5, 0.8, 0.9, 0.4]
    model.dof_solref[:], model.dof_solimp[:] = (0.001, 1.0), (0.99, 0.999, 0.001, 0.5, 2.0)
    rng = np.random.default_rng(200 + seed)

    def act(data: Any, goal: np.ndarray, seen: np.ndarray) -> None:
        data.ctrl[:] = k_p * (goal - data.qpos) - k_d * data.qvel

    def read(data: Any, goal: np.ndarray) -> tuple[float, ...]:
        return (*goal, *(data.qpos + rng.normal(0, 1e-4, 6)))

    t, home = 0.01 * np.arange(1000), np.array([0.0, 0.6, 1.1, -0.4, 0.3, 0.5])
    waves = np.stack([multisine(t, rng, 0.35, 0.05, 0.5) for _ in home], axis=1)
    return simulate(model, home + waves, 0.01, act, read, settle=2.0)


def write(folder: Path, header: list[str], logs: list[Rows]) -> None:
    """One CSV file a log."""
    folder.mkdir(parents=True)
    for number, rows in enumerate(logs, 1):
        with (folder / f"log_{number:02d}.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(header)
            writer.writerows([f"{value:.6g}" for value in row] for row in rows)


def main(home: Path, file: Path) -> None:
    """Write the logs of all five."""
    recorded = [
        ("multisine", 1),
        ("multisine", 2),
        ("multisine", 3),
        ("multisine", 4),
        ("sine", 5),
        ("steps", 6),
    ]
    unseen = [("multisine", 21), ("steps", 22), ("multisine", 23), ("multisine", 24)]
    for make, header in (
        (lift, ["time_ms", "motor_voltage", "joint_pos_deg"]),
        (band, ["time", "effort_cmd", "position", "velocity"]),
        (servo, ["timestamp", "goal_position", "present_position", "error_flags"]),
    ):
        for folder, jobs in ((make.__name__, recorded), (f"{make.__name__}_unseen", unseen)):
            write(home / folder, header, [make(*job) for job in jobs])
        (home / f"{make.__name__}.xml").write_text(DESCRIBED[make.__name__])
    header = [
        "timestamp",
        *(f"{joint}.pos" for joint in JOINTS),
        *(f"action.{joint}.pos" for joint in JOINTS),
    ]
    for folder, seeds in (("arm", range(1, 7)), ("arm_unseen", range(21, 25))):
        write(home / folder, header, [arm(file, seed) for seed in seeds])
    shutil.copy(file, home / "arm.xml")
    cobots(home)


def cobots(home: Path) -> None:
    """Write the logs of `cobot`, and what its owner has for it."""
    header = [
        "time",
        *(f"cmd_{joint}" for joint in COBOT_JOINTS),
        *(f"pos_{joint}" for joint in COBOT_JOINTS),
    ]
    for folder, seeds in (("cobot", range(1, 6)), ("cobot_unseen", range(21, 25))):
        write(home / folder, header, [cobot(seed) for seed in seeds])
    (home / "cobot.xml").write_text(COBOT)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[sys.argv.index("--so101") + 1]) if "--so101" in sys.argv else SO101)
