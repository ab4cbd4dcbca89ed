"""Faults of the package, drawn at random from all that cosmic-ray makes."""

import ast
import difflib
import random
import re
from pathlib import Path

from cosmic_ray.commands.init import _all_work_items
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator

COUNT, SEED = 300, 52
NO_FLOAT = r"Operator_(Add|Sub|Mul|Div|FloorDiv|Mod|Pow)_(BitOr|BitAnd|BitXor|LShift|RShift)"


def draw():
    """The faults, with what identifies each of them."""
    every = [w.mutations[0] for w in _all_work_items(sorted(Path("mfd_bayes").rglob("*.py")), {})]
    random.Random(SEED).shuffle(every)
    faults = []
    while len(faults) < COUNT:
        m = every.pop()
        text = m.module_path.read_text("utf-8")
        new = mutate_code(text, get_operator(m.operator_name)(), m.occurrence)
        if re.search(NO_FLOAT, m.operator_name) or code(new) in (None, code(text)):
            continue
        lines = list(difflib.ndiff(text.splitlines(), new.splitlines()))
        before, after = ("\n".join(s[2:] for s in lines if s[0] == c).strip() for c in "-+")
        fault = {"number": len(faults) + 1, "file": str(m.module_path), "line": m.start_pos[0]}
        fault["column"] = m.start_pos[1]
        fault |= {"function": m.definition_name, "operator": m.operator_name}
        fault |= {"occurrence": m.occurrence, "before": before, "after": after}
        faults.append(fault | {"state": "survived", "parts": 0, "tests": None, "by": ""})
    return faults


def code(text):
    """What the code does: its tree without annotations; None where it does not compile."""
    try:
        compile(text, "", "exec")
    except (SyntaxError, ValueError):
        return None
    for node in ast.walk(tree := ast.parse(text)):
        for name in {"annotation", "returns"} & {*node._fields}:
            setattr(node, name, None)
    return ast.dump(tree)
