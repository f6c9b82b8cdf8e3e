"""Small changes of a module's syntax tree, each of which some test should notice."""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass

_OPERATORS: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Pow: ast.Mult,
    ast.Mod: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
_NAMES = {"minimum": "maximum", "maximum": "minimum", "min": "max", "max": "min", "zeros": "ones", "cumsum": "copy",
          "any": "all", "all": "any", "argmin": "argmax", "argmax": "argmin", "left": "right"}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """A changed module: ``key`` says where and what, and stays the same while the module does."""

    key: str
    tree: ast.Module


def mutants(source: str) -> Iterator[Mutant]:
    """Every mutant of a module, one change each; docstrings, annotations, imports and errors are left alone."""
    module = ast.parse(source)
    seen: dict[str, int] = {}
    for place, (node, function) in enumerate(_places(module)):
        for what, change in _changes(node):
            key = f"{function}: {ast.unparse(node)[:70].splitlines()[0]} -> {what}"
            seen[key] = seen.get(key, 0) + 1
            if seen[key] > 1:
                key += f" ({seen[key]})"
            tree = copy.deepcopy(module)
            target = next(found for k, (found, _) in enumerate(_places(tree)) if k == place)
            change(target)
            yield Mutant(key, ast.fix_missing_locations(tree))


def _places(module: ast.Module) -> Iterator[tuple[ast.AST, str]]:
    """The nodes that may be changed, and the function that each is in."""

    def walk(node: ast.AST, function: str) -> Iterator[tuple[ast.AST, str]]:
        if isinstance(node, (ast.Import, ast.ImportFrom, ast.Raise, ast.JoinedStr)):
            return
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            return
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            function = node.name
            body: list[ast.AST] = [*node.body]
            if isinstance(node, ast.FunctionDef):
                body = [*node.args.defaults, *(d for d in node.args.kw_defaults if d is not None), *body]
            for child in body:
                yield from walk(child, function)
            return
        yield node, function
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "ctx"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from walk(child, function)

    for node in module.body:
        yield from walk(node, "module")


Change = Callable[[ast.AST], None]


def _changes(node: ast.AST) -> Iterator[tuple[str, Change]]:
    if isinstance(node, (ast.BinOp, ast.AugAssign, ast.BoolOp)) and type(node.op) in _OPERATORS:
        new = _OPERATORS[type(node.op)]
        yield new.__name__, lambda n: setattr(n, "op", new())
    if isinstance(node, ast.Compare):
        for k, op in enumerate(node.ops):
            if type(op) in _OPERATORS:
                other = _OPERATORS[type(op)]
                yield other.__name__, lambda n, k=k, other=other: n.ops.__setitem__(k, other())  # type: ignore[misc]
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield f"{not node.value}", lambda n: setattr(n, "value", not n.value)  # type: ignore[attr-defined]
    elif isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        yield f"{node.value + 1}", lambda n: setattr(n, "value", n.value + 1)  # type: ignore[attr-defined]
        if node.value not in (0, 1):
            yield f"{node.value * 0.5:g}", lambda n: setattr(n, "value", type(n.value)(n.value * 0.5))  # type: ignore[attr-defined]
    elif isinstance(node, ast.Constant) and node.value in _NAMES:
        yield _NAMES[node.value], lambda n: setattr(n, "value", _NAMES[n.value])  # type: ignore[attr-defined]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.Not)):
        yield "without it", _unsigned
    if isinstance(node, ast.Attribute) and node.attr in _NAMES:
        yield _NAMES[node.attr], lambda n: setattr(n, "attr", _NAMES[n.attr])  # type: ignore[attr-defined]
    if isinstance(node, (ast.If, ast.IfExp, ast.While)):
        if not isinstance(node, ast.While):
            yield "always", lambda n: setattr(n, "test", ast.Constant(True))
        yield "never", lambda n: setattr(n, "test", ast.Constant(False))
    if isinstance(node, ast.AugAssign) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
        yield "nothing", _emptied
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Subscript):
        yield "nothing", _emptied


def _unsigned(node: ast.AST) -> None:
    """``-x`` as ``+x``, ``not x`` as ``not not x``."""
    assert isinstance(node, ast.UnaryOp)
    if isinstance(node.op, ast.USub):
        node.op = ast.UAdd()
    else:
        node.operand = ast.UnaryOp(ast.Not(), node.operand)


def _emptied(node: ast.AST) -> None:
    """The statement without effect: its value is still computed."""
    if isinstance(node, ast.Expr):
        node.value = ast.Constant(None)
    elif isinstance(node, (ast.Assign, ast.AugAssign)):
        name = ast.Name("_", ast.Store())
        value = node.value
        node.__class__ = ast.Assign  # type: ignore[assignment]
        node.targets, node.value = [name], value  # type: ignore[union-attr]
