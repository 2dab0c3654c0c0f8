"""Compiled engine: what :mod:`hybrid_id.simulation.step` does, as vector code for this machine and this structure.

The equations of motion are recorded with their gradients (:mod:`hybrid_id.simulation.tracing`) and put into the places
of ``equations.c.in``. ``engine.c`` steps any of them: it holds the loops over samples and sub-steps, the events of dry
friction and the tangents, and is compiled once for a machine. Tangents follow the same steps, the moments of events
included: they are those of the discrete map, as the reference's are. Smooth friction is the same code without dry
speeds. A compiler takes a tenth of a second or two for the equations of a joint; values of parameters and numbers of a
machine (gear ratios, say) stay free, so that a search meets the same code in hundreds of systems.
"""

from __future__ import annotations

import functools
import hashlib
import platform
import re
from collections.abc import Callable, Mapping, Sequence
from ctypes import CDLL
from dataclasses import replace
from importlib import resources
from pathlib import Path
from string import Template
from typing import cast
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor, nn

from hybrid_id.components.base import Component
from hybrid_id.errors import InputError
from hybrid_id.simulation.c_code import address, call, compiler, library, note, noted
from hybrid_id.simulation.parts import NAMES, Body, assigned, in_lanes, in_parts, lanes, lines, stored
from hybrid_id.simulation.step import Engine, update_internal_states
from hybrid_id.simulation.tracing import DECLARED, WRAPPED, record
from hybrid_id.systems.balance import PIVOTS, Directions
from hybrid_id.systems.chain import PUSH, Channels, System, Views

FLAGS = (
    "-O1", "-fexpensive-optimizations", "-march=native", "-std=gnu11", "-fPIC", "-fopenmp-simd",
    "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off", "-fno-builtin-sin", "-fno-builtin-cos",
)  # fmt: skip
"""As exact as the reference: whether a joint sticks may hang on a difference that is zero. With -O1 alone GCC leaves
the upper halves of vector registers dirty, and every pow, exp or sin is ten times slower."""
if platform.machine() in ("x86_64", "AMD64"):  # eight lanes in one register where the processor has such
    FLAGS = (*FLAGS, "-mprefer-vector-width=512")
PLAIN = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0)
"""Numbers that belong to a formula and not to a machine."""
NUMBER = re.compile(r"(?<![\w.])(?:\d+\.\d+(?:e[-+]?\d+)?|\d+e[-+]?\d+)(?![\w.])")
"""A number in a recorded expression."""
WHOLE, PART = 5000, 3000
"""A function of more statements than the first is compiled in parts of the second, as compilers' time and memory grow
faster than a function does: six joints with ten parameters each in 11 s, and not in 42, at steps as fast."""
ARRAYS = {
    "rates": ("x", "u", "p", "fixed", "d", "k", "g"),
    "margins": ("x", "u", "p", "fixed", "s", "d", "side", "margin", "against"),
    "outputs": ("x", "u", "p", "fixed", "k"),
}
"""What the recorded functions read and write, as equations.c.in calls it."""
EVERY_MODULE = {*vars(nn.Module()), "specs"}
"""Attributes that tell no structure."""

_STRUCTURES: WeakKeyDictionary[System, tuple[object, ...]] = WeakKeyDictionary()
_EQUATIONS: dict[tuple[object, ...], tuple[int, Tensor]] = {}
"""By structure, smoothing, channels and free parameters."""


# --- calls --------------------------------------------------------------------------------------------------------


def supports_compiled(system: System, engine: Engine, x: Tensor) -> bool:
    """Whether compiled steps are asked for and possible here: no network, no GPU."""
    here = x.device.type == "cpu" and x.dtype == torch.float64
    return engine.compiled and not system.networks and here


def compiled_for(system: System, engine: Engine) -> Engine:
    """The engine, compiled where a C compiler works here: for a robot, and for a drive whose components are ours.

    A drive's own components may use operations that have no C expression; an ODE solver, which is an engine of another
    type, has no compiled steps.
    """
    compilable = type(engine) is Engine and (system.tree is not None or _is_ours(system))
    return replace(engine, compiled=True) if compilable and compiler_works() else engine


