"""Mutation study: the share of small changes of the package that no fast test notices.

python -m tests.mutation                               # 60 mutants of the whole package
python -m tests.mutation --count 20 --room lampest/posterior --seed 2
python -m tests.mutation --guards                      # which test file guards which module, as a table

It runs at low priority. The fast tests first run once, in a copy of the checkout, and record the functions that each
of them calls. A mutant is then held against the tests that call its function, the shortest of every file first, until
one fails. A mutant whose tests take more than three times their usual time counts as noticed.
"""

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.mutation.operators import Mutant, mutants_of
from tests.mutation.record import OUTPUT

ROOT = Path(__file__).parents[2]
RECORD = ROOT / "results" / "mutation" / "tests.json"
LEFT_OUT = (".git", ".venv", "results", "_build", ".hypothesis", "__pycache__", ".*_cache")
GRACE = 60.0  # s beside three times the recorded duration
LONGEST = 300.0  # s of recorded tests for one mutant; a survivor beyond this is counted as one

Tests = dict[str, dict[str, Any]]


@contextmanager
def copied_checkout() -> Iterator[Path]:
    """A copy of this checkout with the same environment, in which a module may be changed."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = Path(folder) / "lampest"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*LEFT_OUT))
        (copy / ".venv").symlink_to(ROOT / ".venv")
        yield copy


def run_tests(copy: Path, *options: str, seconds: float | None = None, **variables: str) -> int | None:
    """Run pytest on the copy and return its exit code, None when it takes longer than the given time."""
    environment = os.environ | {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"} | variables
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow", *options]
    silent = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, cwd=copy, env=environment, start_new_session=True, **silent) as process:
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
        RECORD.write_text(json.dumps({name: test for part in parts for name, test in read(part).items()}))
    return read(RECORD)


def read(path: Path) -> Tests:
    """Read a record."""
    return dict(json.loads(path.read_text()))


def guards_of(mutant: Mutant, tests: Tests) -> list[str]:
    """Return the tests that call a mutant's function, or its module where it stands outside functions.

    The shortest test of every file comes first, then the second of every file, up to `LONGEST` seconds.
    """
    path = mutant.path.removeprefix("lampest/")
    by_file: dict[str, list[str]] = {}
    for name in sorted(tests, key=lambda name: tests[name]["seconds"]):
        calls = tests[name]["functions"]
        if f"{path}:{mutant.function}" in calls or (
            not mutant.function and any(call.startswith(f"{path}:") for call in calls)
        ):
            by_file.setdefault(name.partition("::")[0], []).append(name)
    rounds = max(map(len, by_file.values()), default=0)
    ordered = [names[number] for number in range(rounds) for names in by_file.values() if number < len(names)]
    total, chosen = 0.0, []
    for name in ordered:
        total += tests[name]["seconds"]
        if total < LONGEST:
            chosen.append(name)
    return chosen


def noticed(mutant: Mutant, copy: Path, tests: Tests) -> bool:
    """Whether a guard fails while the copy has the mutant."""
    guards = guards_of(mutant, tests)
    if not guards:
        return False
    module, chosen = copy / mutant.path, copy / "guards.txt"
    source = module.read_bytes()
    chosen.write_text("\n".join(guards))
    module.write_bytes(mutant.apply_to(source))
    try:
        seconds = 3 * sum(tests[name]["seconds"] for name in guards) + GRACE
        return run_tests(copy, "-x", f"@{chosen}", seconds=seconds) != 0
    finally:
        module.write_bytes(source)


def sampled(room: str, count: int, seed: int) -> list[Mutant]:
    """Draw lines of a room at random, and a change of each."""
    modules = sorted((ROOT / room).rglob("*.py")) if (ROOT / room).is_dir() else [ROOT / room]
    lines: dict[tuple[str, int], list[Mutant]] = {}
    for module in modules:
        for mutant in mutants_of(ROOT, module):
            lines.setdefault((mutant.path, mutant.line), []).append(mutant)
    generator = random.Random(seed)
    return [generator.choice(lines[place]) for place in generator.sample(sorted(lines), min(count, len(lines)))]


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
        most = sorted(files, key=lambda file: (-len(files[file]), file))[:3]
        yield f"| `{module}` | {', '.join(f'`{file}` ({100 * len(files[file]) // total} %)' for file in most)} |"


def main() -> int:
    """Run the study and print each mutant with its answer."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=(__doc__ or "").splitlines()[0])
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
            answer = noticed(mutant, copy, tests)
            answers[answer] += 1
            word, seconds = "noticed" if answer else "SURVIVED", time.perf_counter() - begin
            place = f"{mutant.path}:{mutant.line}"
            print(f"{word:8} {place} {mutant.operator}: {mutant.before} → {mutant.after} ({seconds:.0f} s)", flush=True)
    print(f"{answers[False]} of {sum(answers.values())} survived")
    return 0


if __name__ == "__main__":
    sys.exit(main())
