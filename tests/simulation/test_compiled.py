"""The compiled engine gives what the reference gives: reversals, standstill, coupled links, memory, smooth friction."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from drives import batch_of, flexible_drive, make_records, multisine, rigid_drive, stored
from torch import Tensor

from hybrid_id.components import (
    AsymmetricStribeck,
    Cogging,
    Coulomb,
    Dahl,
    Delay,
    ElectricalLag,
    LinearSpring,
    LoadDependent,
    LuGre,
    PositionDependent,
    ResidualNetwork,
    Spring,
    Stribeck,
)
from hybrid_id.errors import InputError
from hybrid_id.simulation import compiled as compiled_engine
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.c_code import library
from hybrid_id.simulation.compiled import compiled_for, source, supports_compiled
from hybrid_id.simulation.lifted import condense, condense_reference, linearise, shoot
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import rollout, simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link_flexible, two_link

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")

FRICTION, LINK = "joint1/motor_friction", "joint1/link_friction"
ARM = {
    "P_1": 1.101, "P_2": 0.136, "P_3": 0.148, "P_4": 0.068, "P_m1m1": 0.019, "P_m2m1": 0.0254,
    "P_m1m2": 0.0426, "P_m2m2": 0.0107, "F_cm1": 0.011, "F_vm1": 5e-5, "F_cm2": 0.0024, "F_vm2": 2e-5,
}  # fmt: skip


def arm(*, vertical: bool = False) -> System:
    return two_link((156.0, 84.0), vertical=vertical).with_values(ARM)


def behind_springs() -> System:
    """An arm whose gears are compliant, dry friction on rotors and links."""
    system = arm()
    for n in (1, 2):
        system = system.with_component(f"joint{n}/transmission", LinearSpring(k=3000.0, d=2.0))
        system = system.with_component(f"joint{n}/link_friction", Coulomb(F_c=0.3))
    return system


SYSTEMS = {
    "coulomb": rigid_drive(),
    "stribeck": rigid_drive(Stribeck(), vertical=True),
    "load": rigid_drive(AsymmetricStribeck(), vertical=True).with_component(FRICTION, LoadDependent(mu=0.2)),
    "angle": rigid_drive().with_component(FRICTION, PositionDependent()),
    "flexible": flexible_drive().with_component(LINK, Coulomb(F_c=0.4)),
    "one side": flexible_drive(),
    "no friction": rigid_drive().without_component(FRICTION, "coulomb_friction"),
    "arm": arm(vertical=True),
    "one dry link": arm().without_component("joint2/motor_friction", "coulomb_friction"),
    "loaded arm": arm(vertical=True).with_component(FRICTION, LoadDependent(mu=0.1)),
    "springs": behind_springs(),
    # 5 states by 20 columns of tangents: a compiler that aligns them wrongly crashes here
    "bristles on a spring": flexible_drive()
    .with_component(FRICTION, LuGre())
    .with_component("joint1/load", Spring(k_s=0.5)),
    "dahl": rigid_drive().with_component(FRICTION, Dahl(sigma=0.5)),
    "lugre": flexible_drive().with_component(FRICTION, LuGre(sigma_0=0.5)),
    "winding": rigid_drive().with_component("joint1/motor", ElectricalLag()),
}


def signals(joints: int, samples: int = 120) -> dict[str, np.ndarray]:
    """Reversals, a long standstill, a creeping voltage at which joints stick and slip, (3, T) a channel."""
    found = {}
    for n in range(joints):
        volts = np.stack([multisine(7 * n + k, samples=samples, amplitude=12.0, rest=10) for k in range(3)])
        volts[1, 30:] *= 0.02
        volts[1, 80:] *= 60.0
        volts[2] *= 0.15
        found[f"u{n + 1}"] = volts
    return found


def moved(system: System, outputs: tuple[str, ...] = ("q_m1",)) -> tuple[Batch, Tensor]:
    """Three rows, the second padded, with parameters of their own."""
    batch = batch_of(system, signals(len(system.joints)), rows=3, outputs=outputs)
    batch.dt[1, 100:] = 0.0
    return batch, stored(system, 3) * torch.tensor([1.0, 0.9, 1.05])


def assert_same(found: Tensor, expected: Tensor) -> None:
    scale = expected.abs().amax((0, 1)).clamp_min(1e-300)
    torch.testing.assert_close(found / scale, expected / scale, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "substeps"), [(n, 1) for n in SYSTEMS] + [("stribeck", 3), ("flexible", 3), ("arm", 3)]
)
def test_compiled_steps_equal_eager_ones(name: str, substeps: int) -> None:
    system, eager = SYSTEMS[name], Engine(substeps=substeps)
    batch, theta = moved(system)
    compiled = replace(eager, compiled=True)
    assert supports_compiled(system, compiled, batch.x)
    whole = rollout(system, eager, batch, theta)
    assert_same(rollout(system, compiled, batch, theta), whole)
    if any(system.dry):  # the records do what they are for
        speed = whole[..., system.speed_rows[system.dry.index(True)]]
        assert ((speed == 0).float().mean() > 0.05) and ((speed[:, 1:] * speed[:, :-1]) < 0).any()
    off = whole + 0.02 * torch.sin(torch.arange(120.0, dtype=torch.float64))[:, None]
    for length in (7, 50):
        arguments = (off, batch.u, batch.dt, theta, length)
        assert_same(shoot(system, compiled, *arguments), shoot(system, eager, *arguments))


@pytest.mark.parametrize(
    ("name", "substeps"), [(n, 1) for n in SYSTEMS] + [("stribeck", 3), ("flexible", 3), ("arm", 3)]
)
def test_compiled_sensitivities_equal_eager_ones(name: str, substeps: int) -> None:
    system = SYSTEMS[name]
    batch, theta = moved(system, ("q_m1", "tau1"))
    compiled = Engine(substeps=substeps, compiled=True)
    x = shoot(system, compiled, batch.x, batch.u, batch.dt, theta, 120)
    x = x + 1e-3 * torch.sin(torch.arange(120.0, dtype=torch.float64))[:, None]
    x[:, ::3] = rollout(system, compiled, batch, theta)[:, ::3]
    for free in ([], list(range(len(system.table)))):
        arguments = (x, batch.u, batch.dt, theta, free, batch.outputs)
        found = linearise(system, compiled, *arguments)
        expected = linearise(system, Engine(substeps=substeps), *arguments)
        for one in ("x_next", "a", "b", "y", "d"):
            assert_same(getattr(found, one), getattr(expected, one))


@pytest.mark.parametrize("compiled", [True, False])
def test_channels_of_fewer_rows_repeat(compiled: bool) -> None:
    system, engine = SYSTEMS["stribeck"], Engine(compiled=compiled)
    batch, theta = moved(system)
    twice = torch.cat([theta, 1.1 * theta], 1)
    x = batch.x.repeat(2, 1, 1)
    every = {name: channel.repeat(2, 1) for name, channel in batch.u.items()}
    whole = shoot(system, engine, x, every, batch.dt.repeat(2, 1), twice, 120)
    assert torch.equal(shoot(system, engine, x, batch.u, batch.dt, twice, 120), whole)
    assert torch.equal(whole[1, 101:], whole[1, 100:101].expand(19, -1))  # behind its end a record stays


@pytest.mark.parametrize("name", ["stribeck", "load", "dahl", "flexible", "coulomb", "arm", "loaded arm"])
def test_compiled_steps_with_smooth_friction_equal_eager_ones(name: str) -> None:
    system, compiled = SYSTEMS[name], Engine("smooth", substeps=12, width=0.4, compiled=True)
    eager = replace(compiled, compiled=False)
    inputs = {
        f"u{n + 1}": np.stack([multisine(7 * n + k, samples=75, rest=3) for k in range(2)])
        for n in range(len(system.joints))
    }
    batch = batch_of(system, inputs, rows=2, outputs=("q_m1", "tau1"))
    theta = stored(system, 2) * torch.tensor([1.0, 1.1])
    free = [0, 2, len(system.table) - 1]
    whole = rollout(system, eager, batch, theta)
    torch.testing.assert_close(rollout(system, compiled, batch, theta), whole, rtol=1e-9, atol=1e-12)
    x = shoot(system, eager, whole + 0.01, batch.u, batch.dt, theta, 4)
    found = shoot(system, compiled, whole + 0.01, batch.u, batch.dt, theta, 4)
    torch.testing.assert_close(found, x, rtol=1e-9, atol=1e-12)
    for some in (free, []):
        arguments = (x, batch.u, batch.dt, theta, some, batch.outputs)
        expected, lin = (linearise(system, engine, *arguments) for engine in (eager, compiled))
        torch.testing.assert_close(lin.y, expected.y, rtol=1e-10, atol=1e-13)
        chain, fast = condense_reference(expected, x), condense(lin, x)
        scale = chain.abs().amax((0, 1)).clamp_min(1e-9)
        torch.testing.assert_close(fast / scale, chain / scale, rtol=1e-8, atol=1e-9)


def test_one_code_serves_all_machines_of_a_structure() -> None:
    system = SYSTEMS["flexible"]
    other = system.with_values({"J_m": 2e-5, "F_cm": 0.02, "k": 100.0})
    assert source(system, ("u1",)) == source(other, ("u1",))
    (code, constants), (same, others) = (
        source(one_link_flexible(ratio).with_component(LINK, Coulomb(F_c=0.4)), ("u1",))
        for ratio in (50.0, 80.0)
    )
    assert code == same, "a gear ratio is a number beside the parameters"
    assert constants != others
    assert source(system, ("u1",))[0] != source(SYSTEMS["coulomb"], ("u1",))[0]


@pytest.mark.parametrize("name", ["springs", "loaded arm"])
def test_a_function_in_parts_computes_the_same(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    system, compiled = SYSTEMS[name], Engine(compiled=True)
    batch, theta = moved(system)
    free = list(range(len(system.table)))

    def found() -> list[Tensor]:
        x = rollout(system, compiled, batch, theta)
        parts = linearise(system, compiled, x, batch.u, batch.dt, theta, free, batch.outputs)
        return [x, parts.x_next, parts.a, parts.b]

    whole = found()
    monkeypatch.setattr(compiled_engine, "WHOLE", 100)
    monkeypatch.setattr(compiled_engine, "PART", 60)
    monkeypatch.setattr(compiled_engine, "_EQUATIONS", {})
    monkeypatch.setattr(compiled_engine, "noted", lambda *_: None)
    assert "rates_2(" in source(system, ["u1", "u2"], free)[0]
    for one, other in zip(found(), whole, strict=True):
        assert_same(one, other)


def test_lanes_do_not_depend_on_those_beside_them() -> None:
    system = SYSTEMS["arm"]
    batch = batch_of(system, signals(2, 200), rows=3).take(torch.arange(11) % 3)
    theta = stored(system, 11) * torch.linspace(0.9, 1.1, 11, dtype=torch.float64)
    whole = rollout(system, Engine(compiled=True), batch, theta)
    for k in (0, 5, 10):
        alone = rollout(system, Engine(compiled=True), batch.take(torch.tensor([k])), theta[:, [k]])
        assert torch.equal(alone[0], whole[k])


@pytest.mark.parametrize("friction", ["dry", "smooth"])
def test_a_delay_is_served(friction: str) -> None:
    eager, compiled = Engine(friction, 4), Engine(friction, 4, compiled=True)
    system = rigid_drive().with_component("joint1/input", Delay(T_d=0.0033))
    records = make_records(rigid_drive(), [multisine(k, samples=200, rest=20) for k in range(2)], noise={})
    batch = make_batch(system, records)
    theta = stored(system, 2) * torch.tensor([1.0, 1.2])
    assert_same(rollout(system, compiled, batch, theta), rollout(system, eager, batch, theta))
    arguments = (batch.x, batch.u, batch.dt, theta, list(range(len(system.table))), batch.outputs)
    found, expected = (linearise(system, engine, *arguments) for engine in (compiled, eager))
    assert_same(found.b, expected.b)  # by the dead time as well


def test_simulation_takes_the_loop_and_tells_divergence() -> None:
    system = SYSTEMS["arm"]
    batch, theta = moved(system, ("q_m1", "v_a2", "tau1"))
    theta[0, 2] = torch.nan
    found = simulate(system, Engine(compiled=True), batch, theta)
    expected = simulate(system, Engine(), batch, theta)
    assert found.status == expected.status == ("ok", "ok", "diverged")
    torch.testing.assert_close(found.y[:2], expected.y[:2], rtol=1e-7, atol=1e-9)


def test_compiled_steps_are_for_the_cpu_without_networks() -> None:
    x = torch.zeros(1, 2, 2, dtype=torch.float64)
    for friction in ("dry", "smooth"):
        compiled = Engine(friction, compiled=True)
        assert supports_compiled(rigid_drive(), compiled, x)
        assert not supports_compiled(rigid_drive(), Engine(friction), x)
        assert not supports_compiled(rigid_drive(), compiled, x.float())
        network = rigid_drive().with_component("joint1/motor", ResidualNetwork())
        assert not supports_compiled(network, compiled, x)


def test_missing_compiler_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    monkeypatch.setattr("hybrid_id.simulation.compiled.library", library.__wrapped__)
    monkeypatch.setattr("hybrid_id.simulation.compiled._EQUATIONS", {})
    monkeypatch.setattr("hybrid_id.simulation.compiled.noted", lambda *_: None)
    system = rigid_drive()
    batch, theta = moved(system)
    with pytest.raises(InputError, match="C compiler"):
        rollout(system, Engine(compiled=True), batch, theta)


def test_a_compiler_that_makes_nothing_is_none(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As gcc without the C library's headers."""
    broken = tmp_path / "gcc"
    broken.write_text("#!/bin/sh\necho 'math.h: No such file' >&2\nexit 1\n")
    broken.chmod(0o755)
    assert compiled_for(rigid_drive(), Engine()).compiled
    for once in (compiled_engine.compiler_works, compiled_engine._engine):
        once.cache_clear()
    with monkeypatch.context() as patched:
        patched.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
        patched.setenv("XDG_CACHE_HOME", str(tmp_path / "empty"))
        patched.setattr("hybrid_id.simulation.c_code.AHEAD", tmp_path / "none")
        patched.setattr("hybrid_id.simulation.compiled.library", library.__wrapped__)
        assert compiled_for(rigid_drive(), Engine()) == Engine()
    compiled_engine.compiler_works.cache_clear()


