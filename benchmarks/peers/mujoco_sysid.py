"""MuJoCo's system identification toolbox (`mujoco.sysid`, 4.0) on a gap case: finite differences of whole rollouts.

P_m1 is held (voltage and angle give no absolute torque) and the back-EMF P_m1 P_m2 is part of the motor's damping, so
that one link has three free parameters (J, F_c, damping) and the flexible link seven (J_m, J_a, k, d, F_cm, motor and
link damping): the identifiable ones. Free parameters are ratios to the nominal value, within the case's bounds.
"""

from __future__ import annotations

import gzip
import time
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import yaml
from mujoco import rollout, sysid

from benchmarks.reference import Array

MODEL = """
<mujoco>
  <option timestep="{timestep}" integrator="implicitfast" gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody>
    <body name="motor"><inertial pos="0 0 0" mass="1e-6" diaginertia="1e-12 1e-12 1e-12"/>
      <joint name="motor" type="hinge" axis="0 0 1" armature="{J}" damping="{b}" frictionloss="{F_c}"
      {friction}/></body>
    {link}
  </worldbody>
  {spring}
  <actuator><general name="voltage" joint="motor" gainprm="{P_m1}" biastype="none"/></actuator>
  <sensor><jointpos name="angle" joint="motor"/></sensor>
</mujoco>
"""
LINK = """<body name="link"><inertial pos="0 0 0" mass="1e-6" diaginertia="1e-12 1e-12 1e-12"/>
      <joint name="link" type="hinge" axis="0 0 1" armature="{J_a}" damping="{F_va}"/></body>"""
SPRING = """<tendon><fixed name="spring" stiffness="{k}" damping="{d}" springlength="0">
    <joint joint="motor" coef="{inverse_ratio}"/><joint joint="link" coef="-1"/></fixed></tendon>"""


@dataclass(frozen=True, eq=False)
class Record:
    time: Array
    voltage: Array
    angle: Array
    role: str


def read_case(folder: Path) -> tuple[dict, list[Record]]:
    """model.yaml and the records of a one-joint case (columns t, u1, q_m1)."""
    model = yaml.safe_load((folder / "model.yaml").read_text())
    dataset = yaml.safe_load((folder / "dataset.yaml").read_text())
    records = []
    for entry in dataset["records"]:
        with gzip.open(folder / entry["file"], "rt") as stream:
            names = stream.readline().strip().split(",")
            columns = dict(zip(names, np.loadtxt(stream, delimiter=",").T, strict=True))
        records.append(Record(columns["t"], columns["u1"], columns["q_m1"], entry["role"]))
    return model, records


def specification(
    model: dict, timestep: float, friction: str = ""
) -> tuple[mujoco.MjSpec, sysid.ParameterDict]:
    """MuJoCo model at the nominal values and the free ratios with their modifiers."""
    listed = model["parameters"]
    nominal = {name: entry["nominal"] for name, entry in listed.items()}
    flexible = model["system"] == "one_link_flexible"
    suffix = "m" if flexible else ""
    damping = nominal["P_m1"] * nominal["P_m2"] + nominal[f"F_v{suffix}"]
    values = {"J": nominal["J_m" if flexible else "J"], "b": damping, "F_c": nominal[f"F_c{suffix}"]}
    link = LINK.format(**nominal) if flexible else ""
    spring = SPRING.format(**nominal, inverse_ratio=1.0 / model["gear_ratio"][0]) if flexible else ""
    text = MODEL.format(
        timestep=timestep, link=link, spring=spring, friction=friction, P_m1=nominal["P_m1"], **values
    )
    targets = {"J": ("joint", "motor", "armature"), "b": ("joint", "motor", "damping")}
    targets["F_c"] = ("joint", "motor", "frictionloss")
    if flexible:
        targets |= {"J_a": ("joint", "link", "armature"), "F_va": ("joint", "link", "damping")}
        targets |= {"k": ("tendon", "spring", "stiffness"), "d": ("tendon", "spring", "damping")}
        values |= {name: nominal[name] for name in ("J_a", "F_va", "k", "d")}
    parameters = sysid.ParameterDict()
    for name, (kind, element, attribute) in targets.items():

        def modifier(spec, parameter, kind=kind, element=element, attribute=attribute, value=values[name]):
            scaled = float(parameter.value[0]) * value
            polynomial = attribute in ("damping", "stiffness")
            setattr(getattr(spec, kind)(element), attribute, [scaled, 0.0, 0.0] if polynomial else scaled)

        parameters.add(sysid.Parameter(name, 1.0, 0.25, 4.0, modifier=modifier))
    return mujoco.MjSpec.from_string(text), parameters


def start_state(model: mujoco.MjModel, record: Record, ratio: float) -> Array:
    """Rest at the mean of the samples before the voltage sets in."""
    angle = record.angle[:50].mean()
    return sysid.create_initial_state(model, np.array([angle, angle / ratio][: model.nq]), np.zeros(model.nv))


def normalised_error(model: mujoco.MjModel, records: list[Record], ratio: float) -> float:
    """Mean over records of the free run's root mean square error over the angle's standard deviation."""
    errors = []
    for record in records:
        start = start_state(model, record, ratio)
        state, _ = rollout.rollout(model, mujoco.MjData(model), start, record.voltage[:-1, None])
        simulated = np.concatenate([start[1:2], state[0, :, 1]])
        errors.append(np.sqrt(((simulated - record.angle) ** 2).mean()) / record.angle.std())
    return float(np.mean(errors))


def fit_case(folder: str, *, stiff_friction: bool = False) -> dict[str, float]:
    """Fits the train records; seconds of the optimisation and the error on the test records.

    stiff_friction: time constant of the friction constraint 4 ms instead of MuJoCo's default 20 ms.
    """
    model, records = read_case(Path(folder))
    ratio = model["gear_ratio"][0]
    train = [record for record in records if record.role == "train"]
    test = [record for record in records if record.role == "test"]
    spec, parameters = specification(
        model,
        float(np.median(np.diff(train[0].time))),
        friction='solreffriction="0.004 1"' if stiff_friction else "",
    )
    compiled = spec.compile()
    begin = time.process_time()
    sequences = sysid.ModelSequences(
        "case",
        spec,
        [f"record{i}" for i in range(len(train))],
        [start_state(compiled, record, ratio) for record in train],
        [
            sysid.TimeSeries.from_control_names(record.time, record.voltage[:, None], compiled)
            for record in train
        ],
        # the state, since a rollout's sensors are those of the step before
        [
            sysid.TimeSeries.from_names(record.time, record.angle[:, None], compiled, ["motor_qpos"])
            for record in train
        ],
    )
    residual = sysid.build_residual_fn(models_sequences=[sequences], n_threads=1)
    found, _ = sysid.optimize(parameters, residual, verbose=False)
    seconds = time.process_time() - begin
    fitted = sysid.apply_param_modifiers(found, spec.copy())
    return {
        "seconds": seconds,
        "free_parameters": parameters.size,
        "nominal": normalised_error(compiled, test, ratio),
        "refit": normalised_error(fitted, test, ratio),
    }