@functools.cache
def compiler_works() -> bool:
    """Whether there is a C compiler that makes a library which may be loaded: one without its headers makes none."""
    try:
        return compiler() is not None and _engine() is not None
    except InputError:
        return False


def shoot(
    system: System,
    engine: Engine,
    x: Tensor,
    u: Mapping[str, Tensor],
    dt: Tensor,
    theta: Tensor,
    length: int,
) -> Tensor:
    """Nodes ``(R, T, n_x)`` with those inside each chunk of ``length`` replaced by a rollout of its first.

    Arguments as of :func:`hybrid_id.simulation.lifted.shoot`.

    Raises:
        InputError: there is no C compiler, or the model uses an operation that has no C expression.
    """
    u, path = _arrived(system, u, theta), torch.empty_like(x, memory_format=torch.contiguous_format)
    path[:, ::length] = x[:, ::length]
    equations, constants = _equations(system, engine, tuple(u))
    channels, step = [channel.contiguous() for channel in u.values()], (dt / engine.substeps).contiguous()
    # addresses and rows of the channels: those of few rows stay where they are, however many lanes they drive
    places, rows = (torch.tensor(list(map(f, channels)), dtype=torch.int64) for f in (Tensor.data_ptr, len))
    sizes = len(x), len(step), x.shape[1], length, engine.substeps
    call(_engine(), "shoot", equations, path, places, rows, step, _values(theta, constants), *sizes)
    return path


def linearise(
    system: System,
    engine: Engine,
    x: Tensor,
    u: Mapping[str, Tensor],
    dt: Tensor,
    theta: Tensor,
    free: Sequence[int],
) -> tuple[Tensor, Tensor]:
    """The sample after every node ``(R, T, n_x)``, and its Jacobian by states and parameters ``(.., n_x, n_x + n_f)``.

    Arguments as of :func:`hybrid_id.simulation.lifted.linearise`. A dead time acts through the channels that it
    delays: the sample is differentiated by these, and they by the dead time.

    Raises:
        InputError: there is no C compiler, or the model uses an operation that has no C expression.
    """
    slopes, u = _delay_slopes(system, u, theta, free), _arrived(system, u, theta)
    names = tuple(u)
    late = tuple(names.index(name) for name, _, _ in slopes)
    after = torch.empty_like(x, memory_format=torch.contiguous_format)
    columns = x.shape[-1] + len(free)
    jacobian = x.new_empty(*x.shape, columns + len(late))
    equations, constants = _equations(system, engine, names, tuple(free), late)
    held = torch.stack(list(u.values())) if u else dt.new_empty(0)
    point = x.contiguous(), held, (dt / engine.substeps).contiguous(), _values(theta, constants)
    call(_engine(), "linearise", equations, after, jacobian, *point, *dt.shape, engine.substeps)
    for k, (_, column, slope) in enumerate(slopes):
        jacobian[..., x.shape[-1] + column] += jacobian[..., columns + k] * slope[..., None]
    return after, jacobian[..., :columns]


def _equations(
    system: System,
    engine: Engine,
    channels: tuple[str, ...],
    free: tuple[int, ...] | None = None,
    late: tuple[int, ...] = (),
    outputs: tuple[str, ...] = (),
) -> tuple[int, Tensor]:
    """Address of a system's equations, and the constants that follow its parameters."""
    if system not in _STRUCTURES:
        _STRUCTURES[system] = structure(system)
    width = engine.width if engine.friction == "smooth" else None
    arguments = (system, channels, free, width, late, outputs)
    key = (_STRUCTURES[system], *arguments[1:])
    if key not in _EQUATIONS:
        about, write = repr(key) if _is_ours(system) else "", functools.partial(source, *arguments)
        code, constants = _made(about, "equations", write)
        _EQUATIONS[key] = address(code, "equations"), torch.tensor(constants, dtype=torch.float64)
    return _EQUATIONS[key]


@functools.cache
def _engine() -> CDLL:
    """What steps any equations."""
    return _made("engine", "shoot", lambda: (_sources("lanes.h", "engine.c"), []))[0]