@pytest.mark.parametrize("name", ["coulomb", "arm"])
@pytest.mark.parametrize("damage", [None, "note", "library", "program"])
def test_a_later_run_neither_records_nor_compiles(
    name: str, damage: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    system = SYSTEMS[name]
    batch, theta = moved(system)
    rollout(system, Engine(compiled=True), batch, theta)  # compiles the engine, if nothing has
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("hybrid_id.simulation.c_code.AHEAD", tmp_path / "none")

    def run() -> Tensor:
        monkeypatch.setattr(compiled_engine, "_EQUATIONS", {})
        library.cache_clear()
        return rollout(system, Engine(compiled=True), batch, theta)

    recorded: list[System] = []
    monkeypatch.setattr(compiled_engine, "source", lambda s, *a: recorded.append(s) or source(s, *a))
    first = run()
    (note,), (code,) = ((tmp_path / "hybrid_id").glob(f"*.{ending}") for ending in ("json", "so"))
    if damage == "program":  # another version of this package
        monkeypatch.setattr(compiled_engine, "_program", lambda: "other")
    elif damage:
        (note if damage == "note" else code).write_bytes(b"{}")
    if damage is None:
        monkeypatch.setattr(shutil, "which", lambda _: None)  # nor is a compiler needed
    again = run()
    assert torch.equal(again, first)
    assert len(recorded) == 1 + (damage is not None)


def test_a_law_that_was_changed_is_compiled_anew(tmp_path: Path) -> None:
    shutil.copytree(Path(compiled_engine.__file__).parents[1], tmp_path / "hybrid_id")
    script = (
        "from drives import rigid_drive, run\nfrom hybrid_id import Engine\nimport numpy as np\n"
        "system = rigid_drive().with_values({'F_v': 1e-3})\n"
        "print(run(system, {'u1': np.ones(50)}, engine=Engine(compiled=True))['v_m1'][-1])"
    )
    paths = os.pathsep.join([str(tmp_path), str(Path(__file__).parents[1])])
    known = os.environ | {
        "PYTHONPATH": paths,
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }

    def speed() -> float:
        found = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, env=known, capture_output=True)
        return float(found.stdout)

    before, law = speed(), tmp_path / "hybrid_id" / "components" / "friction" / "viscous.py"
    law.write_text(law.read_text().replace("return p.F_v * speed", "return 3.0 * p.F_v * speed"))
    assert speed() < 0.9 * before


def test_a_component_of_ones_own_is_recorded_by_every_run(monkeypatch: pytest.MonkeyPatch) -> None:
    own = type("Own", (Cogging,), {})
    system = rigid_drive().with_component("joint1/motor", own())
    batch, theta = moved(system)
    rollout(
        rigid_drive(), Engine(compiled=True), *moved(rigid_drive())
    )  # compiles the engine, if nothing has
    monkeypatch.setattr(compiled_engine, "noted", lambda *_: pytest.fail("not asked for"))
    rollout(system, Engine(compiled=True), batch, theta)
