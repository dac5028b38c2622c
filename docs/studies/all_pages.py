"""Every command that the pages in docs/studies name, in their order: `make studies`. It takes hours.

Output goes to results/studies/PAGE.log, with the commit. A command that fails does not stop the others.
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
LOGS = ROOT / "results" / "studies"
COMMAND = re.compile(r"^    ((?:lampest|python -m (?:docs|tests))\b[^#\n]*?) *(?:#.*)?$", re.MULTILINE)


def commands(page: Path) -> list[str]:
    """The indented commands of a page, without optional arguments in brackets."""
    return [re.sub(r" *\[[^\]]*\]", "", results) for results in COMMAND.findall(page.read_text(encoding="utf-8"))]


def main() -> int:
    """Run them; 1 where any failed."""
    LOGS.mkdir(parents=True, exist_ok=True)
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True).stdout
    failed = 0
    for page in sorted((ROOT / "docs" / "studies").glob("*.md")):
        for typed in commands(page):
            print(f"{page.stem}: {typed}", flush=True)
            words = typed.split()
            program = Path(sys.executable).with_name(words[0])
            with (LOGS / f"{page.stem}.log").open("a", encoding="utf-8") as log:
                log.write(f"\n# {commit.strip()}: {typed}\n")
                log.flush()
                ended = subprocess.run([program, *words[1:]], cwd=ROOT, stdout=log, stderr=subprocess.STDOUT)
            if ended.returncode:
                failed += 1
                print(f"  ended with {ended.returncode}: see {LOGS / page.stem}.log", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
