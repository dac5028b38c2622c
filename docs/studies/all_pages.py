"""Every command that pages in docs/studies and of the model check name.

Run it with: `make studies`; PAGES="bench real" names some.

All pages take more than an hour on one core. Output goes to results/studies/PAGE.log, with the
commit. A command that fails does not stop the others. A page whose commands all succeed says at its
end by which commit, and when.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
from datetime import date
from itertools import takewhile
from pathlib import Path

ROOT = Path(__file__).parents[2]
MEASURED = (
    *sorted((ROOT / "docs" / "studies").glob("*.md")),
    ROOT / "docs" / "theory" / "model_check.md",
)
PAGES = {page.stem: page for page in MEASURED}
LOGS = ROOT / "results" / "studies"
COMMAND = re.compile(
    r"^    ((?:\w+=\w+ )*(?:lampest|python -m (?:docs|tests))\b[^#\n]*?) *(?:#.*)?$", re.MULTILINE
)
RUN = re.compile(r"\n*<!-- run -->\n.*\Z", re.DOTALL)


def commands(page: Path) -> list[str]:
    """The indented commands of a page, without optional arguments in brackets."""
    return [
        re.sub(r" *\[[^\]]*\]", "", results)
        for results in COMMAND.findall(page.read_text(encoding="utf-8"))
    ]


def with_commit(text: str, commit: str, day: str) -> str:
    """A page that says at its end by which commit its commands ran."""
    return (
        RUN.sub("", text).rstrip("\n")
        + f"\n\n<!-- run -->\nAll commands of this page ran at commit {commit}, {day}.\n"
    )


def run_page(page: Path, commit: str) -> bool:
    """Run the commands of a page; whether all succeeded."""
    failed = 0
    for typed in commands(page):
        print(f"{page.stem}: {typed}", flush=True)
        words = shlex.split(typed)
        variables = dict(word.split("=") for word in takewhile(lambda word: "=" in word, words))
        program, *arguments = words[len(variables) :]
        command = [Path(sys.executable).with_name(program), *arguments]
        with (LOGS / f"{page.stem}.log").open("a", encoding="utf-8") as log:
            log.write(f"\n# {commit}: {typed}\n")
            log.flush()
            options = {
                "cwd": ROOT,
                "env": os.environ | variables,
                "stdout": log,
                "stderr": subprocess.STDOUT,
            }
            ended = subprocess.run(command, **options)
        if ended.returncode:
            failed += 1
            print(f"  ended with {ended.returncode}: see {LOGS / page.stem}.log", flush=True)
    return not failed


def main() -> int:
    """Run the pages that are named, or all; 1 where any command failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pages", nargs="*", help=f"some of {', '.join(PAGES)}; default: all")
    parser.add_argument("--list", action="store_true", help="print the commands, and run none")
    stated = parser.parse_args()
    if unknown := [name for name in stated.pages if name not in PAGES]:
        parser.error(f"there is no page {unknown[0]}; there are {', '.join(PAGES)}")
    pages = [PAGES[name] for name in stated.pages or PAGES if commands(PAGES[name])]
    if stated.list:
        print("\n".join(f"{page.stem}: {typed}" for page in pages for typed in commands(page)))
        return 0
    LOGS.mkdir(parents=True, exist_ok=True)
    describe = ["git", "describe", "--always", "--dirty"]
    commit = subprocess.run(describe, cwd=ROOT, capture_output=True, text=True).stdout.strip()
    failed = False
    for page in pages:
        if run_page(page, commit):
            text = page.read_text(encoding="utf-8")
            page.write_text(with_commit(text, commit, f"{date.today():%d %B %Y}"), encoding="utf-8")
        else:
            failed = True
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
