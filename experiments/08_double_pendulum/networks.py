"""DFKI's two-link arm: a network at each joint, beside the arm's description: networks.py FOLDER [DESIGN ...]."""

import json
import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import torch
from arm import read_day

from hybrid_id.identification.horizons import Horizon
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.reporting.residual_torques import residuals_result
from hybrid_id.study.residual_torques import learn_residuals
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model

OUT = Path("runs/08_networks")
LINK = """<body name="link{k}" pos="0 0 {z}">
  <joint name="joint{k}" axis="0 -1 0" armature="{rotor}" damping="{b}" frictionloss="{dry}"/>
  <inertial pos="0 0 {com}" mass="{m}" diaginertia="{i} {i} {i}"/>
  {rest}
</body>"""
ROBOT = """<mujoco model="double_pendulum">
  <option gravity="0 0 -{g}"/>
  <worldbody>{body}</worldbody>
  <actuator><motor joint="joint1"/><motor joint="joint2"/></actuator>
</mujoco>
"""


def described(folder: Path, p: dict[str, float], gravity: float) -> System:
    """The arm from a description with the publisher's values, its dry friction a Coulomb level."""
    body, rotor = "", p["gr"] ** 2 * p["Ir"]
    for k, z in ((2, -p["l1"]), (1, 0.0)):
        m, r = p[f"m{k}"], p[f"r{k}"]
        body = LINK.format(
            k=k, z=z, rotor=rotor, b=p[f"b{k}"], dry=p[f"cf{k}"] * math.pi / 2, com=-r, m=m,
            i=p[f"I{k}"] - m * r**2, rest=body,
        )  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(ROBOT.format(g=gravity, body=body))
    (folder / "model.yaml").write_text("robot: {file: arm.xml}\n")
    return load_model(folder / "model.yaml")


def main() -> None:
    """The test records of ``run.py``, by networks at one joint at a time, the other as measured."""
    torch.set_num_threads(1)
    config = read_yaml(Path(__file__).with_name("config.yaml"))
    data = Path(sys.argv[1] if len(sys.argv) > 1 else config["data"])
    for design in sys.argv[2:] or config["designs"]:
        how = config["designs"][design]
        system = described(
            OUT / design, read_yaml(data / "parameters" / how["parameters"]), config["gravity"]
        )
        records = []
        for day in how["days"]:
            for k, record in enumerate(read_day(config, data / "sys_id" / day)):
                role = "test" if day == how["scored"] and k in config["tests"] else "train"
                angles = {name: values for name, values in record.outputs.items() if name.startswith("q")}
                records.append(replace(record, outputs=angles, role=role))
        torques, angles = ([f"{name}{k}" for k in (1, 2)] for name in ("tau", "q_m"))
        dataset = Dataset(
            design,
            tuple(Channel(name, "N m") for name in torques),
            tuple(Channel(name, "rad", config["noise"]) for name in angles),
            tuple(records),
            config["sample_time"],
        )
        began = time.process_time()
        found = residuals_result(learn_residuals(dataset, system, horizon=Horizon.of(str(config["window"]))))
        seconds = time.process_time() - began
        (OUT / f"{design}.json").write_text(json.dumps(found | {"seconds": seconds}, indent=1))
        print(design, json.dumps(found, indent=1), f"{seconds:.0f} s", flush=True)


if __name__ == "__main__":
    main()
