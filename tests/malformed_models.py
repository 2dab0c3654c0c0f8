"""Malformed model files, each with the words that its error must hold.

Use: `for case in malformed_models(): path = case.build(tmp_path)`, then load `path` and expect an InputError (or exit
code 2 from a command) whose one sentence names the file and holds every string of `case.names`.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from malformed import Malformed, change_yaml, put, write

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


def write_sound_model(folder: Path) -> Path:
    """Write a small model file with nothing wrong."""
    (folder / "model.yaml").write_text(yaml.safe_dump(SOUND, sort_keys=False))
    return folder / "model.yaml"


def added(*kinds: str, place: str = "joint1/motor_friction", **more: object) -> Callable[[dict], None]:
    """Add entries to the components."""
    return lambda content: content["components"].extend({"place": place, "kind": k} | more for k in kinds)


def drop(*path: str) -> Callable[[dict], object]:
    """Remove one key."""
    return lambda content: (content["parameters"][path[0]] if path[1:] else content["parameters"]).pop(
        path[-1]
    )


def malformed_models() -> list[Malformed]:
    """Every malformed model file of the table."""
    inertia, misspelt = content_of("J"), "JOINT/motor_friction, JOINT one of joint1"
    rows = [
        ("no system", ("system", "missing"), lambda content: content.pop("system")),
        ("unknown system", ("two_links", "one_link_flexible"), put("system", to="two_links")),
        ("gear ratio of two joints", ("gear_ratio", "one"), put("gear_ratio", to=[10.0, 20.0])),
        ("negative gear ratio", ("gear_ratio", "-5"), put("gear_ratio", to=[-5.0])),
        ("inverse gear ratio", ("gear_ratio", "0.001"), put("gear_ratio", to=[0.001])),
        ("gravity without G_l", ("gravity", "G_l"), put("gravity", to="vertical")),
        ("unknown key", ("'gear_ration'", "gear_ratio"), put("gear_ration", to=3)),
        ("unknown parameter", ("F_q", "F_c"), put("parameters", "F_q", to=0.1)),
        ("missing parameter", ("'J'", "missing"), drop("J")),
        ("no nominal value", ("J", "nominal"), drop("J", "nominal")),
        ("not a number", ("J", "nan", "finite"), inertia(nominal=float("nan"))),
        ("truth for a number", ("P_m1.nominal' is true",), content_of("P_m1")(nominal=True)),
        ("nominal outside its range", ("J", "0.5", "bounds"), inertia(nominal=0.5)),
        ("range beyond physics", ("F_v", "physical range"), content_of("F_v")(lower=-1.0)),
        ("wrong unit", ("J", "g cm^2", "kg m^2"), inertia(unit="g cm^2")),
        ("prior without width", ("J", "prior_std"), inertia(prior_std=0.0)),
        ("prior mean outside the bounds", (": J has prior_mean 5", "bounds"), inertia(prior_std=1e-6, prior_mean=5.0)),
        ("range of one point", ("J", "estimate: false"), inertia(lower=2.1e-5, upper=2.1e-5)),
        ("misspelt kind", ("components[1].kind", "'lu_gre'", "'lugre'"), added("lu_gre")),
        ("unknown place", ("components[1].place", "'joint1/gearbox'", "transmission"),
         added("dahl", place="joint1/gearbox")),
        ("place without a joint", ("'motor_frction' names no joint", misspelt), added("dahl", place="motor_frction")),
        ("gravity in a wrong place", ("arm_gravity cannot sit in 'joint1/sensor'",),
         added("arm_gravity", place="joint1/sensor")),
        ("parameter of another law", ("stribeck_friction", "F_c", "F_drop"),
         put("components", 0, "parameters", to={"F_c": 0.1})),
        ("component out of bounds", ("stribeck_friction", "v_s", "bounds"),
         put("components", 0, "parameters", to={"v_s": -1.0})),
        ("same component twice", ("stribeck_friction", "twice"), added("stribeck_friction")),
        ("two motors", ("joint1/motor", "current_motor", "torque_motor"),
         added("current_motor", "torque_motor", place="joint1/motor")),
        ("replaced motor", ("P_m1, P_m2 of dc_motor", "'components'"), added("torque_motor", place="joint1/motor")),
        ("two bristles", ("bristle",), added("dahl", "lugre")),
        ("law listed twice", ("coulomb_friction", "'F_c'"), added("coulomb_friction", parameters={"F_c": 0.02})),
    ]  # fmt: skip
    changes = {name: partial(change_yaml, change=change, name="model.yaml") for name, _, change in rows}
    cases = [Malformed(name, names, changes[name], write_sound_model) for name, names, _ in rows]
    texts = [
        ("runs code", ("YAML",), "system: !!python/object/apply:os.getcwd []\n"),
        ("long name", ("robot.file", "is longer than the name of any"), f"robot: {{file: {'r' * 300}}}\n"),
    ]
    written = [
        Malformed(name, names, write("model.yaml", text), write_sound_model) for name, names, text in texts
    ]
    return cases + written


def content_of(name: str) -> Callable[..., Callable[[dict], None]]:
    """Change what is said of one parameter."""
    return lambda **more: lambda content: content["parameters"][name].update(more)
