"""Make small faults in modules, one at a time, and count those that the nearest tests notice.

    python .ci/mutate.py kontur_av/streams/budget.py --mutations 12 --seed 1
    python .ci/mutate.py telepresence/link pipelines/mission --nearest --total 40 --seed 1

The test file of a module runs, with `--nearest` its folder of tests/unit. The tests run on a copy
of the tree. Part of the nightly tier only.
"""

import argparse
import ast
import contextlib
import multiprocessing
import os
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
UNIT = "tests/unit"

#: A run may take this many times as long as without a fault, and these seconds more.
PATIENCE = (4.0, 30.0)
ENDLESS = "no end"
OTHERS = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
SIGNS = {ast.Add: ast.Sub, ast.Sub: ast.Add}


@dataclass(frozen=True)
class Mutation:
    """One fault: `source` is the whole module with it."""

    line: int
    was: str
    now: str
    source: str


@dataclass(frozen=True)
class _Place:
    """A node that can be changed, and how; `change` returns how to take the change back."""

    node: ast.expr | ast.stmt
    change: Callable[[], Callable[[], None]]


def mutations(source: str) -> list[Mutation]:
    """Return every mutation of a module that this script knows."""
    tree = ast.parse(source)
    plain = ast.unparse(tree)
    found = []
    for place in _places(tree):
        undo = place.change()
        text = ast.unparse(tree)
        undo()
        pairs = zip(plain.splitlines(), text.splitlines(), strict=False)
        was, now = next((was, now) for was, now in pairs if was != now)
        found.append(Mutation(place.node.lineno, was.strip(), now.strip(), text))
    return found


def _places(tree: ast.Module) -> Iterator[_Place]:
    for node in _code(tree):
        yield from _expressions(node)
        if isinstance(node, ast.AugAssign) and type(node.op) in SIGNS:
            yield _Place(node, _setting(node, "op", SIGNS[type(node.op)]()))
    functions = (ast.FunctionDef, ast.If, ast.For, ast.While, ast.With, ast.Try)
    inside = {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        for part in ast.walk(node)
    }
    for node in ast.walk(tree):
        if not isinstance(node, functions) or id(node) not in inside:
            continue
        for field in ("body", "orelse", "finalbody"):
            statements = getattr(node, field, [])
            for index, statement in enumerate(statements):
                if _is_removable(statement):
                    yield _Place(statement, _removing(statements, index))


