"""What MuJoCo lacks, and what the corrected model is worth there: lost.py [ROBOT ...]

Three robots of the package, moved with noise by motions of which four are fitted and ten are not: friction that grows
with the load, the same beside a Stribeck curve, and an arm of three joints with a spring in the elbow's gear, which no
file of an arm can hold. Printed are NRMSE in MuJoCo over the ten of nominal, re-fitted and corrected model, and the
ratio re-fitted / corrected: geometric mean, 95 % interval over the records, on how many it is above 1.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
from unseen import ratio

from hybrid_id import Channel, Dataset, Record, Stribeck, identify, load_model, one_link, replay
from hybrid_id.components import LinearSpring, LoadDependent
from hybrid_id.export.target import TargetErrors, target_errors
from hybrid_id.reporting.target import error_lines
from hybrid_id.systems.chain import System

ARM = """<mujoco>
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="lift" axis="0 1 0" armature="0.02" damping="0.2" frictionloss="0.1"/>
      <inertial mass="0.5" pos="0 0 -0.1" diaginertia="0.002 0.002 0.0003"/>
      <body name="lower" pos="0 0 -0.2">
        <joint name="elbow" axis="0 1 0" armature="0.01" damping="0.1" frictionloss="0.05"/>
        <inertial mass="0.3" pos="0 0 -0.1" diaginertia="0.001 0.001 0.0001"/>
        <body name="hand" pos="0 0 -0.2">
          <joint name="wrist" axis="0 1 0" armature="0.005" damping="0.05" frictionloss="0.03"/>
          <inertial mass="0.1" pos="0 0 -0.05" diaginertia="0.0002 0.0002 0.00005"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="lift" joint="lift" kp="20" kv="0.5"/>
    <position name="elbow" joint="elbow" kp="12" kv="0.3"/>
    <position name="wrist" joint="wrist" kp="5" kv="0.1"/>
  </actuator>
</mujoco>
"""


def drives() -> tuple[System, System, System]:
    """A weight at a motor, with load-dependent friction, and with a Stribeck curve, too."""
    nominal = one_link(50.0, vertical=True).with_values({"J": 2.3e-5, "F_c": 0.012, "F_v": 6e-5, "G_l": 1.5})
    true = nominal.with_values({"J": 2.1e-5, "F_c": 0.005, "F_v": 5e-5, "G_l": 1.6})
    loaded = true.with_component("joint1/motor_friction", LoadDependent(mu=0.15))
    return nominal, loaded, loaded.with_component("joint1/motor_friction", Stribeck(F_drop=0.008, v_s=20.0))


def arm(folder: Path) -> tuple[System, System]:
    """The arm as described, and as it is: rotors and friction other than described, a spring in the elbow's gear."""
    (folder / "arm.xml").write_text(ARM)
    (folder / "model.yaml").write_text("robot: {file: arm.xml}\n")
    nominal = load_model(folder / "model.yaml")
    values = {"J_m_lift": 0.025, "J_m_elbow": 0.012, "F_c_lift": 0.13, "F_c_elbow": 0.04, "F_v_wrist": 0.07}
    true = nominal.with_values(values).with_component("joint2/transmission", LinearSpring(k=15.0, d=0.05))
    return nominal, true


def recorded(true: System, records: int = 14) -> Dataset:
    """Records of 4 s, four for the fit."""
    rng, time = np.random.default_rng(1), np.arange(0.0, 4.0, 0.004)
    names = [f"{'u' if true.tree is None else 'goal'}{joint.number}" for joint in true.joints]
    noise = 0.01 if true.tree is None else 0.001
    inputs = tuple(Channel(name, "V" if name[0] == "u" else "rad") for name in names)
    outputs = tuple(Channel(f"q_m{joint.number}", "rad", noise) for joint in true.joints)
    found = []
    for k in range(records):
        u = {
            name: np.where(time < 0.1, 0.0, waves(rng, time, 3.0 if name[0] == "u" else 0.8))
            for name in names
        }
        still = {channel.name: 0.0 * time for channel in outputs}
        (run,) = replay(Dataset("robot", inputs, outputs, (Record("run", time, u, still),)), true)
        y = {name: run.outputs[name] + rng.normal(0.0, noise, time.size) for name in still}
        found.append(Record(f"run{k}", time, u, y, "train" if k < 4 else "test"))
    return Dataset("robot", inputs, outputs, tuple(found))


def waves(rng: np.random.Generator, time: np.ndarray, size: float) -> np.ndarray:
    """Two tones of drawn frequencies."""
    slow, fast = rng.uniform(2.0, 5.0), rng.uniform(5.0, 12.0)
    return size * (0.65 * np.sin(slow * time) + 0.35 * np.sin(fast * time))


def by_record(errors: TargetErrors, label: str) -> np.ndarray:
    """NRMSE in MuJoCo of each record, mean over its outputs."""
    rows = errors.models[label].rows
    return np.array(
        [np.mean([r.there for r in rows if r.record == n]) for n in dict.fromkeys(r.record for r in rows)]
    )


def main(names: list[str]) -> None:
    """A few lines a robot."""
    torch.set_num_threads(1)
    nominal, loaded, both = drives()
    with tempfile.TemporaryDirectory() as folder:
        robots = {"load": (nominal, loaded), "stribeck+load": (nominal, both), "arm": arm(Path(folder))}
        for name in names or robots:
            before, true = robots[name]
            data = recorded(true)
            train, test = (data.select([r.name for r in part]) for part in (data.train, data.test))
            models = {"nominal": before}
            for label, start in (("re-fitted", before), ("corrected", true)):
                models[label] = identify(train, start, pooled=True).selected_model
            errors = target_errors(models, test, train=train)
            print(f"{name}:", *error_lines(errors), sep="\n  ")
            before_refit = np.mean([row.there for row in errors.exported.before])
            print(f"  corrected, not fitted in MuJoCo: {before_refit:.3g}; worse: {errors.worse}")
            pair = (by_record(errors, label) for label in ("re-fitted", "corrected"))
            print(f"  re-fitted / corrected {ratio(*pair)}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
