"""Malformed model files, each with the words that its error must hold; for the loader and for the commands.

Use: `for case in malformed_models(): path = case.build(tmp_path)`, then load `path` and expect an InputError (or exit
code 2 from a command) whose one sentence names the file and holds every string of `case.names`.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

SOUND: dict[str, Any] = {
    "system": "one_link",
    "gear_ratio": [156.0],
    "gravity": "none",
    "parameters": {
        "J": {"nominal": 2.1e-5, "lower": 4.0e-6, "upper": 1.0e-4, "unit": "kg m^2"},
        "P_m1": {"nominal": 0.0185, "lower": 0.005, "upper": 0.08, "unit": "N m/V"},
        "P_m2": {"nominal": 0.0254, "unit": "V s/rad", "estimate": False},
        "F_c": 0.01,
        "F_v": {"nominal": 5.0e-5},
    },
    "components": [
        {"place": "joint1/motor_friction", "kind": "stribeck_friction", "parameters": {"F_drop": 0.004}}
    ],
}


@dataclass(frozen=True)
class MalformedModel:
    """One malformed model file.

    Attributes:
        name: id of the case.
        names: strings that the message must hold: the place of the fault.
        spoil: changes the sound content, or returns the text to write instead of it.
    """

    name: str
    names: tuple[str, ...]
    spoil: Callable[[dict[str, Any]], str | None]

    def build(self, folder: Path) -> Path:
        """Write the malformed file into a folder; return its path."""
        content = copy.deepcopy(SOUND)
        text = self.spoil(content)
        path = folder / "model.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False) if text is None else text, encoding="utf-8")
        return path


def write_sound_model(folder: Path) -> Path:
    """Write a small model file with nothing wrong."""
    return MalformedModel("sound", (), lambda _: None).build(folder)


def put(*path: str | int, to: object) -> Callable[[dict[str, Any]], None]:
    """Set one value, `put("parameters", "J", "nominal", to=-1)`."""

    def change(content: dict[str, Any]) -> None:
        part: Any = content
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = to

    return change


def drop(*path: str) -> Callable[[dict[str, Any]], None]:
    """Remove one key."""

    def change(content: dict[str, Any]) -> None:
        part = content
        for key in path[:-1]:
            part = part[key]
        del part[path[-1]]

    return change


def add_component(**entry: object) -> Callable[[dict[str, Any]], None]:
    """Add an entry to the components."""
    return lambda content: content["components"].append(entry)


def malformed_models() -> list[MalformedModel]:
    """Every malformed model file of the table."""
    friction = "joint1/motor_friction"
    return [
        MalformedModel("no system", ("system", "missing"), drop("system")),
        MalformedModel("unknown system", ("two_links", "one_link_flexible"), put("system", to="two_links")),
        MalformedModel("gear ratio of two joints", ("gear_ratio", "one"), put("gear_ratio", to=[10.0, 20.0])),
        MalformedModel("negative gear ratio", ("gear_ratio", "-5"), put("gear_ratio", to=[-5.0])),
        MalformedModel("inverse gear ratio", ("gear_ratio", "0.001"), put("gear_ratio", to=[0.001])),
        MalformedModel("gravity without G_l", ("gravity", "G_l"), put("gravity", to="vertical")),
        MalformedModel("unknown key", ("'gear_ration'", "gear_ratio"), put("gear_ration", to=3)),
        MalformedModel("unknown parameter", ("F_q", "F_c"), put("parameters", "F_q", to=0.1)),
        MalformedModel("missing parameter", ("'J'", "missing"), drop("parameters", "J")),
        MalformedModel("no nominal value", ("J", "nominal"), drop("parameters", "J", "nominal")),
        MalformedModel("not a number", ("J", "nan", "finite"), put("parameters", "J", "nominal", to=float("nan"))),
        MalformedModel("truth for a number", ("P_m1.nominal' is true",), put("parameters", "P_m1", "nominal", to=True)),
        MalformedModel("nominal outside its range", ("J", "0.5", "bounds"), put("parameters", "J", "nominal", to=0.5)),
        MalformedModel("range beyond physics", ("F_v", "physical range"), put("parameters", "F_v", "lower", to=-1.0)),
        MalformedModel("wrong unit", ("J", "g cm^2", "kg m^2"), put("parameters", "J", "unit", to="g cm^2")),
        MalformedModel("prior without width", ("J", "prior_std"), put("parameters", "J", "prior_std", to=0.0)),
        MalformedModel(
            "prior mean outside the bounds",
            (": J has prior_mean 5", "bounds"),
            lambda content: content["parameters"]["J"].update(prior_std=1e-6, prior_mean=5.0),
        ),
        MalformedModel(
            "range of one point",
            ("J", "estimate: false"),
            lambda content: content["parameters"]["J"].update(lower=2.1e-5, upper=2.1e-5),
        ),
        MalformedModel(
            "misspelt kind",
            ("components[1].kind", "'lu_gre'", "'lugre'"),
            add_component(place=friction, kind="lu_gre"),
        ),
        MalformedModel(
            "unknown place",
            ("components[1].place", "'joint1/gearbox'", "transmission"),
            add_component(place="joint1/gearbox", kind="dahl"),
        ),
        MalformedModel(
            "misspelt place without a joint",
            ("components[1].place", "'motor_frction' names no joint", "JOINT/motor_friction, JOINT one of joint1"),
            add_component(place="motor_frction", kind="dahl"),
        ),
        MalformedModel(
            "gravity in a wrong place",
            ("arm_gravity cannot sit in 'joint1/sensor'",),
            add_component(place="joint1/sensor", kind="arm_gravity"),
        ),
        MalformedModel(
            "parameter of another law",
            ("stribeck_friction", "F_c", "F_drop"),
            put("components", 0, "parameters", to={"F_c": 0.1}),
        ),
        MalformedModel(
            "component out of bounds",
            ("stribeck_friction", "v_s", "bounds"),
            put("components", 0, "parameters", to={"v_s": -1.0}),
        ),
        MalformedModel(
            "same component twice",
            ("stribeck_friction", "twice"),
            add_component(place=friction, kind="stribeck_friction"),
        ),
        MalformedModel(
            "two motors",
            ("joint1/motor", "current_motor", "torque_motor"),
            lambda content: content["components"].extend(
                {"place": "joint1/motor", "kind": kind} for kind in ("current_motor", "torque_motor")
            ),
        ),
        MalformedModel(
            "parameter of a replaced motor",
            ("P_m1, P_m2 of dc_motor", "'components'"),
            add_component(place="joint1/motor", kind="torque_motor"),
        ),
        MalformedModel(
            "two bristles",
            ("bristle",),
            lambda content: content["components"].extend(
                {"place": friction, "kind": kind} for kind in ("dahl", "lugre")
            ),
        ),
        MalformedModel(
            "law listed flat and as a component",
            ("coulomb_friction", "'F_c'"),
            add_component(place=friction, kind="coulomb_friction", parameters={"F_c": 0.02}),
        ),
        MalformedModel("runs code", ("YAML",), lambda _: "system: !!python/object/apply:os.getcwd []\n"),
    ]  # fmt: skip