def _code(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield nodes that run: no annotation, assertion, import or raised message."""
    stack: list[ast.AST] = [tree]
    while stack:
        node = stack.pop()
        if isinstance(node, (ast.Assert, ast.Raise, ast.Import, ast.ImportFrom, ast.JoinedStr)):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "bases", "keywords") and not (
                name == "keywords" and isinstance(node, ast.Call)
            ):
                continue
            parts = value if isinstance(value, list) else [value]
            stack += reversed([part for part in parts if isinstance(part, ast.AST)])


def _expressions(node: ast.AST) -> Iterator[_Place]:
    if isinstance(node, ast.Compare):
        for other in OTHERS[type(node.ops[0])]:
            yield _Place(node, _setting(node, "ops", [other(), *node.ops[1:]]))
    elif isinstance(node, ast.BoolOp):
        swapped = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield _Place(node, _setting(node, "op", swapped))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield _Place(node, _setting(node, "operand", ast.UnaryOp(ast.Not(), node.operand)))
    elif isinstance(node, ast.BinOp) and type(node.op) in SIGNS:
        yield _Place(node, _setting(node, "op", SIGNS[type(node.op)]()))
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        swapped_name = {"min": "max", "max": "min"}.get(node.func.id)
        if swapped_name:
            yield _Place(node, _setting(node.func, "id", swapped_name))
    if isinstance(node, ast.Call) and not _takes_any_order(node):
        for index, (one, other) in enumerate(pairwise(node.args)):
            if ast.unparse(one) != ast.unparse(other):
                swapped_arguments = [*node.args]
                swapped_arguments[index : index + 2] = other, one
                yield _Place(node, _setting(node, "args", swapped_arguments))
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        # One more of a nanosecond or of a rate changes nothing: a large number is doubled.
        by = 1 if abs(node.value) <= 100 else node.value
        yield _Place(node, _setting(node, "value", node.value + by))
    # Comparisons, `and`, `or` and `not` are changed in themselves.
    if isinstance(node, (ast.If, ast.While)) and not isinstance(
        node.test, (ast.Compare, ast.BoolOp, ast.UnaryOp)
    ):
        negated = ast.UnaryOp(ast.Not(), node.test)
        yield _Place(node, _setting(node, "test", negated))


def _takes_any_order(call: ast.Call) -> bool:
    """Whether swapped arguments change nothing, or raise at once."""
    return ast.unparse(call.func) in {"min", "max", "isinstance", "range"} or any(
        isinstance(argument, ast.Starred) for argument in call.args
    )


def _setting(node: ast.AST, field: str, value: object) -> Callable[[], Callable[[], None]]:
    def change() -> Callable[[], None]:
        old = getattr(node, field)
        setattr(node, field, value)
        return lambda: setattr(node, field, old)

    return change


def _removing(statements: list[ast.stmt], index: int) -> Callable[[], Callable[[], None]]:
    def change() -> Callable[[], None]:
        old = statements[index]
        statements[index] = ast.Pass()
        return lambda: statements.__setitem__(index, old)

    return change


def _is_removable(statement: ast.stmt) -> bool:
    if isinstance(statement, ast.Expr):
        return not isinstance(statement.value, ast.Constant)
    if isinstance(statement, ast.Assign):
        return any(isinstance(t, (ast.Attribute, ast.Subscript)) for t in statement.targets)
    if isinstance(statement, ast.Return):
        return statement.value is None
    return isinstance(statement, (ast.AugAssign, ast.Continue, ast.Break, ast.Delete))


def tests_near(module: str, *, nearest: bool) -> list[str]:
    """Return the test file of a module, if it has one; otherwise, or with `nearest`, a folder.

    nearest: the folder of tests/unit that mirrors the module's, or the next one above it.
    """
    place = Path(module)
    own = f"{UNIT}/{place.parent.as_posix()}/test_{place.name}"
    if not nearest and (ROOT / own).exists():
        return [own]
    mirrors = [f"{UNIT}/{folder.as_posix()}" for folder in place.parents]
    return [next(mirror for mirror in mirrors if (ROOT / mirror).exists())]


def _modules(places: list[str]) -> list[str]:
    """Return the modules of `places`: files, and folders with all that is in them."""
    found = []
    for place in places:
        path = ROOT / place
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
        found += [file.relative_to(ROOT).as_posix() for file in files]
    return found


def _chosen(options: argparse.Namespace) -> dict[str, list[Mutation]]:
    """Return the mutations by module."""
    modules = _modules(options.modules)
    found = {m: mutations((ROOT / m).read_text(encoding="utf-8")) for m in modules}
    if options.line is not None:
        return {m: [each for each in found[m] if each.line == options.line] for m in modules}
    if options.total is not None:
        every = [(m, each) for m in modules for each in found[m]]
        drawn = random.Random(options.seed).sample(every, min(options.total, len(every)))
        return {m: [each for of, each in drawn if of == m] for m in modules}
    return {
        m: random.Random(f"{options.seed} {m}").sample(
            found[m], min(options.mutations, len(found[m]))
        )
        for m in modules
    }


def _run_tests(tree: str, places: list[str]) -> None:
    """In a process of its own: run tests on a copy, and exit with pytest's code."""
    os.chdir(tree)
    os.setpgrp()
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    sys.path.insert(0, tree)
    os.environ["PYTHONPATH"] = tree
    import hypothesis
    import pytest

    # A failure needs no smallest example.
    phases = [hypothesis.Phase.explicit, hypothesis.Phase.generate]
    profile = {"phases": phases, "database": None, "deadline": None, "derandomize": True}
    hypothesis.settings.register_profile("mutate", **profile)
    os.environ["HYPOTHESIS_PROFILE"] = "mutate"
    options = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    os._exit(int(pytest.main([*options, *places])))


def noticed(tree: Path, places: list[str], limit_s: float) -> str | None:
    """Return how a fault was noticed, or None. An endless loop is noticed, too."""
    # A forked process has the large libraries loaded.
    run = multiprocessing.get_context("fork").Process(target=_run_tests, args=(str(tree), places))
    run.start()
    run.join(limit_s)
    if run.is_alive():
        with contextlib.suppress(ProcessLookupError):
            os.killpg(run.pid or 0, 9)
        run.kill()
        run.join()
        return ENDLESS
    return f"exit code {run.exitcode}" if run.exitcode else None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="+", help="files or folders")
    parser.add_argument("--mutations", type=int, default=12, help="of each module (12)")
    parser.add_argument("--seed", type=int, default=1, help="which mutations (1)")
    parser.add_argument("--total", type=int, help="mutations of all modules together")
    parser.add_argument(
        "--nearest", action="store_true", help="run the nearest folder of tests/unit only"
    )
    parser.add_argument("--line", type=int, help="only mutations of this line, all of them")
    options = parser.parse_args()
    # Loaded once, for all runs; nothing of the project itself.
    for library in ("numpy", "av", "cv2", "hypothesis", "pytest", "spacepackets"):
        with contextlib.suppress(ImportError):
            __import__(library)
    sys.dont_write_bytecode = True
    total = missed = 0
    with tempfile.TemporaryDirectory(prefix="mutate-") as folder:
        tree = Path(folder) / "tree"
        ignored = shutil.ignore_patterns(".git", ".venv", "__pycache__", ".hypothesis", ".*_cache")
        shutil.copytree(ROOT, tree, ignore=ignored)
        limits_s: dict[tuple[str, ...], float] = {}
        for module, found in _chosen(options).items():
            if not found:
                continue
            source = (ROOT / module).read_text(encoding="utf-8")
            places = tests_near(module, nearest=options.nearest)
            if tuple(places) not in limits_s:
                begun = time.monotonic()
                if wrong := noticed(tree, places, 3600.0):
                    print(f"{module}: its tests fail without a fault ({wrong})")
                    return 1
                limits_s[*places,] = PATIENCE[0] * (time.monotonic() - begun) + PATIENCE[1]
            limit_s = limits_s[*places,]
            seen = endless = 0
            for mutation in sorted(found, key=lambda mutation: mutation.line):
                (tree / module).write_text(mutation.source, encoding="utf-8")
                if how := noticed(tree, places, limit_s):
                    seen += 1
                    endless += how == ENDLESS
                else:
                    print(f"  {module}:{mutation.line}: {mutation.was}  ->  {mutation.now}")
                sys.stdout.flush()
            (tree / module).write_text(source, encoding="utf-8")
            ends = f", {endless} of them by their time-out" if endless else ""
            print(f"{module}: {seen} of {len(found)} noticed{ends}", flush=True)
            total += len(found)
            missed += len(found) - seen
    if total:
        print(f"{total - missed} of {total} noticed: {100 * (total - missed) / total:.1f} %")
    return 0


if __name__ == "__main__":
    sys.exit(main())