def _made(about: str, name: str, write: Callable[[], tuple[str, list[float]]]) -> tuple[CDLL, list[float]]:
    """A library and its constants, of which a name is looked up: its source is written where no earlier run has."""
    parts = (_program(), about, *FLAGS)
    found = noted(parts, (name,)) if about else None
    if found is None:
        text, constants = write()
        found = library(text, (name,), FLAGS), constants
        if about:
            note(parts, text, constants, FLAGS)
    return found


def forget() -> None:
    """Let every library be looked for again."""
    _EQUATIONS.clear()
    for once in (_engine, compiler_works):
        once.cache_clear()


def _sources(*names: str) -> str:
    folder = resources.files("hybrid_id.simulation")
    return "\n".join(folder.joinpath(name).read_text(encoding="utf-8") for name in names)


def _is_ours(system: System) -> bool:
    """Whether all components are of this package: how others move may change with no change of :func:`_program`."""
    package = __name__.partition(".")[0]
    return all(type(part).__module__.partition(".")[0] == package for part in system.components.values())


@functools.cache
def _program() -> str:
    """Digest of all that decides the code of a structure of ours: this package's equations, and PyTorch's version."""
    digest, package = hashlib.sha256(torch.__version__.encode()), Path(__file__).parents[1]
    folders = ("components", "robots", "simulation", "systems")
    files = [file for folder in folders for file in (package / folder).rglob("*.*")]
    for file in sorted([*files, package / "parameters.py"]):
        if file.suffix != ".pyc":
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _values(theta: Tensor, constants: Tensor) -> Tensor:
    """Parameters and constants of each row, ``(R, n)``."""
    return torch.cat([theta.T, constants.expand(theta.shape[1], -1)], 1).contiguous()


def _arrived(system: System, u: Mapping[str, Tensor], theta: Tensor) -> Mapping[str, Tensor]:
    """Channels ``(R, T)`` that the equations read as they arrive at the motors, without the past that a delay needs."""
    u = system.arm.read(u)
    if not any(joint.drive.delay for joint in system.joints):
        return u
    arrived = system.hold(u, system.views(list(theta[:, :, None])))
    return {name: channel for name, channel in arrived.items() if "@" not in name}


def _delay_slopes(
    system: System, u: Mapping[str, Tensor], theta: Tensor, free: Sequence[int]
) -> list[tuple[str, int, Tensor]]:
    """Channels that a free dead time delays, its number among the free parameters, their slope by it ``(R, T)``."""
    found = []
    for joint in system.joints:
        drive = joint.drive
        if drive.delay is None:
            continue
        row = next(i for i, info in enumerate(system.table) if info.component == drive.delay[0])
        if row not in free:
            continue
        values = list(theta[:, :, None])
        values[row] = values[row].expand_as(u[f"step{joint.number}"]).contiguous().requires_grad_()
        with torch.enable_grad():
            arrived = drive.hold(u, system.views(values))
            for name in (f"{c}{joint.number}" for c in drive.input[1].channels):
                (slope,) = torch.autograd.grad(arrived[name].sum(), values[row], retain_graph=True)
                found.append((name, list(free).index(row), slope))
    return found


# --- the code of a structure --------------------------------------------------------------------------------------


def structure(system: System) -> tuple[object, ...]:
    """What the code depends on: gear ratios, tree, and of each component its class and all but its values."""
    parts, arrays = [], (Tensor, np.ndarray)
    for key, part in system.components.items():
        declared = cast(Component, part).declared
        kept = {name: value for name, value in vars(part).items() if name not in EVERY_MODULE}
        kept |= {name: value for name, value in part.state_dict().items() if name not in declared}
        kept = {name: value.tolist() if isinstance(value, arrays) else value for name, value in kept.items()}
        parts.append((key, type(part), repr(kept)))
    points = () if system.tree is None else tuple(system.tree.points.items())
    return system.gear_ratio, system.tree, points, system.seats, tuple(parts)


