"""The rules of the house, read off the syntax trees: who may import whom, and what nobody may do.

A module imports from lower floors, from its own package, and from what `NEIGHBOURS` lists. A module that
has no floor fails too, so that a new package has to be given its place here.
"""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import hybrid_id

PACKAGE = Path(hybrid_id.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))

MAX_PUBLIC_NAMES = 40

FLOORS = {
    "errors": 0,
    "parameters": 0,
    "reading": 0,
    "records": 1,
    "components": 1,
    "robots": 1,
    "machines": 1,
    "systems": 2,
    "simulation": 3,
    "identification": 4,
    "statistics": 5,
    "study": 6,
    "diagnosis": 7,
    "export": 7,
    "reporting": 8,
    "paper": 8,
    "baselines": 8,
    "config": 9,
    "cli": 9,
    "__main__": 10,
}
# The only imports between two units of one floor.
NEIGHBOURS = {("parameters", "errors"), ("reading", "errors"), ("machines", "records"), ("cli", "config")}
NEIGHBOURS |= {("paper", "reporting")}
# Units and modules that must stay independent of more than their floor says: all that they may import of hybrid_id.
ONLY = {
    "machines": {"machines", "errors", "reading", "records"},
    "paper.twin": {"machines", "errors", "records"},
}
NEVER = {("diagnosis", "machines"), ("baselines", "machines")}
# Reporting renders and the command line calls: the results of study/ and above hold what was simulated and tested.
NEVER |= {("reporting", unit) for unit in ("simulation", "identification")}
NEVER |= {("cli", unit) for unit in ("simulation", "identification", "statistics")}
WITHOUT_TORCH = ("errors", "reading", "records", "machines", "statistics")
PICKLES = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal"}
COMMAND_LINE = {"argparse", "click", "typer", "optparse", "getopt"}


def module_name(path: Path) -> str:
    """`.../hybrid_id/records/record.py` -> `records.record`; a package's own file -> its name."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree: ast.AST, module: str) -> Iterator[str]:
    """Yield every imported module by its absolute name, those inside functions too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level:
            yield f"relative import in {module}"
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            # `from hybrid_id import records` names a unit; `from numpy import pi` names no module.
            yield from (f"{base}.{alias.name}" for alias in node.names) if base == "hybrid_id" else (base,)


def import_faults(module: str, imported: str) -> Iterator[str]:
    """Yield what is wrong with `module` importing `imported`."""
    unit, top = module.split(".")[0], imported.split(".")[0]
    if imported.startswith("relative import"):
        yield "imports by relative name; write hybrid_id.… so that the floor shows"
    if top in PICKLES:
        yield f"imports {top}: files of users may never run code"
    if top == "torchdiffeq" and module != "simulation.solvers":
        yield "imports torchdiffeq, which only simulation/solvers.py may"
    if top == "torch" and unit in WITHOUT_TORCH:
        yield "imports torch, which this package does without"
    if top in COMMAND_LINE and unit != "cli":
        yield f"imports {top}: only cli/ reads the command line"
    if top != "hybrid_id" or imported == "hybrid_id.__version__":
        return
    other = imported.split(".")[1] if "." in imported else ""
    if other == unit:
        return
    if other not in FLOORS:
        yield f"imports {imported}, which has no floor: import the module that defines the name"
    elif (unit, other) in NEVER:
        yield f"imports {other}, which it may never know"
    elif other not in (known := ONLY.get(module, ONLY.get(unit, {other}))):
        yield f"imports {other}, but may know only {', '.join(sorted(known))}"
    elif FLOORS[other] >= FLOORS[unit] and (unit, other) not in NEIGHBOURS:
        yield f"(floor {FLOORS[unit]}) imports {other} (floor {FLOORS[other]}): imports go down"


def call_faults(tree: ast.AST, module: str) -> Iterator[str]:
    """Yield calls and attributes that could run a user's file as code, or that read argv outside cli/."""
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Attribute)
            and ast.unparse(node) == "sys.argv"
            and not module.startswith("cli")
        ):
            yield "reads sys.argv, which only cli/ may"
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        keywords = {k.arg: ast.unparse(k.value) for k in node.keywords}
        if called in {"eval", "exec", "__import__"} or called.endswith((".read_pickle", ".to_pickle")):
            yield f"calls {called}"
        if called in {"yaml.load", "yaml.unsafe_load", "yaml.full_load"}:
            yield f"calls {called}; use yaml.safe_load"
        if called == "torch.load" and keywords.get("weights_only") != "True":
            yield "calls torch.load without weights_only=True"
        if keywords.get("allow_pickle", "False") != "False":
            yield f"calls {called} with allow_pickle"


def faults(module: str, source: str) -> list[str]:
    """All that breaks the rules of the house in one module's source text."""
    if not module:  # hybrid_id/__init__.py: the facade names every public class, and imports it lazily
        return []
    if module.split(".")[0] not in FLOORS:
        return ["has no floor: give its package one in FLOORS"]
    tree = ast.parse(source)
    found = [fault for imported in imports(tree, module) for fault in import_faults(module, imported)]
    found += call_faults(tree, module)
    return found


@pytest.mark.parametrize("path", MODULES, ids=lambda path: module_name(path) or "hybrid_id")
def test_module_keeps_the_rules(path: Path) -> None:
    module = module_name(path)
    assert not [f"hybrid_id.{module} {fault}" for fault in faults(module, path.read_text(encoding="utf-8"))]


