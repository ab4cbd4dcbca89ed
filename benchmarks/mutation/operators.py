"""Small faults that are made in a module's syntax tree, one at a time.

Numbers, comparisons, operators and calls are changed, statements, `with` and `except` left out.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass

_COMPARED: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_REACHED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
}
_PAIRS = (
    *(("maximum", "minimum"), ("max", "min"), ("argmax", "argmin"), ("all", "any")),
    *(("sum", "mean"), ("log", "log1p"), ("exp", "expm1"), ("ones", "zeros")),
    *(("flatnonzero", "nonzero"), ("logaddexp", "maximum"), ("std", "var"), ("median", "mean")),
)
_SWAPPED = {a: b for pair in _PAIRS[::-1] for a, b in (pair, pair[::-1])}
_DROPPED = frozenset({"abs", "sqrt", "clip", "exp", "log", "sorted", "isfinite", "expit", "diff"})
_BARE = frozenset({"copy", "ravel"})
_STRINGS = {"left": "right", "right": "left"}


@dataclass(frozen=True, eq=False)
class Mutant:
    """One fault.

    Attributes
    ----------
    number : int
        Among the module's.
    line, last : int
        Of the innermost statement, or its head, that it is in.
    column : int
        Of what is changed.
    function : str
        Dotted name of the function or class that it is in; "" outside.
    names : tuple of str
        What the statement binds, where it is executed on import; those of its class in a class.
    before, after : str
        What stands there, and what the fault makes of it.
    make : callable
        Put the fault into the tree that it was found in.
    """

    number: int
    line: int
    last: int
    column: int
    function: str
    names: tuple[str, ...]
    before: str
    after: str
    make: Callable[[], None]

    @property
    def change(self) -> str:
        """What changes, in one line."""
        return f"{' '.join(self.before.split())} → {' '.join(self.after.split())}"


def mutants(tree: ast.Module) -> list[Mutant]:
    """All faults of a module, in the order of its text; never of words that only people read."""
    found = []
    for node, parent, name, index, statement, home in _nodes(tree):
        line, last = _span(statement)
        for after in _changes(node, parent, name):

            def make(
                parent: ast.AST = parent,
                name: str = name,
                index: int | None = index,
                after: ast.AST | None = after,
            ) -> None:
                if index is None:
                    setattr(parent, name, after)
                else:
                    getattr(parent, name)[index] = after

            before, said = _said(node), _said(after)
            where = ".".join(n.name for n in home)
            names = _bound(statement, home)
            column = getattr(node, "col_offset", 0)
            found.append(Mutant(len(found), line, last, column, where, names, before, said, make))
    return found


def _said(node: ast.AST | None) -> str:
    """What stands there; of a statement that holds others its head."""
    if node is None or isinstance(node, ast.Pass):
        return "nothing"
    headed = (ast.With, ast.ExceptHandler, ast.If, ast.While)
    return ast.unparse(node).splitlines()[0] if isinstance(node, headed) else ast.unparse(node)


_Home = tuple[ast.FunctionDef | ast.ClassDef, ...]
_Found = tuple[ast.AST, ast.AST, str, int | None, ast.stmt, _Home]


def _nodes(tree: ast.Module) -> Iterator[_Found]:
    """Nodes that may be changed, with parent, field, place in it, statement and what it is in."""
    for i, statement in enumerate(tree.body):
        yield from _walk(statement, tree, "body", i, statement, ())


def _walk(
    node: ast.AST, parent: ast.AST, name: str, index: int | None, statement: ast.stmt, home: _Home
) -> Iterator[_Found]:
    if isinstance(node, ast.stmt):
        if _is_words(node):
            return
        statement = node
    yield node, parent, name, index, statement, home
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        home = (*home, node)
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "exc", "ctx", "bases"):
            continue
        if isinstance(value, list):
            for i, child in enumerate(value):
                if isinstance(child, ast.AST):
                    yield from _walk(child, node, field, i, statement, home)
        elif isinstance(value, ast.AST):
            yield from _walk(value, node, field, None, statement, home)


def _is_words(node: ast.stmt) -> bool:
    """Whether a statement is a docstring, an import or `__all__`, or only names a type."""
    if isinstance(node, (ast.Import, ast.ImportFrom)):
        return True
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Constant)
    if isinstance(node, ast.Assign):
        target = ast.unparse(node.targets[0])
        return target == "__all__" or ast.unparse(node.value).startswith("NDArray[")
    return isinstance(node, ast.AnnAssign) and node.value is None


def _span(statement: ast.stmt) -> tuple[int, int]:
    """First and last line of a statement, or of its head if it holds others."""
    if isinstance(statement, ast.FunctionDef):  # defaults: all that calls it
        return statement.lineno, statement.end_lineno or statement.lineno
    body = getattr(statement, "body", None)
    last = body[0].lineno - 1 if body else statement.end_lineno
    return statement.lineno, max(statement.lineno, last or statement.lineno)


def _bound(statement: ast.stmt, home: _Home) -> tuple[str, ...]:
    if any(isinstance(outer, ast.FunctionDef) for outer in home):
        return ()
    if home:
        return (home[-1].name,)
    names = (node for node in ast.walk(statement) if isinstance(node, ast.Name))
    return tuple(name.id for name in names if isinstance(name.ctx, ast.Store))


def _changes(node: ast.AST, parent: ast.AST, name: str) -> Iterator[ast.AST | None]:
    if isinstance(node, ast.Compare):
        yield from _compared(node)
    elif isinstance(node, ast.BinOp) and type(node.op) in _REACHED:
        yield _with(node, op=_REACHED[type(node.op)]())
    elif isinstance(node, ast.BoolOp):
        yield _with(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
    elif isinstance(node, ast.UnaryOp):
        yield node.operand
    elif isinstance(node, ast.Constant):
        yield from _constants(node, parent)
    elif isinstance(node, ast.Call):
        yield from _calls(node)
    elif isinstance(node, ast.Attribute) and node.attr == "T":
        yield node.value
    elif isinstance(node, ast.Slice):
        for end in ("lower", "upper"):
            if getattr(node, end) is not None:
                yield _with(node, **{end: None})
    elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
        if not isinstance(node.test, (ast.Compare, ast.BoolOp, ast.UnaryOp)):
            yield _with(node, test=ast.UnaryOp(ast.Not(), node.test))
    elif isinstance(node, ast.With):
        if not any(item.optional_vars for item in node.items):
            yield ast.copy_location(ast.If(ast.Constant(True), node.body, []), node)
    elif isinstance(node, ast.ExceptHandler):
        if node.type is not None:
            yield _with(node, type=ast.Tuple([], ast.Load()))
    elif isinstance(node, ast.stmt) and name in ("body", "orelse", "finalbody"):
        yield from _statements(node)


def _compared(node: ast.Compare) -> Iterator[ast.AST]:
    for i, op in enumerate(node.ops):
        for other in _COMPARED[type(op)]:
            yield _with(node, ops=[*node.ops[:i], other(), *node.ops[i + 1 :]])


def _constants(node: ast.Constant, parent: ast.AST) -> Iterator[ast.AST]:
    value = node.value
    if isinstance(parent, ast.JoinedStr):
        return
    if isinstance(value, bool):
        yield ast.Constant(not value)
    elif isinstance(value, int):
        axis = isinstance(parent, ast.keyword) and (parent.arg or "").startswith("axis")
        yield ast.Constant(value - 1 if axis and value else value + 1)
    elif isinstance(value, float):
        small = abs(value) < 1e-6
        yield ast.Constant(value + 1.0 if small else float(f"{1.01 * value:.12g}"))
    elif isinstance(value, str) and value and " " not in value:
        yield ast.Constant(_STRINGS.get(value, f"{value}_"))


def _calls(node: ast.Call) -> Iterator[ast.AST]:
    func = node.func
    name = func.attr if isinstance(func, ast.Attribute) else getattr(func, "id", "")
    of_numpy = isinstance(func, ast.Attribute) and ast.unparse(func.value) in ("np", "special")
    if name in _SWAPPED:
        other = _SWAPPED[name]
        changed = (
            _with(func, attr=other)
            if isinstance(func, ast.Attribute)
            else ast.Name(other, ast.Load())
        )
        yield _with(node, func=changed)
    if name in _DROPPED and node.args and (of_numpy or isinstance(func, ast.Name)):
        yield node.args[0]
    if name in _BARE and isinstance(func, ast.Attribute) and not of_numpy:
        yield func.value


def _statements(node: ast.stmt) -> Iterator[ast.AST]:
    """Without the statement, where what follows does not fail for want of a name."""
    stored = isinstance(node, ast.Assign) and not isinstance(node.targets[0], (ast.Name, ast.Tuple))
    if stored or isinstance(node, (ast.Expr, ast.AugAssign, ast.Raise, ast.Continue, ast.Break)):
        yield ast.copy_location(ast.Pass(), node)


def _with(node: ast.AST, **fields: object) -> ast.AST:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed
