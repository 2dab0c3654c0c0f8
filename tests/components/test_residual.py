"""The residual network: nothing at the start, any place, bounded, remembering, and back from a model file."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from drives import batch_of, flexible_drive, multisine, rigid_drive, run, stored
from torch import Tensor

from hybrid_id.components import ResidualNetwork
from hybrid_id.components.bristle import relax
from hybrid_id.errors import InputError
from hybrid_id.simulation.rollout import rollout, simulate
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, two_link
from hybrid_id.systems.model_file import load_model, save_model

PLACES = ResidualNetwork.places
U = {"u1": multisine(0, samples=20, rest=5)}


def awake(part: ResidualNetwork, size: float = 0.3) -> ResidualNetwork:
    """The network with random weights in its last layer."""
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for weight in part.layers[-1].parameters():
            weight.copy_(size * torch.randn(weight.shape, generator=generator, dtype=weight.dtype))
    return part


def hybrid(place: str, size: float = 0.3, output_scale: float = 1e-3, **options) -> System:
    """A flexible drive with an awake network in a place."""
    settings: dict[str, Any] = {"inputs": ("speed", "sin 1")} | options
    part = ResidualNetwork(**settings, output_scale=output_scale)
    return flexible_drive().with_component(f"joint1/{place}", awake(part, size))


def network(system: System) -> ResidualNetwork:
    return next(iter(system.networks.values()))


@pytest.mark.parametrize("place", PLACES)
def test_a_fresh_network_changes_nothing(place: str) -> None:
    plain = run(flexible_drive(), U)
    fresh = run(hybrid(place, size=0.0, memory=2), U)
    for name, states in plain.items():
        assert (fresh[name] == states).all()


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("memory", [0, 2])
def test_lanes_engines_and_solvers_agree(place: str, memory: int) -> None:
    system = hybrid(place, memory=memory, output_scale=0.05 if place in PLACES[3:] else 1e-3)
    batch = batch_of(system, U, rows=2)
    dry = simulate(system, Engine("dry", 4), batch)
    assert dry.status == ("ok", "ok")
    torch.testing.assert_close(dry.x[0], dry.x[1])
    smooth = rollout(system, Engine("smooth", 12, width=0.5), batch, stored(system, 2))
    solver = OdeEngine(substeps=12, width=0.5, fine=12)
    exact = rollout(system, solver, batch, stored(system, 2))
    torch.testing.assert_close(smooth, exact, rtol=2e-3, atol=2e-3 * float(exact.abs().max()))
    assert float((dry.x - exact)[..., 0].abs().max()) < 0.05 * float(exact[..., 0].abs().max())


SIGNS: list[tuple[str, float, Callable[[System], int]]] = [
    ("motor", 1.0, lambda s: s.speed_rows[0]),
    ("motor_friction", -1.0, lambda s: s.speed_rows[0]),
    ("link_friction", -1.0, lambda s: s.speed_rows[1]),
    ("load", -1.0, lambda s: s.speed_rows[1]),
]


@pytest.mark.parametrize(("place", "sign", "row"), SIGNS)
def test_its_output_acts_as_its_place_says(place: str, sign: float, row: Callable[[System], int]) -> None:
    system = hybrid(place, output_scale=0.02)
    p = system.views(list(stored(system)))
    x = [torch.tensor([value], dtype=torch.float64) for value in (0.3, 2.0, 0.001, 0.01)]
    u = {"u1": torch.zeros(1, dtype=torch.float64)}
    torque = system.outputs([f"r_{place}1"], x, u, p)[0]
    without = system.without_component(f"joint1/{place}", "residual_network")
    plain = without.rates(x, u, without.views(list(stored(without))))
    change = system.rates(x, u, p)[row(system)] - plain[row(system)]
    inertia = {i.name: i.spec.value for i in system.table}["J_m" if row(system) == 1 else "J_a"]
    torch.testing.assert_close(change * inertia, sign * torque)


def test_signals_are_those_of_the_side_and_of_the_other_joint() -> None:
    link = ResidualNetwork(inputs=("angle", "speed", "angle2", "torque", "load"))
    system = two_link((50.0, 30.0), vertical=True).with_component("joint1/load", link)
    x = [torch.tensor([v], dtype=torch.float64) for v in (5.0, 100.0, 3.0, 60.0)]
    u = {"u1": torch.ones(1, dtype=torch.float64), "u2": torch.zeros(1, dtype=torch.float64)}
    p = system.views(list(stored(system)))
    inputs, _ = system.joints[0].networks.signals("load", x, u, p)
    assert [round(float(v), 9) for v in inputs[:3]] == [0.1, 2.0, 0.1]
    value = {i.name: i.spec.value for i in system.table}
    assert float(inputs[3]) == pytest.approx(value["P_m1m1"] * (1.0 - value["P_m2m1"] * 100.0))


def test_a_rigid_gear_transmits_what_the_link_needs() -> None:
    """The torque through the gear moves the link and carries its load; dry friction is left out of it."""
    part = ResidualNetwork(inputs=("transmitted",))
    system = rigid_drive(vertical=True, ratio=20.0).with_component("joint1/motor_friction", part)
    x = [torch.tensor([v], dtype=torch.float64) for v in (5.0, -60.0)]
    u = {"u1": torch.full((1,), 2.0, dtype=torch.float64)}
    for friction, agrees in ((0.0, True), (0.01, False)):
        system = system.with_values({"F_c": friction, "J": 2e-5, "rotor_share": 0.3})
        p = system.views(list(stored(system)))
        (told,), _ = system.joints[0].networks.signals("motor_friction", x, u, p)
        acceleration = system.rates(x, u, p)[1] / 20.0
        load = system.joints[0].load_torque(x[0] / 20.0, x[1] / 20.0, u, p)
        needed = load + 0.7 * 2e-5 * 20.0**2 * acceleration
        assert bool(torch.isclose(told, needed)) is agrees


def test_a_direction_is_a_sign_that_one_neuron_weighs_against_another_input() -> None:
    part = ResidualNetwork(inputs=("direction", "load"), hidden=(1,), scale=(0.5, 1.0))
    weights = part.weights()
    with torch.no_grad():
        for name, value in (("layers.0.weight", 1.0), ("layers.0.bias", 0.0), ("layers.1.weight", 1.0)):
            weights[name].fill_(value)
    speed, load = torch.tensor([[400.0, -400.0], [0.7, 0.7]], dtype=torch.float64)
    found = part.output(part.view(), [speed, load], [])
    torch.testing.assert_close(found, torch.tanh(torch.tensor([1.7, -0.3], dtype=torch.float64)))


def test_the_bound_holds_whatever_the_weights() -> None:
    part = awake(ResidualNetwork(inputs=("angle", "speed"), scale=(0.5, 10.0), lipschitz=2.0), size=50.0)
    with torch.no_grad():
        for weight in part.parameters():
            if weight.dim() == 2:
                weight.mul_(30.0)
    generator = torch.Generator().manual_seed(0)
    a, b = (10.0 * torch.randn(2, 4000, generator=generator, dtype=torch.float64) for _ in range(2))
    change = part.output(part.view(), list(a), []) - part.output(part.view(), list(b), [])
    largest = ((a - b) / torch.tensor([[0.5], [10.0]])).abs().amax(0)
    assert bool((change.abs() <= 2.0 * largest * (1 + 1e-12)).all())


@torch.no_grad()
def test_hidden_states_relax_and_stay_inside_one() -> None:
    part = ResidualNetwork(memory=3, seed=2)
    state, speed = [torch.zeros(1, dtype=torch.float64)] * 3, torch.full((1,), 7.0, dtype=torch.float64)
    for _ in range(4000):
        pairs = part.state_updates(part.view(), [speed], state)
        state = [relax(h, *pair, torch.full_like(h, 0.01)) for h, pair in zip(state, pairs, strict=True)]
    assert all(abs(float(h)) < 1.0 for h in state)
    for h, (drive, rate) in zip(state, part.state_updates(part.view(), [speed], state), strict=True):
        torch.testing.assert_close(drive, rate * h, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("memory", [0, 2])
def test_weights_of_each_lane_stand_in_for_its_own(memory: int) -> None:
    part = awake(ResidualNetwork(inputs=("angle", "speed"), memory=memory, lipschitz=3.0))
    signals = list(torch.randn(2, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(3)))
    states: list[Tensor] = [torch.full((5,), 0.1, dtype=torch.float64)] * memory
    p, lanes = part.view(), part.view()
    for name, weight in part.weights().items():
        setattr(lanes, name, weight[..., None].expand(*weight.shape, 5))
    torch.testing.assert_close(part.output(lanes, signals, states), part.output(p, signals, states))
    for a, b in zip(
        part.state_updates(lanes, signals, states), part.state_updates(p, signals, states), strict=True
    ):
        torch.testing.assert_close(a, b)


def test_model_file_and_state_dict_keep_it(tmp_path: Path) -> None:
    system = hybrid("load", memory=2, lipschitz=4.0, shift=[0.1, 0.0], scale=[3.0, 1.0])
    save_model(system, tmp_path / "model.yaml")
    again = load_model(tmp_path / "model.yaml")
    assert again.state_names == system.state_names and network(again).options() == network(system).options()
    fresh = hybrid("load", size=0.0, memory=2, lipschitz=4.0)
    fresh.load_state_dict(system.state_dict())
    for other in (again, fresh, copy.deepcopy(system), system.with_values({"k": 250.0})):
        for name, weight in network(system).weights().items():
            assert torch.equal(network(other).weights()[name], weight)
        assert torch.equal(network(other).scale, network(system).scale)


def test_faults_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no input 'colour'"):
        rigid_drive().with_component("joint1/motor", ResidualNetwork(inputs=("colour",)))
    with pytest.raises(InputError, match="no input 'deflection'"):
        rigid_drive().with_component("joint1/motor", ResidualNetwork(inputs=("deflection",)))
    with pytest.raises(InputError, match="no spring torque"):
        rigid_drive().with_component("joint1/transmission", ResidualNetwork())
    faults: list[dict[str, Any]] = [
        {"inputs": ()},
        {"scale": [0.0]},
        {"scale": [1.0, 2.0]},
        {"lipschitz": -1.0},
        {"hidden": [0]},
    ]
    for options in faults:
        with pytest.raises(InputError, match="residual_network"):
            ResidualNetwork(**options)
    save_model(hybrid("motor"), tmp_path / "model.yaml")
    text = (tmp_path / "model.yaml").read_text()
    for old, new, words in (
        ("layers.0.bias", "layers.7.bias", "layers.7.bias"),
        ("hidden: [8, 8]", "hidden: [8, 9]", "must hold 9 x 8"),
        ("hidden: [8, 8]", "hiden: [8, 8]", "no option 'hiden'"),
        ("hidden: [8, 8]", "hidden: many", "give whole numbers from 1 to 1000"),
    ):
        assert old in text
        (tmp_path / "broken.yaml").write_text(text.replace(old, new))
        with pytest.raises(InputError, match=words) as caught:
            load_model(tmp_path / "broken.yaml")
        assert "\n" not in str(caught.value)