def source(
    system: System,
    channels: Sequence[str],
    free: Sequence[int] | None = None,
    width: float | None = None,
    late: Sequence[int] = (),
    outputs: Sequence[str] = (),
) -> tuple[str, list[float]]:
    """C code of a structure's equations under named channels, and the machine's constants, which follow its parameters.

    Args:
        system: equations of motion.
        channels: names of the channels.
        free: indices of the parameters by which, beside the states, tangents are taken; None for rollouts.
        width: smoothing speed [rad/s] of friction; None for dry friction.
        late: indices of channels by which tangents are taken too.
        outputs: names of the outputs that it tells.

    Raises:
        InputError: the model uses an operation that has no C expression.
    """
    n_x, speeds = len(system.state_names), len(system.speed_rows)
    dry = [k for k, is_dry in enumerate(system.dry) if is_dry and width is None]
    n, kept = len(dry), system.memory_rows
    coupled: list[int] = []

    def full(rows: Sequence[Tensor]) -> Directions:
        """A direction for each speed from one for each dry speed."""
        return [rows[dry.index(k)] if k in dry else None for k in range(speeds)]

    def rates(x: Sequence[Tensor], u: Channels, p: Views, d: Sequence[Tensor]) -> list[Tensor]:
        return system.rates(x, u, p, full(d)) if width is None else system.rates(x, u, p, width=width)

    def margins(
        x: Sequence[Tensor], u: Channels, p: Views, s: Sequence[Tensor], d: Sequence[Tensor]
    ) -> list[Tensor]:
        nonlocal coupled
        rest, along = system.rest(x, u, p, full(s)), full(d)
        coupled = [dry.index(k) for k in rest.forward.coupled if k in dry]
        now, found = rest.along(along), rest.breakaway_margins(along)
        accelerations = now.accelerations(along, held=True)
        against = [-d[i] * accelerations[k] * now.speeds[k].inertia for i, k in enumerate(dry)]
        return [found[k][0] for k in dry] + [found[k][1] for k in dry] + against

    def internal(x: Sequence[Tensor], u: Channels, p: Views, h: Tensor) -> list[Tensor]:
        after = update_internal_states(system, list(x), u, p, h)
        return [after[row] for row in kept]

    def measured(x: Sequence[Tensor], u: Channels, p: Views) -> list[Tensor]:
        return system.outputs(outputs, x, u, p, system.signs(x))

    code = Statements(system, channels, free, late)
    sides = [f"{name}[{i}]" for name in ("side", "margin", "against") for i in range(n)]
    bodies = {"rates": code.function(rates, {"d": n}, [f"k[{i}]" for i in range(n_x)], tangents=range(n_x))}
    bodies["margins"] = code.function(margins, {"s": n, "d": n}, sides) if n else Body([[]], 0, {})
    bodies["outputs"] = code.function(measured, {}, [f"k[{i}]" for i in range(len(outputs))])
    texts: dict[str, str] = {}
    for name, body in bodies.items():
        texts[f"{name}_parts"], texts[name] = lanes(name, ARRAYS[name], body)
    texts["rates_tangents"] = lines(code.tangents(bodies["rates"]))
    body = code.function(internal, {"h": 0}, [f"x[{i}]" for i in kept], tangents=kept, whole=True)
    after = [f"TANGENT_VECTORS AT(x_t[{i}][c]) = AT(k_t[{i}][c]);" for i in kept] if code.columns else []
    texts["internal"] = in_lanes(lines(body.parts[0]))
    texts["internal_tangents"] = lines([*code.tangents(body), *after])
    written = Template(_sources("lanes.h", "equations.c.in")).substitute(
        texts, functions=DECLARED, vectors=WRAPPED, prepare="\n".join(code.prepare),
        hold=in_lanes("\n".join(code.hold)), n_x=n_x, channels=len(channels),
        n_p=len(system.table) + len(code.constants), n_fixed=code.n_fixed, n_columns=code.columns, n_dry=n,
        n_speeds=speeds, n_coupled=len(coupled), pivots=min(3 ** len(coupled), PIVOTS) if coupled else 0,
        internal_states=int(bool(kept)), coupled=", ".join(str(int(i in coupled)) for i in range(n)) or "0",
        rows=", ".join(str(system.speed_rows[k]) for k in dry) or "0",
    )  # fmt: skip
    return written, [float(text) for text in code.constants]