@pytest.mark.parametrize(
    ("module", "source", "expected"),
    [
        ("records.record", "from hybrid_id.components.base import Component", "imports go down"),
        ("components.base", "def f():\n    from hybrid_id.systems import chain", "imports go down"),
        ("systems.chain", "from hybrid_id import simulation", "imports go down"),
        ("identification.result", "import hybrid_id.statistics.fit", "imports go down"),
        ("simulation.rollout", "from hybrid_id import load_model", "no floor"),
        ("systems.chain", "from . import arms", "relative name"),
        ("paper.twin", "from hybrid_id.parameters import Parameter", "may know only"),
        ("machines.case", "from hybrid_id.simulation.rollout import simulate", "may know only"),
        ("machines.physics.friction", "from hybrid_id.components import Coulomb", "may know only"),
        ("diagnosis.measure", "from hybrid_id.machines import seal", "may never know"),
        ("reporting.study", "from hybrid_id.simulation.rollout import simulate", "may never know"),
        ("cli.identify", "def f():\n    from hybrid_id.identification.fit import fit", "may never know"),
        ("simulation.rollout", "from torchdiffeq import odeint", "torchdiffeq"),
        ("statistics.fit", "import torch.linalg", "does without"),
        ("records.dataset", "import pickle", "may never run code"),
        ("records.dataset", "x = yaml.load(text)", "safe_load"),
        ("identification.result", "x = torch.load(path)", "weights_only"),
        ("records.dataset", "x = np.load(path, allow_pickle=True)", "allow_pickle"),
        ("components.base", "x = eval('1')", "calls eval"),
        ("reporting.tables", "import sys\nprint(sys.argv[1])", "sys.argv"),
        ("config", "import typer", "only cli/"),
        ("helpers.misc", "", "has no floor"),
    ],
)
def test_offence_is_caught(module: str, source: str, expected: str) -> None:
    found = faults(module, source)
    assert len(found) == 1, found
    assert expected in found[0]


@pytest.mark.parametrize(
    ("module", "source"),
    [
        (
            "records.dataset",
            "from hybrid_id.records.record import Record\nfrom hybrid_id.errors import InputError",
        ),
        ("parameters", "from hybrid_id.errors import InputError"),
        ("paper.twin", "from hybrid_id.records.record import Record"),
        ("simulation.solvers", "import torch, torchdiffeq\nfrom hybrid_id.systems.chain import Chain"),
        ("cli.main", "import sys, typer\nfrom hybrid_id.config import Study\nprint(sys.argv)"),
        ("identification.result", "model.eval()\nx = torch.load(path, weights_only=True)"),
    ],
)
def test_permitted_source_passes(module: str, source: str) -> None:
    assert faults(module, source) == []


def circles(known: dict[str, str]) -> list[str]:
    """Modules that import themselves by way of others; imports inside functions count, those for types alone do not.

    Args:
        known: source text by module name.
    """

    def of(module: str) -> set[str]:
        tree = ast.parse(known[module])
        for node in ast.walk(tree):
            if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
                node.body = []
        names = set[str]()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                base = node.module or ""
                # `from package import module` imports the module, `from package import name` the package's own file
                full = (f"{base}.{alias.name}" for alias in node.names)
                names |= {name if name in known else base for name in full}
        return names & known.keys() - {module}

    direct = {module: of(module) for module in known}

    def reached(module: str) -> set[str]:
        seen, todo = set[str](), [module]
        while todo:
            new = direct[todo.pop()] - seen
            seen |= new
            todo += new
        return seen

    return [module for module in known if module in reached(module)]


def test_no_module_imports_itself_by_way_of_others() -> None:
    names = {f"hybrid_id.{module_name(p)}".rstrip("."): p.read_text(encoding="utf-8") for p in MODULES}
    del names["hybrid_id"]  # the facade
    assert circles(names) == []


def test_a_circle_of_imports_would_be_seen() -> None:
    one, other = "def f():\n    from p.b import g", "from p import a"
    assert circles({"p.a": one, "p.b": other, "p.c": "import p.a"}) == ["p.a", "p.b"]
    assert circles({"p.a": "if TYPE_CHECKING:\n    from p.b import g", "p.b": other}) == []


def loads_torch(*modules: str) -> bool:
    """Whether importing these modules in a fresh interpreter loads torch, directly or not."""
    code = f"import sys, {', '.join(modules)}; print('torch' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return run.stdout.strip() == "True"


def test_import_of_the_package_does_not_load_torch() -> None:
    assert not loads_torch("hybrid_id")


def test_modules_without_torch_do_not_load_it_through_others() -> None:
    names = [module_name(path) for path in MODULES]
    chosen = [name for name in names if name.split(".")[0] in WITHOUT_TORCH]
    assert not loads_torch(*(f"hybrid_id.{name}" for name in chosen))


@pytest.mark.skipif(not (PACKAGE / "cli").is_dir(), reason="there is no command line yet")
def test_command_line_starts_without_torch() -> None:
    assert not loads_torch("hybrid_id.cli")


def test_table_of_the_records_needs_no_torch() -> None:
    assert not loads_torch("hybrid_id.cli.check", "hybrid_id.records.quality", "hybrid_id.reporting.tables")


def test_torch_would_be_seen() -> None:
    assert loads_torch("torch")


def test_public_names_are_few_and_there() -> None:
    public = [name for name in dir(hybrid_id) if not name.startswith("_")]
    assert len(hybrid_id._HOME) <= MAX_PUBLIC_NAMES
    for name in hybrid_id._HOME:
        assert name in public
        assert getattr(hybrid_id, name).__doc__, f"{name} is public and has no docstring"
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = hybrid_id.nonsense


def test_type_checkers_see_the_same_public_names() -> None:
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == hybrid_id._HOME
