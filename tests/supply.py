"""Supply chain of lampest: locks with hashes, licences, vulnerabilities.

    python -m tests.supply lock       # write the locks, requirements*.lock, from pyproject.toml
    python -m tests.supply licences   # write docs/reference/licences.md from the installed packages
    python -m tests.supply audit      # ask the database of vulnerabilities for all locked packages

The module holds no test.
"""

import json
import re
import subprocess
import sys
import tempfile
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
LOCKS = {
    "requirements.lock": ["--extra", "plots"],
    "requirements-dev.lock": ["--extra", "dev", "--extra", "docs", "--extra", "cluster"],
}
BUILD = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["build-system"][
    "requires"
]
EDITABLE = "editables>=0.5"  # what hatchling asks for besides where the package stays in its folder
# An oracle for wire; it draws with cairo, which has to be compiled and is not needed.
ALONE = "badcrossbar"
OLDEST = "3.11"
LICENCES = ROOT / "docs" / "reference" / "licences.md"
HEAD = """# Licences

What `pip install lampest` brings and what builds it, with the licence that each package states.
`make licences` writes it of the packages that `requirements.lock` names. lampest itself is under
the MIT licence and contains none of their code; the simulated board in `firmware/`, whose host
program links simavr (GPL-3), is source, is built where it is used and is in no wheel.

"""


def locked(path: Path) -> dict[str, str]:
    """Name → newest version of everything that a lock pins."""
    pins = re.findall(r"^([A-Za-z0-9_.-]+)==([^\s;\\]+)", path.read_text(), re.MULTILINE)
    return {plain(name): version for name, version in pins}


def plain(name: str) -> str:
    """A package's name as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def lock() -> int:
    """Resolve for every Python from 3.11 on and every platform.

    The versions are those of constraints.txt.
    """
    command = [
        sys.executable,
        "-m",
        "uv",
        "pip",
        "compile",
        "--quiet",
        "--no-header",
        "--no-annotate",
    ]
    command += [
        "--universal",
        "--python-version",
        OLDEST,
        "--generate-hashes",
        "--constraint",
        "constraints.txt",
    ]
    for name, extras in LOCKS.items():
        text = compiled([*command, "pyproject.toml", *extras, "-"], "\n".join([*BUILD, EDITABLE]))
        text += compiled([*command, "--no-deps", "-"], ALONE) if extras else ""
        (ROOT / name).write_text(text)
    return 0


def compiled(command: list[str], requirements: str) -> str:
    """Return the output of uv, or exit with its error."""
    completed = subprocess.run(
        command, cwd=ROOT, input=requirements + "\n", capture_output=True, text=True
    )
    if completed.returncode:
        sys.exit(f"lock: {completed.stderr.strip()}")
    return completed.stdout


def licences() -> int:
    """Write the list of licences of everything that lampest needs at run time."""
    installed = {plain(distribution.name) for distribution in metadata.distributions()}
    licensed = sorted(set(locked(ROOT / "requirements.lock")) & installed)
    command = [
        sys.executable,
        "-m",
        "piplicenses",
        "--from=mixed",
        "--format=markdown",
        "--with-urls",
        "--order=name",
    ]
    completed = subprocess.run([*command, "--packages", *licensed], capture_output=True, text=True)
    if completed.returncode:
        sys.exit(f"licences: {completed.stderr.strip()}")
    LICENCES.write_text(HEAD + re.sub(r"[ \t]{2,}", " ", completed.stdout))
    return 0


def audit() -> int:
    """Return 0 if every package was looked up and none has a known vulnerability.

    Otherwise print the faults and return 1.
    """
    with tempfile.TemporaryDirectory() as folder:
        requirements = Path(folder) / "wanted.txt"
        report = Path(folder) / "report.json"
        pins = {**locked(ROOT / "requirements.lock"), **locked(ROOT / "requirements-dev.lock")}
        requirements.write_text(
            "".join(f"{name}=={version}\n" for name, version in sorted(pins.items()))
        )
        command = [
            sys.executable,
            "-m",
            "pip_audit",
            "--requirement",
            str(requirements),
            "--no-deps",
            "--disable-pip",
        ]
        command += ["--progress-spinner", "off", "--format", "json", "--output", str(report)]
        completed = subprocess.run(command, capture_output=True, text=True)
        answer: Any = (
            json.loads(report.read_text()) if report.is_file() and report.read_text() else None
        )
    reason = completed.stderr.strip().splitlines()[-1:] or ["no answer"]
    return audit_verdict(answer, reason[0].partition(":")[0])


def audit_verdict(answer: Any, reason: str) -> int:
    """Print the answer of the database, None if not reached, and return an exit code.

    Unknown packages are not checked.
    """
    packages = [] if answer is None else answer["dependencies"]
    known = [package for package in packages if "skip_reason" not in package]
    if not known:
        print(
            "audit: the database of vulnerabilities could not be reached; nothing was checked "
            f"({reason})"
        )
        return 1
    unknown = sorted(package["name"] for package in packages if package not in known)
    faults = [(package, fault) for package in known for fault in package["vulns"]]
    for package, fault in faults:
        mended = ", ".join(fault["fix_versions"]) or "no version yet"
        print(f"audit: {package['name']} {package['version']}: {fault['id']}, mended in {mended}")
    if unknown:
        print(f"audit: not in the database, so not checked: {', '.join(unknown)}")
    print(f"audit: {len(known)} packages checked, {len(faults)} known vulnerabilities")
    return 1 if faults or unknown else 0


if __name__ == "__main__":
    commands = {"lock": lock, "licences": licences, "audit": audit}
    if sys.argv[1:] not in [[name] for name in commands]:
        sys.exit(f"usage: python -m tests.supply {'|'.join(commands)}")
    sys.exit(commands[sys.argv[1]]())
