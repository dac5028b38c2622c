"""Mutation study: the share of small changes of the package that no fast test notices.

python -m tests.mutation                               # 60 mutants of the whole package
python -m tests.mutation --count 20 --room lampest/posterior --seed 2
python -m tests.mutation --guards                 # which test file guards which module, as a table

It runs at low priority. The fast tests first run once, in a copy of the checkout, and record the
functions that each of them calls. A mutant is then held against the tests that call its function
until one fails: first the rows of the golden table, in a fork that has only the package to import,
then the other tests, the shortest of every file first. A mutant whose tests take more than three
times their usual time counts as noticed.
"""

import argparse
import importlib
import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

from tests.mutation.operators import Mutant, mutants_of
from tests.mutation.record import OUTPUT

ROOT = Path(__file__).parents[2]
RECORD = ROOT / "results" / "mutation" / "tests.json"
LEFT_OUT = (".git", ".venv", "results", "_build", ".hypothesis", "__pycache__", ".*_cache")
EXTRA_SECONDS = 60.0  # s beside three times the recorded duration
MAX_SECONDS = 120.0  # s of recorded tests for one mutant; a survivor beyond this is counted as one
GOLDEN = "tests/golden/test_table.py::test_a_row_has_its_stored_results["
# Guards constants and defaults, and calls none of their functions.
DEFAULTS = "tests/golden/test_defaults.py"
LIBRARIES = (
    "numpy scipy.linalg scipy.sparse scipy.optimize scipy.stats scipy.special casadi h5py "
    "pydantic ruamel.yaml"
)
LIBRARIES += " matplotlib.figure matplotlib.colors typer rich.table jinja2 mpmath pytest"

Tests = dict[str, dict[str, Any]]


@contextmanager
def copied_checkout() -> Iterator[Path]:
    """A copy of this checkout with the same environment, in which a module may be changed."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = Path(folder) / "lampest"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*LEFT_OUT))
        (copy / ".venv").symlink_to(ROOT / ".venv")
        yield copy


def pytest_of(copy: Path, *options: str) -> tuple[list[str], dict[str, str]]:
    """Return the command of the copy's fast tests, and its environment."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-m",
        "not slow",
        *options,
    ]
    return command, os.environ | {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}


def run_tests(
    copy: Path, *options: str, seconds: float | None = None, **variables: str
) -> int | None:
    """Run pytest on the copy and return its exit code, or None after the given time."""
    command, environment = pytest_of(copy, *options)
    silent = {
        "stdin": subprocess.DEVNULL,
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
    }
    with subprocess.Popen(
        command, cwd=copy, env=environment | variables, start_new_session=True, **silent
    ) as process:
        try:
            return process.wait(seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            return None


def recorded_tests(copy: Path) -> Tests:
    """Return the recorded fast tests; run them first where no record stands."""
    if not RECORD.exists():
        RECORD.parent.mkdir(parents=True, exist_ok=True)
        run_tests(copy, "-p", "tests.mutation.record", **{OUTPUT: str(RECORD)})
        parts = [*RECORD.parent.glob(RECORD.name + ".*")]
        RECORD.write_text(
            json.dumps({name: test for part in parts for name, test in read(part).items()})
        )
    command, environment = pytest_of(copy, "--collect-only")
    listed = set(
        subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True
        ).stdout.split("\n")
    )
    # Others were renamed since.
    return {name: test for name, test in read(RECORD).items() if name in listed}


def read(path: Path) -> Tests:
    """Read a record."""
    return dict(json.loads(path.read_text()))


def guards_of(mutant: Mutant, tests: Tests) -> tuple[list[str], list[str]]:
    """Return golden rows and other tests that call a mutant's function.

    A mutant outside functions is guarded by the tests that call its module.

    The shortest row comes first, then defaults and constants, the shortest test of every file and
    the second of every file, up to `MAX_SECONDS` seconds.
    """
    path = mutant.path.removeprefix("lampest/")
    rows = list[str]()
    by_file = dict[str, list[str]]()
    tried = [f"{path}:{mutant.function}\n", f":{mutant.function}\n"] if mutant.function else []
    # a function that was renamed or moved since is known by its name or its module
    for part in (*tried, f"{path}:"):
        names = [
            name
            for name, test in tests.items()
            if any(part in f"{call}\n" for call in test["functions"])
        ]
        if names:
            break
    chosen = [name for name in tests if name.startswith(DEFAULTS)]
    for name in sorted(set(names) - set(chosen), key=lambda name: tests[name]["seconds"]):
        (
            rows if name.startswith(GOLDEN) else by_file.setdefault(name.partition("::")[0], [])
        ).append(name)
    rounds = max(map(len, by_file.values()), default=0)
    ordered = [
        names[number]
        for number in range(rounds)
        for names in by_file.values()
        if number < len(names)
    ]
    total = 0.0
    for name in ordered:
        total += tests[name]["seconds"]
        if total < MAX_SECONDS:
            chosen.append(name)
    return rows, chosen


