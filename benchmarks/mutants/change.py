"""The deliberate faults of a module: an operator, a comparison, a number, a condition, min for max, a statement left out."""

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
SWAPS: dict[type, tuple[type, ...]] = {
    ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,), ast.Pow: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,), ast.Mod: (ast.Mult,), ast.MatMult: (ast.Mult,),
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,), ast.And: (ast.Or,), ast.Or: (ast.And,), ast.BitAnd: (ast.BitOr,), ast.BitOr: (ast.BitAnd,),
}  # fmt: skip
NAMES = {
    "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any", "zeros": "ones",
    "floor": "ceil", "sin": "cos", "argmin": "argmax", "argmax": "argmin", "cumsum": "cumprod", "sqrt": "abs",
}  # fmt: skip
UNTOUCHED = (ast.Raise, ast.JoinedStr, ast.Import, ast.ImportFrom)
FIELDS_UNTOUCHED = ("annotation", "returns", "decorator_list", "bases", "type_comment")
SAY_LITTLE = (ast.Constant, ast.Name, ast.Attribute, ast.UnaryOp, ast.keyword, ast.Tuple, ast.Slice)


@dataclass(frozen=True)
class Mutant:
    """One change: the function, in lpvobs, what it says before and after, and where in the tree; `change` -1 changes nothing."""

    module: str
    function: str
    before: str
    after: str
    node: int
    change: int

    @property
    def place(self) -> str:
        """Module and function, within the package."""
        return f"{self.module.removeprefix('lpvobs.')}.{self.function}".rstrip(".")

    @property
    def room(self) -> str:
        return self.module.split(".")[1]

    def tree(self) -> ast.Module:
        """Return the whole module with the change in it."""
        tree = ast.parse(source(self.module).read_text(encoding="utf-8"))
        if self.change < 0:
            return tree
        node = _places(tree)[self.node].node
        field, value = list(changes(node))[self.change]
        return ast.fix_missing_locations(_changed(tree, node, field, value))


@dataclass(frozen=True)
class Place:
    """A node that may be changed, the function it stands in, and the smallest expression around it that says what it is."""

    node: ast.AST
    function: str
    around: ast.AST


def source(module: str) -> Path:
    """Return the file of a module."""
    return (ROOT / Path(*module.split("."))).with_suffix(".py")


def mutants(module: str) -> Iterator[Mutant]:
    """Yield every mutant of a module."""
    for number, place in enumerate(_places(ast.parse(source(module).read_text(encoding="utf-8")))):
        for which, (field, value) in enumerate(changes(place.node)):
            after = _changed(place.around, place.node, field, value)
            yield Mutant(module, place.function, _short(place.around), _short(after), number, which)


def changes(node: ast.AST) -> Iterator[tuple[str, Any]]:  # noqa: PLR0912 one line per kind
    """Yield the changes that a node admits: a field's name and its new value; "" replaces the node itself."""
    if isinstance(node, ast.BinOp | ast.AugAssign | ast.BoolOp):
        for other in SWAPS.get(type(node.op), ()):
            yield "op", other()
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        for other in SWAPS.get(type(node.ops[0]), ()):
            yield "ops", [other()]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        yield "", node.operand
    if isinstance(node, ast.If | ast.IfExp | ast.While):
        yield "test", ast.UnaryOp(ast.Not(), node.test)
    if isinstance(node, ast.Constant):
        if isinstance(node.value, bool):
            yield "value", not node.value
        elif isinstance(node.value, int):
            yield "value", node.value + 1
        elif isinstance(node.value, float):
            yield "value", 2.0 * node.value if node.value else 1.0
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in NAMES:
        yield "id", NAMES[node.id]
    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load) and node.attr in NAMES:
        yield "attr", NAMES[node.attr]
    if isinstance(node, ast.AugAssign | ast.Continue) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    ):
        yield "", ast.Pass()


def _places(tree: ast.Module) -> list[Place]:
    """Return what may be changed: code that runs, not annotations, messages, documentation, or whether zip counts."""
    found: list[Place] = []

    def visit(node: ast.AST, function: str, above: ast.AST) -> None:
        if isinstance(node, UNTOUCHED) or (isinstance(node, ast.keyword) and node.arg == "strict"):
            return
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        around = above if isinstance(node, SAY_LITTLE) else node
        found.append(Place(node, function, around))
        inside = f"{function}.{node.name}".lstrip(".") if isinstance(node, ast.FunctionDef | ast.ClassDef) else function
        for name, value in ast.iter_fields(node):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST) and name not in FIELDS_UNTOUCHED:
                    visit(child, inside, around)

    for statement in tree.body:
        visit(statement, "", statement)
    return found


class _Replace(ast.NodeTransformer):
    def __init__(self, old: ast.AST, new: ast.AST) -> None:
        self.old, self.new = old, new

    def visit(self, node: ast.AST) -> Any:
        return self.new if node is self.old else super().generic_visit(node)


def _changed(root: Any, node: Any, field: str, value: Any) -> Any:
    """Return a copy of a tree with one of its nodes changed."""
    node.wanted = True
    whole = copy.deepcopy(root)
    del node.wanted
    inner = next(item for item in ast.walk(whole) if hasattr(item, "wanted"))
    if not field:
        return _Replace(inner, ast.copy_location(value, node)).visit(whole)
    setattr(inner, field, value)
    return whole


def _short(node: ast.AST) -> str:
    """Return the first line of a node's text."""
    return ast.unparse(ast.fix_missing_locations(node)).strip().split("\n")[0]
