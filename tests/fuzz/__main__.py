"""python -m tests.fuzz --inputs 100000: gives that many inputs to the readers and lists those received badly.

Exit code 1 where there is one. `--only N` repeats one of them and keeps it as a file.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
CHUNK = 1000
MOST_ADDRESSES = (
    4_000_000_000  # bytes of a worker; beyond them it gets a MemoryError instead of the machine's last page
)


def main() -> int:
    """Work through the inputs in processes of their own, so that one that crashes costs no other."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kind", help="only inputs of this kind")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", type=int, help="one input, kept in the current folder")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.only is not None:
        return repeat(chosen.only, chosen.kind)
    if chosen.worker:
        return work(chosen.first, chosen.inputs, chosen.kind)
    begin, end = time.monotonic(), chosen.first + chosen.inputs
    waiting = [(first, min(CHUNK, end - first)) for first in range(chosen.first, end, CHUNK)]
    running: list[tuple[subprocess.Popen[str], int, int]] = []
    outcomes: Counter[str] = Counter()
    faults: list[str] = []
    while waiting or running:
        while waiting and len(running) < chosen.jobs:
            first, count = waiting.pop(0)
            running.append((started(first, count, chosen.kind), first, count))
        process, first, count = running.pop(0)
        out, err = process.communicate()
        reached, counted, found = understood(out)
        outcomes.update(counted)
        faults += found
        if process.returncode:
            faults.append(f"{reached}: the process ended with {process.returncode}: {err[-1500:]}")
            if reached + 1 < first + count:
                waiting.insert(0, (reached + 1, first + count - reached - 1))
        for fault in found if not process.returncode else [*found, faults[-1]]:
            print(fault, flush=True)
    total = sum(outcomes.values())
    print(f"{total} inputs in {time.monotonic() - begin:.0f} s: {dict(sorted(outcomes.items()))}, {len(faults)} faults")
    return 1 if faults else 0


def started(first: int, count: int, kind: str | None) -> "subprocess.Popen[str]":
    """A process that gives inputs to the readers."""
    command = [sys.executable, str(HERE / "__main__.py"), "--worker", "--first", str(first), "--inputs", str(count)]
    if kind:
        command += ["--kind", kind]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=dict(os.environ))


def understood(out: str) -> tuple[int, Counter[str], list[str]]:
    """The last number a worker began with, how often each outcome was met, and its faults."""
    reached, outcomes, faults = -1, Counter[str](), []
    for line in out.splitlines():
        word, _, rest = line.partition(" ")
        if word == "at":
            reached = int(rest)
        elif word == "fault":
            faults.append(json.loads(rest))
            outcomes["fault"] += 1
        elif word == "outcome":
            outcomes[rest] += 1
    return reached, outcomes, faults


def work(first: int, count: int, kind: str | None) -> int:
    """Give the inputs to the readers, one after the other, and say how each was received."""
    from fuzz.mutants import corpus
    from fuzz.readers import ReceptionError, receive

    resource.setrlimit(resource.RLIMIT_AS, (MOST_ADDRESSES, MOST_ADDRESSES))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        inputs = corpus(folder)
        for number in range(first, first + count):
            print("at", number, flush=True)
            mutant = inputs.mutant(number, kind)
            try:
                print("outcome", mutant.kind, receive(mutant, folder))
            except ReceptionError as fault:
                print("fault", json.dumps(f"{number} ({mutant.kind}): {fault}"))
    return 0


def repeat(number: int, kind: str | None) -> int:
    """Receive one input, keep it, and print what is said of it."""
    from fuzz.mutants import SUFFIXES, corpus
    from fuzz.readers import receive

    resource.setrlimit(resource.RLIMIT_AS, (MOST_ADDRESSES, MOST_ADDRESSES))
    with tempfile.TemporaryDirectory() as name:
        mutant = corpus(Path(name)).mutant(number, kind)
        kept = Path(f"input_{number}{SUFFIXES[mutant.kind]}")
        kept.write_bytes(mutant.content)
        print(kept, mutant.kind)
        print(receive(mutant, Path(name)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