class Statements:
    """C statements of functions of a system's rows.

    What depends on parameters alone is found once a row, what depends on held inputs as well once a sample.

    Args:
        system: its equations are recorded.
        channels: names of the channels.
        free: indices of the parameters by which tangents are taken; None for no tangents.
        late: indices of the channels by which they are taken too.

    Attributes:
        columns: number of tangents.
        prepare: statements that fill ``fixed`` with the values that depend on parameters alone.
        hold: those that add the values that depend on parameters and held inputs.
        n_fixed: how many values these are.
        constants: numbers of the machine, as they are written, and the rows that hold them.
    """

    def __init__(
        self, system: System, channels: Sequence[str], free: Sequence[int] | None, late: Sequence[int] = ()
    ) -> None:
        self.system, self.channels = system, channels
        self.wanted = [f"x{i}" for i in range(len(system.state_names))]
        self.wanted += [*(f"p{i}" for i in free or ()), *(f"u{i}" for i in late)]
        self.columns = 0 if free is None else len(self.wanted)
        self.prepare: list[str] = []
        self.hold: list[str] = []
        self.n_fixed = 0
        self.constants: dict[str, int] = {}

    @torch.no_grad()
    def function(
        self,
        function: Callable[..., list[Tensor]],
        extra: Mapping[str, int],
        targets: Sequence[str],
        tangents: Sequence[int] = (),
        *,
        whole: bool = False,
    ) -> Body:
        """Body of a function of x, u, p and more.

        Args:
            function: takes rows of x, channels, views and the rows of ``extra``, and returns rows.
            extra: names of its further arrays and their sizes; 0 for a number.
            targets: what is assigned its results.
            tangents: rows of ``k_t`` that hold the results' tangents.
            whole: whether it stays one part, as one that writes what it reads has to.
        """
        flat, statements, results = self._recorded(function, extra, bool(tangents) and self.columns > 0)
        load = [f"const double {n} = {key}[{n[1:]}];" for key, n in flat if n != "h"]
        pushes = [f" u{i} " for i, name in enumerate(self.channels) if name.startswith(PUSH)]  # never held
        given = {key: [line for line in load if f" {key}" in line[:15]] for key in "pu"}
        given["u"] = [line for line in given["u"] if not any(push in line for push in pushes)]
        fixed, moving = self._split(statements, results, given["p"], self.prepare)
        held, moving = self._split(moving, results, [*given["p"], *given["u"], *fixed], self.hold)
        stores: dict[str, list[str]] = {}
        for target, result in zip(targets, results, strict=False):
            stores.setdefault(result, []).append(f"{target} = {result};")
        gradients = {}
        for k, row in enumerate(tangents if self.columns else ()):
            first = len(targets) + k * self.columns
            found = results[first : first + self.columns]
            gradients[row] = [f"g[{row}][{c}]" if NAMES.search(g) else g for c, g in enumerate(found)]
            for place, g in zip(gradients[row], found, strict=True):
                if place != g:
                    stores.setdefault(g, []).append(f"{place} = {g};")
        length = PART if len(moving) > WHOLE and not whole else len(moving) + 1
        return Body(*in_parts([*load, *fixed, *held], moving, stores, length), gradients)

    def _recorded(
        self, function: Callable[..., list[Tensor]], extra: Mapping[str, int], differentiate: bool
    ) -> tuple[list[tuple[str, str]], list[str], list[str]]:
        """Arrays and names of a function's rows, its statements, and names of its results, gradients behind them."""
        sizes = {
            "x": len(self.system.state_names),
            "u": len(self.channels),
            "p": len(self.system.table),
            **extra,
        }
        names = {key: [f"{key}{i}" for i in range(n)] if n else [key] for key, n in sizes.items()}
        names |= {key: [] for key in ("u", "d", "s") if sizes.get(key) == 0}
        values = {"x": 0.1, "u": 1.0, "h": 1e-3, "d": 1.0, "s": 1.0}
        flat = [(key, name) for key, own in names.items() for name in own]
        theta = iter(self.system.theta().tolist())
        examples = [next(theta) if key == "p" else values[key] for key, _ in flat]

        def run(*rows: Tensor) -> list[Tensor]:
            left = iter(rows)  # in the order of their names
            given = {key: [next(left) for _ in own] for key, own in names.items()}
            u = dict(zip(self.channels, given["u"], strict=True))
            more = [given[key][0] if key == "h" else given[key] for key in extra]
            return function(given["x"], u, self.system.views(given["p"]), *more)

        def differentiated(*rows: Tensor) -> list[Tensor]:
            leaves = {
                name: row.detach().requires_grad_(name in self.wanted)
                for (_, name), row in zip(flat, rows, strict=True)
            }
            with torch.enable_grad():
                found = run(*leaves.values())
                totals = [one.sum() for one in found]
            results = [one.detach() for one in found]
            for total, one in zip(totals, found, strict=True):
                inputs = [leaves[name] for name in self.wanted]
                grads: Sequence[Tensor | None] = [None] * len(inputs)
                if total.requires_grad:
                    grads = torch.autograd.grad(total, inputs, retain_graph=True, allow_unused=True)
                results += [torch.zeros_like(one) if g is None else g for g in grads]
            return results

        whole = differentiated if differentiate else run
        statements, results = record(whole, [name for _, name in flat], examples)
        statements, results = (
            [NUMBER.sub(self._named, line) for line in lines] for lines in (statements, results)
        )
        used = {name for line in (*statements, *results) for name in NAMES.findall(line)}
        flat += [("p", name) for name in (f"p{row}" for row in self.constants.values()) if name in used]
        return flat, statements, results

    def _named(self, number: re.Match[str]) -> str:
        """The row that holds a number, unless it belongs to the formula."""
        text = number.group()
        if float(text) in PLAIN:
            return text
        return f"p{self.constants.setdefault(text, len(self.system.table) + len(self.constants))}"

    def _split(
        self, statements: Sequence[str], results: Sequence[str], load: Sequence[str], earlier: list[str]
    ) -> tuple[list[str], list[str]]:
        """Statements that read what is found earlier, and those that depend on more than that.

        Args:
            statements: to be divided.
            results: names of what their function returns.
            load: statements that read what is known early.
            earlier: gets the statements that depend on nothing else.
        """
        given = {assigned(line) for line in load}
        known, moving, needed = {}, [], set(results)
        for line in statements:
            used = NAMES.findall(line.split(" = ", 1)[1])
            if all(name in known or name in given for name in used):
                known[assigned(line)] = line
            else:
                moving.append(line)
                needed.update(used)
        places = {
            name: f"fixed[{self.n_fixed + i}]" for i, name in enumerate(n for n in known if n in needed)
        }
        self.n_fixed += len(places)
        kinds = {name: known[name].split(" = ")[0] for name in places}
        body = [
            *load, *known.values(), *(stored(kinds[name], name, place) for name, place in places.items())
        ]  # fmt: skip
        earlier += ["    {", *(f"        {line}" for line in body), "    }"] if places else []
        return [f"{kinds[name]} = {place};" for name, place in places.items()], moving

    def tangents(self, body: Body) -> list[str]:
        """Statements that fill ``k_t`` by the chain rule from gradients by states and free parameters."""
        n_x = len(self.system.state_names)
        found = []
        for row, places in body.gradients.items():
            gradient = [in_lanes(place) for place in places]
            terms = [f"{g} * AT(x_t[{j}][c])" for j, g in enumerate(gradient[:n_x]) if g != "0.0"]
            own = [(c, g) for c, g in enumerate(gradient) if c >= n_x and g != "0.0"]
            found += [
                f"TANGENT_VECTORS AT(k_t[{row}][c]) = {' + '.join(terms) or 'ALL(0.0)'};",
                *(f"VECTORS AT(k_t[{row}][{c}]) += {g};" for c, g in own),
            ]
        return found