def is_noticed(mutant: Mutant, copy: Path, tests: Tests) -> bool:
    """Whether a guard fails while the copy has the mutant."""
    rows, other_tests = guards_of(mutant, tests)
    module = copy / mutant.path
    chosen = copy / "guards.txt"
    source = module.read_bytes()
    chosen.write_text("\n".join(other_tests))
    module.write_bytes(mutant.apply_to(source))
    seconds = [
        3 * sum(tests[name]["seconds"] for name in names) + EXTRA_SECONDS
        for names in (rows, other_tests)
    ]
    try:
        if rows and not rows_agree(
            [row.removeprefix(GOLDEN)[:-1] for row in rows], copy, seconds[0]
        ):
            return True
        return bool(other_tests) and run_tests(copy, "-x", f"@{chosen}", seconds=seconds[1]) != 0
    finally:
        module.write_bytes(source)


def rows_agree(names: list[str], copy: Path, seconds: float) -> bool:
    """Whether rows of the golden table have their stored results in the copy, within a time.

    A fork of this process computes them: libraries are imported once, the package anew.
    """
    for library in LIBRARIES.split():
        importlib.import_module(library)
    process = os.fork()
    if not process:
        sys.path[:0] = [str(copy), str(copy / "tests")]
        for name in [
            name for name in sys.modules if name.partition(".")[0] in ("tests", "lampest")
        ]:
            del sys.modules[name]
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            try:
                os._exit(not importlib.import_module("golden.test_table").agree(names))
            except BaseException:
                os._exit(1)
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            return status == 0
        time.sleep(0.02)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return False


def sampled(room: str, count: int, seed: int) -> list[Mutant]:
    """Draw lines of a room at random, and a change of each."""
    modules = sorted((ROOT / room).rglob("*.py")) if (ROOT / room).is_dir() else [ROOT / room]
    lines: dict[tuple[str, int], list[Mutant]] = {}
    for module in modules:
        for mutant in mutants_of(ROOT, module):
            lines.setdefault((mutant.path, mutant.line), []).append(mutant)
    generator = random.Random(seed)
    return [
        generator.choice(lines[place])
        for place in generator.sample(sorted(lines), min(count, len(lines)))
    ]


def guard_table(tests: Tests) -> Iterator[str]:
    """Yield a line of Markdown for every module: the test files that call most of its functions."""
    reached: dict[str, dict[str, set[str]]] = {}
    for name, test in tests.items():
        file = name.partition("::")[0].removeprefix("tests/")
        for call in test["functions"]:
            module, _, function = call.partition(":")
            reached.setdefault(module, {}).setdefault(file, set()).add(function)
    yield "| module | test files that call most of its functions |"
    yield "|---|---|"
    for module, files in sorted(reached.items()):
        total = len(set().union(*files.values()))
        guards = sorted(files, key=lambda file: (-len(files[file]), file))[:3]
        yield (
            f"| `{module}` | "
            f"{', '.join(f'`{file}` ({100 * len(files[file]) // total} %)' for file in guards)} |"
        )


def main() -> int:
    """Run the study and print each mutant with its answer."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutation", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--room", default="lampest", help="folder or module of the package")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--guards", action="store_true", help="print the table of guards alone")
    arguments = parser.parse_args()
    os.nice(10)
    with copied_checkout() as copy:
        tests = recorded_tests(copy)
        if arguments.guards:
            print("\n".join(guard_table(tests)))
            return 0
        answers = Counter[bool]()
        for mutant in sampled(arguments.room, arguments.count, arguments.seed):
            begin = time.perf_counter()
            answer = is_noticed(mutant, copy, tests)
            answers[answer] += 1
            word = "noticed" if answer else "SURVIVED"
            seconds = time.perf_counter() - begin
            place = f"{mutant.path}:{mutant.line}"
            print(
                f"{word:8} {place} {mutant.operator}: {mutant.before} → {mutant.after} "
                f"({seconds:.0f} s)",
                flush=True,
            )
    print(f"{answers[False]} of {sum(answers.values())} survived")
    return 0


if __name__ == "__main__":
    sys.exit(main())
